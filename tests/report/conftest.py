"""Run folders of all kinds, from tiny runs."""

import json
from dataclasses import asdict, dataclass, replace
from itertools import product

import numpy as np
import pytest

from evogymcm.algos import BodyPPOConfig, PPOConfig, RunFolder, TrainConfig, train
from evogymcm.algos.codesign import CodesignConfig, SearchConfig, codesign
from evogymcm.envs import Task
from tests.registries import registered

PPO = PPOConfig(total_steps=64, num_worlds=4, rollout_steps=8, epochs=1, minibatch=16, hidden=8, eval_interval=32)
TINY = CodesignConfig(
    task="Dart-v0", shape=(2, 3), population=4, budget=6, finetune_steps=32,
    ppo=BodyPPOConfig(
        total_steps=64, num_worlds=4, rollout_steps=8, epochs=1, minibatch=16, hidden=8, eval_interval=32
    ),
)  # fmt: skip
BODY = "HVH/S.R"


@dataclass(frozen=True)
class Dart(Task):
    """Get far in a very short time."""

    def reward(self, before, after):
        return after.x - before.x


DART = Dart("Dart-v0", world="Walker-v0", spawn=(1, 1), time_limit=8, observes=("velocity", "orientation", "relative"))


@pytest.fixture(autouse=True, scope="module")
def _dart():
    """The task of the runs, which the fixtures of the whole session register for themselves."""
    with registered(DART):
        yield


@pytest.fixture(scope="session")
def training(tmp_path_factory):
    """A folder of four training runs: two arms, two seeds."""
    folder = tmp_path_factory.mktemp("training")
    for arm, seed in product(("invariant", "reactive"), range(2)):
        config = TrainConfig("Dart-v0", BODY, arm, ppo=replace(PPO, seed=seed))
        with registered(DART):
            train(config, run=folder / f"{arm}-{seed}", num_threads=1)
    return folder


@pytest.fixture(scope="session")
def evolved(tmp_path_factory):
    """A folder of three co-design runs."""
    folder = tmp_path_factory.mktemp("evolved")
    for arm, seed in (("reactive", 0), ("invariant", 0), ("invariant", 1)):
        search = SearchConfig(rounds=3) if arm == "invariant" else None
        config = replace(TINY, material=arm, search=search, seed=seed)
        with registered(DART):
            codesign(config, run=RunFolder(folder / f"{arm}-{seed}", asdict(config)))
    return folder


def record(task, arm, seed, score):
    """What a run of experiment A returns."""
    return {
        "task": task, "arm": arm, "seed": seed, "robot": "Walk_Bot", "finished": True, "env_steps": 1000,
        "train_seconds": 30.0, "untrained": {"score": 0.1, "return": 0.1}, "best_score": score + 0.5, "ceiling": 9.55,
        "final": {"score": score, "return": score + 1, "fraction_of_ceiling": score / 9.55},
        "curve": [[0, 0.0, 0.1], [500, 1.0, score + 0.5], [1000, 2.0, score]],
    }  # fmt: skip


@pytest.fixture
def suite(tmp_path):
    """A suite of experiment A of which only the results are left."""
    folder = tmp_path / "suite-table"
    folder.mkdir()
    arms = {"control-only": 8.0, "co-optimisation": 9.0}
    runs = [record("Walker-v0", arm, seed, score + 0.25 * seed) for arm, score in arms.items() for seed in range(3)]
    paper = {"control-only": (9.46, 0.03), "co-optimisation": (9.55, 0.01)}
    results = {
        "suite": {"tasks": ["Walker-v0"], "arms": list(arms), "seeds": [0, 1, 2], "ppo": {"total_steps": 1000}},
        "processes": 2,
        "machine": {"cpu": "Some Processor", "cores": 2, "memory_gib": 15.5, "system": "Linux x86_64"},
        "versions": {"python": "3.11.7", "torch": "2.13.0", "ribs": None},
        "commit": "0123abc",
        "wall_seconds": 7265.0,
        "summary": [
            {"task": "Walker-v0", "arm": arm, "paper_score": mean, "paper_std": std}
            for arm, (mean, std) in paper.items()
        ],
        "runs": runs,
    }
    (folder / "results.json").write_text(json.dumps(results))
    return folder


@pytest.fixture
def signals():
    """Signals of two actuators and a soft voxel that follow a sine."""
    times = np.arange(60)

    def voxel(column, is_actuator):
        return {
            "row": 0, "column": column, "is_actuator": is_actuator,
            "actuation": (1 + 0.3 * np.sin(times / 5)).tolist() if is_actuator else None,
            "stiffness": (1 + 0.2 * np.sin(times / 5 - 1)).tolist(), "contact": (times % 20 < 5).astype(int).tolist(),
            "frequency_actuation": 10.6 if is_actuator else None, "frequency_stiffness": 10.6,
            "phase_lag": 1.0 if is_actuator else None, "lag_steps": 5 if is_actuator else None,
            "correlation": 0.9 if is_actuator else None,
        }  # fmt: skip

    return {
        "task": "Walker-v0", "step_seconds": 0.003, "voxels": [voxel(0, True), voxel(1, False), voxel(2, True)],
        "spectra": {"frequency": [0.0, 5.0, 10.0], "actuation": [0.0, 1.0, 4.0], "stiffness": [0.0, 1.0, 2.0]},
        "contact": {"lags": [-1, 0, 1], "stiffness": [1.0, 1.1, 1.2], "n_impacts": 7, "rise_before_impact": 0.125},
    }  # fmt: skip
