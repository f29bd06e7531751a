# Sourced by versions.sh and wheel.sh: `environment FOLDER lowest|newest REQUIREMENTS...` makes a fresh virtual environment
# with the lowest or the newest versions that pyproject.toml allows. `lowest` takes the oldest Python found, `newest` the
# newest; PYTHON names another. TORCH=2.13.0 takes that torch, as pip finds it, in place of the lowest or newest: where none
# but CUDA's is to be had, it spares its gigabytes.
environment() {
    folder=$1 which=$2
    shift 2
    case $which in
        lowest) resolution=lowest-direct pythons="python3.11 python3.12 python3.13 python3.14 python3" ;;
        newest) resolution=highest pythons="python3.14 python3.13 python3.12 python3.11 python3" ;;
        *) echo "Versions: got $which, allowed are lowest and newest" >&2; return 2 ;;
    esac
    for python in ${PYTHON:-$pythons}; do
        if "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then break; fi
    done
    "$python" -m venv --clear "$folder"
    : > "$folder/overrides.txt"
    if [ -n "${TORCH:-}" ]; then
        echo "torch==$TORCH" > "$folder/overrides.txt"
        "$folder/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps "torch==$TORCH"
    fi
    .venv/bin/uv pip install --quiet --python "$folder/bin/python" --resolution "$resolution" \
        --overrides "$folder/overrides.txt" "$@"
    [ "$which" = newest ] || "$folder/bin/python" scripts/check_lowest.py ${TORCH:+torch}
}
