# Sourced by the other scripts: goes to the repository's root and makes .venv there, with the package and what its
# tests need; does nothing where that is done and neither file that says what to install has changed since.
# PYTHON names the interpreter to start from; by default it is the first one found that is new enough.
cd "$(dirname "$0")/.."

find_python() {
    for candidate in ${PYTHON:-python3 python3.14 python3.13 python3.12 python3.11 python}; do
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
    echo "Found no Python 3.11 or newer among: ${PYTHON:-python3, python3.11 to python3.14, python}" >&2
    return 1
}

installed=.venv/installed
if [ ! -f "$installed" ] || [ -n "$(find pyproject.toml constraints-ci.txt -newer "$installed")" ]; then
    if [ ! -x .venv/bin/python ]; then
        python=$(find_python)
        "$python" -m venv .venv
    fi
    .venv/bin/python -m pip install --quiet --disable-pip-version-check \
        --constraint constraints-ci.txt --editable ".[test]"
    touch "$installed"
fi
