#!/bin/sh
# Builds the wheel and tries it as users get it: alone in an empty environment, with the lowest and with the newest versions
# of what it asks for, away from the checkout. PYTHON and TORCH choose others: see environment.sh.
set -eu
. "$(dirname "$0")/bootstrap.sh"
. scripts/environment.sh
wheels=$(mktemp -d)
trap 'rm -rf "$wheels"' EXIT
.venv/bin/python -m build --no-isolation --wheel --outdir "$wheels" . > "$wheels/build.log" || { cat "$wheels/build.log"; exit 1; }
cp -r examples "$wheels"
for versions in ${*:-lowest newest}; do
    environment "$wheels/$versions" "$versions" "$(echo "$wheels"/*.whl)" -r pyproject.toml  # whose lowest uv takes
    echo "$versions:"
    (
        cd "$wheels/examples"
        export PATH="$wheels/$versions/bin:$PATH" NUMBA_CACHE_DIR="$wheels/$versions/numba"
        python -c 'import sys; from importlib.metadata import version as v
print("Python", sys.version.split()[0], *(f"{name} {v(name)}" for name in sys.argv[1:]), sep=", ")' \
            gymnasium numba numpy pettingzoo tensordict torch torchrl
        evogymcm --version
        evogymcm selfcheck
        python -c 'import train; train.main(total_steps=16_000)'
        python -c 'import collector; collector.main(8, 20, 1)'
        python -c 'import gymnasium_walk; gymnasium_walk.main(steps=50)'
        python pettingzoo_loop.py --bodies 3 --generations 1 --steps 20
    )
done
echo "wheel: passed"
