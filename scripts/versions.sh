#!/bin/sh
# Runs the tests with the lowest or the newest versions that pyproject.toml allows, extras included, in .venv-lowest or
# .venv-newest, made anew. Arguments: lowest or newest; then those of pytest, -m "not slow" where there are none.
# PYTHON and TORCH choose others: see environment.sh.
set -eu
. "$(dirname "$0")/bootstrap.sh"
. scripts/environment.sh
versions=${1:?"lowest or newest?"}
shift
[ $# -gt 0 ] || set -- -m "not slow"
environment ".venv-$versions" "$versions" --editable ".[test]"
".venv-$versions/bin/python" -m evogymcm selfcheck  # first: where bits differ, so does much else
exec ".venv-$versions/bin/python" -m pytest "$@"
