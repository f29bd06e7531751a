"""The example scripts, with tiny budgets."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from evogymcm.envs import tasks

TESTS = Path(__file__).resolve().parent
EXAMPLES = TESTS.parent / "examples"
RUNS = {  # how to run each, and words that it prints
    "train": (lambda module: module.main(total_steps=64), ["invariant", "reactive", "of at most 9.55"]),
    "collector": (lambda module: module.main(num_worlds=8, steps=3, batches=2), ["/"]),
    "gymnasium_walk": (lambda module: module.main(steps=20), ["return ", " m\n"]),
    "pettingzoo_loop": (
        lambda module: module.main(module.Settings(bodies=3, generations=2, steps=5)),
        ["generation 1: best return"],
    ),
    "population_ppo": (
        lambda module: module.main(module.Settings(bodies=3, rollout_steps=8, updates=2)),
        ["update 1: mean reward"],
    ),
}


def load(name, monkeypatch):
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_every_example_is_tested():
    tests = "".join(path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py"))
    assert [path.name for path in EXAMPLES.glob("*.py") if path.stem not in tests] == []


@pytest.mark.parametrize("name", RUNS)
def test_example_runs(name, capsys, monkeypatch):
    run, words = RUNS[name]
    monkeypatch.setitem(tasks._REGISTRY, "Walker-v0", replace(tasks.as_task("Walker-v0"), time_limit=25))
    run(load(name, monkeypatch))
    said = capsys.readouterr().out
    assert all(word in said for word in words)
