"""What importing the package loads, and which way its imports point."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import evogymcm

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("sim", "envs", "algos", "report", "fabrication", "studio", "commands")
LAYERS = (*(f"evogymcm.{part}" for part in PARTS), "benchmarks")  # each may import those before it
MODULES = sorted(path for folder in ("evogymcm", "benchmarks") for path in (ROOT / folder).rglob("*.py"))


IMPORTS = """
import importlib, sys

for name in sys.argv[1:]:
    importlib.import_module(name)
    print(name, *sorted({"numba", "tensordict", "torch", "torchrl"} & set(sys.modules)))
"""


def layer(module):
    """The layer's number, or None for what all layers may use; benchmarks are known by their file's name alone."""
    if (ROOT / "benchmarks" / f"{module.split('.')[0]}.py").exists():
        module = f"benchmarks.{module}"
    numbers = [i for i, name in enumerate(LAYERS) if module == name or module.startswith(f"{name}.")]
    return numbers[0] if numbers else None


def imported_modules(path):
    """Absolute names of everything imported anywhere in a file, inside functions too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_imports_load_no_torch_and_the_package_no_numba():
    parts = ["sim", "sim.world", "algos.codesign.config", "algos.learning.playing"]
    command = [sys.executable, "-c", IMPORTS, "evogymcm", *(f"evogymcm.{part}" for part in parts)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT)
    first, *others = done.stdout.splitlines()
    assert first == "evogymcm"  # numba is what import time is made of
    assert [line.removesuffix(" numba") for line in others] == [f"evogymcm.{part}" for part in parts]


def test_imports_point_one_way():
    wrong = []
    for path in MODULES:
        own = layer(".".join(path.relative_to(ROOT).with_suffix("").parts))
        if own is not None:
            for module in imported_modules(path):
                other = layer(module)
                if other is not None and other > own:
                    wrong.append(f"{path.relative_to(ROOT)} imports {module}")
    assert not wrong


def test_simulator_and_bodies_know_no_torch():
    files = [*ROOT.glob("evogymcm/sim/**/*.py"), *ROOT.glob("evogymcm/*.py")]
    for path in files:
        packages = {name.split(".")[0] for name in imported_modules(path)}
        assert not packages & {"torch", "torchrl", "tensordict"}, path


def test_public_names():
    assert set(evogymcm.__all__) <= set(dir(evogymcm))
    assert evogymcm.Body.from_text("HHH/H.H").n_actuators == 5
    with pytest.raises(AttributeError, match="nonsense"):
        _ = evogymcm.nonsense
