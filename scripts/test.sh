#!/bin/sh
# Runs all checks: style, types, tests. Arguments go to pytest, such as: -m "not slow"
set -eu
. "$(dirname "$0")/bootstrap.sh"
.venv/bin/ruff check
.venv/bin/ruff format --check
.venv/bin/mypy
exec .venv/bin/python -m pytest "$@"
