"""`benchmarks/parity.py` for the tests, and whether this machine can compute the recorded bits."""

import importlib
import sys
from pathlib import Path

import numpy as np

DATA = Path(__file__).parent / "data"
sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
parity = importlib.import_module("parity")

# Friction takes a tanh and orientations an acos of the C library, as in EvoGym: another library may round otherwise.
SAME_LIBRARY = parity.library() == int(np.load(DATA / "episodes" / "walker_v0_7.npz")["library"])
