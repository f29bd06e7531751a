#!/bin/sh
# Runs all checks: style, types, documentation, tests. Arguments go to pytest, such as: -m "not slow"
set -eu
. "$(dirname "$0")/bootstrap.sh"
.venv/bin/ruff check
.venv/bin/ruff format --check
.venv/bin/mypy
NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict --quiet
exec .venv/bin/python -m pytest "$@"
