#!/bin/sh
# Runs the benchmark suite; arguments go to benchmarks/run_suite.py, "--preset quick" where there are none.
set -eu
. "$(dirname "$0")/bootstrap.sh"
[ $# -gt 0 ] || set -- --preset quick
exec .venv/bin/python benchmarks/run_suite.py "$@"
