#!/bin/sh
# Tries the properties in tests/properties/ on many new examples, other ones each time, and throws random bodies at the
# simulator. What fails is shown as its smallest example, which then becomes a test. Arguments: examples of each property
# (1000), and env-steps (200000).
set -eu
. "$(dirname "$0")/bootstrap.sh"
EVOGYMCM_EXAMPLES="${1:-1000}" .venv/bin/python -m pytest tests/properties
.venv/bin/python benchmarks/fuzz.py --steps "${2:-200000}" --seed "$(date +%s)"
