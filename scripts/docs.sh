#!/bin/sh
# Builds the documentation into site/. Arguments go to mkdocs instead, such as: serve
set -eu
. "$(dirname "$0")/bootstrap.sh"
[ $# -gt 0 ] || set -- build --strict --quiet
export NO_MKDOCS_2_WARNING=1  # its advertisement would be the only thing said
exec .venv/bin/mkdocs "$@"
