#!/bin/sh
# Compares ratios of speed with benchmarks/speed.json; exit status 1 where something has become slower. Arguments go to
# benchmarks/speed_baseline.py, such as: --only physics
set -eu
. "$(dirname "$0")/bootstrap.sh"
exec .venv/bin/python benchmarks/speed_baseline.py "$@"
