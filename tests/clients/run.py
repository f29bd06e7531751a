"""Runs the scripts of this folder, and the recipes of the documentation, each in an environment with what it asks for.

    python tests/clients/run.py [NAME ...] [--keep]

A script begins with what it needs (https://packaging.python.org/en/latest/specifications/inline-script-metadata); of
evogymcm it gets this checkout. Its recipe is the section of docs/other-libraries.md that names it. Prints a table,
says on the other stream what failed, and exits with 1 then. Needs the standard library only.
"""

import argparse
import itertools
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FOLDER = ROOT / "build" / "clients"
HEADER = re.compile(r"^# /// script\n(?P<lines>(?:# .*\n)+)# ///$", re.MULTILINE)
LIMIT = 1800  # seconds that a script may take
ALSO = ("gymnasium", "pettingzoo", "torchrl", "torch")  # whose versions are shown, too
VERSIONS = """
import sys
from importlib.metadata import version
print(", ".join(f"{name} {version(name)}" for name in sys.argv[1:]))
"""


def scripts():
    """Returns the scripts by name."""
    return {path.stem: path for path in sorted(HERE.glob("*.py")) if HEADER.search(path.read_text(encoding="utf-8"))}


def requirements(path):
    """Returns what a script needs."""
    lines = HEADER.search(path.read_text(encoding="utf-8"))["lines"]
    return tuple(tomllib.loads(re.sub(r"^# ?", "", lines, flags=re.MULTILINE))["dependencies"])


def distributions(needs):
    """Returns what these requirements name, with what the extras of evogymcm name in its place."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    named = []
    for need in needs:
        name, extra = re.match(r"([\w.-]+)(?:\[([\w.-]+)\])?", need).groups()
        named += distributions(extras[extra]) if name == "evogymcm" and extra else [name] * (name != "evogymcm")
    return named


def run(command, **options):
    """Returns whether a command succeeds, and the last lines that it prints."""
    try:
        done = subprocess.run(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            check=False,
            **options,
        )
    except subprocess.TimeoutExpired:
        return False, f"took more than {LIMIT} s"
    return done.returncode == 0, "\n".join(done.stdout.splitlines()[-25:])


def make_environment(folder, needs):
    """Makes a fresh environment and returns its Python and what went wrong, if anything did."""
    subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True)
    python = folder / "bin" / "python"
    own = [re.sub(r"^evogymcm(\[.*\])?", rf"evogymcm\1 @ {ROOT.as_uri()}", need) for need in needs]
    install = [python, "-m", "pip", "install", "--progress-bar", "off", "--disable-pip-version-check"]
    is_done, said = run([*install, "--constraint", ROOT / "constraints-ci.txt", *own])
    return python, "" if is_done else said


def try_out(path, python):
    """Returns what became of a script and of its recipe, and the seconds that they took."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_CACHE_DIR": str(FOLDER / "numba")}
    environment.pop("PYTHONPATH", None)
    outside = FOLDER / "outside"
    outside.mkdir(parents=True, exist_ok=True)
    begin, results = time.monotonic(), []
    for command in ([path], [HERE / "recipe.py", path.stem]):
        is_done, said = run([python, *command], cwd=outside, env=environment, timeout=LIMIT)
        results.append("passed" if is_done else "FAILED")
        if not is_done:
            print(f"{path.stem}, {command[0].stem}:\n{said}\n", file=sys.stderr, flush=True)
    shutil.rmtree(outside)
    return (*results, f"{time.monotonic() - begin:.0f}")


def main():
    """Runs what the command line names."""
    found = scripts()
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(found)}; all by default")
    parser.add_argument("--keep", action="store_true", help=f"keep the environments in {FOLDER.relative_to(ROOT)}")
    options = parser.parse_args()
    unknown = set(options.names) - set(found)
    if unknown:
        parser.error(f"there are no {sorted(unknown)}, but {list(found)}")
    chosen = sorted((found[name] for name in options.names or found), key=requirements)
    is_fine = True
    print("| client | with | script | recipe | seconds |\n| --- | --- | --- | --- | --- |", flush=True)
    for needs, paths in itertools.groupby(chosen, requirements):
        members = list(paths)
        folder = FOLDER / members[0].stem
        python, trouble = make_environment(folder, needs)
        versions = run([python, "-c", VERSIONS, *distributions(needs), *ALSO])[1]
        if trouble:
            print(f"{', '.join(needs)}: pip\n{trouble}\n", file=sys.stderr, flush=True)
        for path in members:
            row = ("", "NOT INSTALLED", "", "") if trouble else (versions, *try_out(path, python))
            print(f"| {path.stem} | {' | '.join(row)} |", flush=True)
            is_fine &= row[1:3] == ("passed", "passed")
        if not options.keep:
            shutil.rmtree(folder)
    sys.exit(not is_fine)


if __name__ == "__main__":
    main()
