"""The example scripts, with tiny budgets."""

import pytest

from tests.examples import EXAMPLES, load_example
from tests.registries import shorten

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


ELSEWHERE = {"custom_task", "record_video"}  # tested in test_custom_task.py and envs/test_render.py


def test_every_example_is_tested():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == ELSEWHERE | set(RUNS)


@pytest.mark.filterwarnings("error::FutureWarning")
@pytest.mark.usefixtures("own_registries")
@pytest.mark.parametrize("name", RUNS)
def test_example_runs(name, capsys):
    run, words = RUNS[name]
    shorten("Walker-v0", 25)
    run(load_example(name))
    said = capsys.readouterr().out
    assert all(word in said for word in words)
