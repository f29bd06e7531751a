#!/bin/sh
# Steps every world and the fuzzer with kernels that check their indices: one out of range is an IndexError, where it would
# read or overwrite other memory. Arguments: env-steps of each task (30), and of the fuzzer in all (50000).
set -eu
. "$(dirname "$0")/bootstrap.sh"
NUMBA_CACHE_DIR=$(mktemp -d)  # kernels that check are other kernels
export NUMBA_CACHE_DIR NUMBA_BOUNDSCHECK=1
trap 'rm -rf "$NUMBA_CACHE_DIR"' EXIT
.venv/bin/python benchmarks/fuzz.py --worlds "${1:-30}"
.venv/bin/python benchmarks/fuzz.py --steps "${2:-50000}"
