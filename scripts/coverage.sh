#!/bin/sh
# Measures line coverage of the package, which must be 90 % at least. A kernel's lines count only where they run as plain
# Python, some thousand times slower: so first the kernels' own tests, without the longest, run without the JIT, and then
# all tests with it. Arguments go to pytest in the second run, -m "not slow" where there are none.
set -eu
. "$(dirname "$0")/bootstrap.sh"
[ $# -gt 0 ] || set -- -m "not slow"
# With an empty cache everything is compiled, so that the code that makes machine code counts too.
NUMBA_CACHE_DIR=$(mktemp -d)
export NUMBA_CACHE_DIR
trap 'rm -rf "$NUMBA_CACHE_DIR"' EXIT

NUMBA_DISABLE_JIT=1 .venv/bin/coverage run --source=evogymcm -m pytest --quiet -W ignore::RuntimeWarning \
    tests/sim/test_vectors.py tests/sim/test_springs.py tests/sim/test_contact.py tests/sim/test_rare_paths.py \
    tests/sim/test_trees.py tests/sim/test_contact_order.py \
    tests/sim/test_simulator.py::test_edge_rules_say_what_a_shared_edge_is \
    tests/envs/test_readings.py tests/envs/test_core.py::test_neighbours_are_the_connected_ones \
    tests/envs/test_render.py::test_downscale_is_the_mean -k "not flat_observation and not rests_on"
.venv/bin/coverage run --append --source=evogymcm -m pytest "$@"
.venv/bin/coverage report --show-missing --skip-covered --fail-under=90
