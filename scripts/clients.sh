#!/bin/sh
# Runs the scripts of other libraries' users, tests/clients/*.py, and the recipes of docs/other-libraries.md, each in a fresh
# environment with what it asks for, and prints a table: for a nightly job. Arguments: names of scripts, all where there
# are none; --keep keeps the environments in build/clients. PYTHON names the interpreter.
set -eu
. "$(dirname "$0")/bootstrap.sh"
exec .venv/bin/python tests/clients/run.py "$@"
