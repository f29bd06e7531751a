"""Tasks of one's own under their ids: registered again, and in other processes."""

import os
import pickle
import subprocess
import sys
import warnings
from dataclasses import dataclass, make_dataclass, replace
from pathlib import Path

import gymnasium
import pytest

import evogymcm as cm
from evogymcm.envs import GymnasiumEnv
from evogymcm.envs import tasks as task_package
from evogymcm.envs.tasks.walking import Walking

pytestmark = pytest.mark.usefixtures("own_registries")

ROOT = Path(__file__).resolve().parents[2]
FIELDS = {"world": "Walker-v0", "spawn": (1, 1), "time_limit": 7, "observes": ("velocity", "relative")}


@dataclass(frozen=True)
class Mine(Walking):
    """As a notebook's cell defines it."""


def as_in_a_notebook(name="Mine"):
    """A new class of the same module and name, as running a cell again makes it."""
    return make_dataclass(name, [], bases=(Walking,), frozen=True, namespace={"__module__": __name__})


def test_a_cell_run_again_replaces_its_task_with_a_warning():
    cm.register_task(Mine("Mine-v0", **FIELDS))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cm.register_task(Mine("Mine-v0", **FIELDS))  # the same
    again = as_in_a_notebook()("Mine-v0", **FIELDS | {"time_limit": 3})
    with pytest.warns(UserWarning, match="'Mine-v0': its former definition is replaced") as caught:
        assert cm.register_task(again) is again
    assert len(caught) == 1  # Gymnasium has nothing to add
    assert caught[0].filename == __file__
    assert cm.tasks["Mine-v0"] is again
    env = gymnasium.make("evogymcm/Mine-v0", body="HH/VV")
    assert env.unwrapped.engine.task == again
    assert env.spec.max_episode_steps == 3


def test_another_task_replaces_one_only_where_that_is_said():
    cm.register_task(Mine("Mine-v0", **FIELDS))
    other = as_in_a_notebook("Other")("Mine-v0", **FIELDS)
    with pytest.raises(ValueError, match=r"'Mine-v0' is taken by a tests.envs.test_registration.Mine; .*replace=True"):
        cm.register_task(other)
    walker = replace(cm.tasks["Walker-v0"], time_limit=7)
    with pytest.raises(ValueError, match="'Walker-v0' is taken by a evogymcm"):
        cm.register_task(walker)  # of the same class, but the package's
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cm.register_task(other, replace=True)
        cm.register_task(walker, replace=True)
    assert cm.tasks["Mine-v0"] is other
    assert gymnasium.make_vec("evogymcm/Walker-v0", num_envs=1, body="HH/VV").engine.task == walker


def test_a_spec_brings_its_task_along():
    task = cm.register_task(Mine("Mine-v0", **FIELDS))
    spec = pickle.loads(pickle.dumps(gymnasium.spec("evogymcm/Mine-v0")))
    del task_package._REGISTRY["Mine-v0"], gymnasium.registry["evogymcm/Mine-v0"]
    assert gymnasium.make(spec, body="HH/VV").unwrapped.engine.task == task
    with pytest.raises(ValueError, match=r"got 'Mine-v0', known are .* and \d\d more; .*the task itself"):
        GymnasiumEnv("Mine-v0", "HH/VV")
    with pytest.raises(ValueError, match="Walker-v0") as error:
        GymnasiumEnv("Walkr-v0", "HH/VV")
    assert len(str(error.value)) < 300


SCRIPT = """
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import gymnasium
import numpy as np

import evogymcm as cm
from evogymcm.envs import Task


@dataclass(frozen=True)
class Mine(Task):
    def reward(self, before, after):
        return np.full(len(after.x), 7.0)


def vector(task):
    envs = gymnasium.make_vec(
        "evogymcm/Mine-v0", 1, "async", vector_kwargs={"context": "spawn"}, body="HH/VV"
    )
    envs.reset(seed=0)
    print(envs.step(envs.action_space.sample())[1].tolist())
    envs.close()


def torchrl(task):
    from torchrl.envs import ParallelEnv

    from evogymcm.envs import SoftRobotEnv

    env = ParallelEnv(1, partial(SoftRobotEnv, task, "HH/VV", 1, num_threads=1), mp_start_method="spawn")
    print(env.rollout(1)["next", "reward"].flatten().tolist())
    env.close()


def executor(task):
    from evogymcm.algos import codesign
    from evogymcm.algos.codesign import codesign_all

    config = codesign.CodesignConfig("Mine-v0", shape=(2, 2), population=2, budget=2, ppo=PPO)
    with ProcessPoolExecutor(1, get_context("spawn")) as processes:
        ((name, result),) = codesign_all({"one": config}, Path.cwd(), processes)
    print([result.best.fitness])


def workers(task):
    from evogymcm.algos import codesign

    config = codesign.CodesignConfig("Mine-v0", shape=(2, 2), population=2, budget=2, ppo=PPO, piece=1)
    print([codesign.codesign(config, workers=2).best.fitness])


if __name__ == "__main__":  # so that workers do not register it
    task = cm.register_task(Mine("Mine-v0", world="Walker-v0", spawn=(1, 1), time_limit=2, observes=("velocity",)))
    for use in USES:
        use(task)
"""


@pytest.mark.parametrize("uses", ["vector", pytest.param("torchrl, executor, workers", marks=pytest.mark.slow)])
def test_a_task_of_the_main_module_works_in_spawned_workers(tmp_path, uses):
    ppo = "codesign.CodesignConfig('Walker-v0').ppo.__class__(total_steps=8, num_worlds=2, rollout_steps=2, hidden=4)"
    script = tmp_path / "mine.py"
    script.write_text(SCRIPT.replace("USES", f"({uses},)").replace("PPO", ppo))
    done = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert done.stdout.split() == ["[7.0]"] * (1 + uses.count(",")), done.stderr[-3000:]
