#!/bin/sh
# Runs the benchmark suite; arguments go to benchmarks/run_suite.py, the quick size of experiment A where there are none.
set -eu
. "$(dirname "$0")/bootstrap.sh"
[ $# -gt 0 ] || set -- A
exec .venv/bin/python benchmarks/run_suite.py "$@"
