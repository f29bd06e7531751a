"""Set-up of all tests."""

import os

# Idle OpenMP threads of torch otherwise spin, which slows the simulator's own threads down.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
