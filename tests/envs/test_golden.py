"""Roll-outs recorded from the original programs, replayed through Gymnasium: observations, rewards, endings."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import evogymcm as cm
from tests.envs.tools import PAPER_TASKS

ROOT = Path(__file__).resolve().parents[2]
RECORDS = sorted((ROOT / "tests" / "data" / "tasks").glob("*.npz"))

_spec = importlib.util.spec_from_file_location("parity", ROOT / "benchmarks" / "parity.py")
parity = importlib.util.module_from_spec(_spec)
sys.modules["parity"] = parity  # dataclasses look their module up
_spec.loader.exec_module(parity)

# Sums run in another order than in the original, so that roundings differ: 1e-9 holds while they have not
# grown, 1e-6 to the end of the records. Flipper-v0's reward is a difference of orientations, and those jump by up to
# 0.0045 at rest with the last bit of a cosine.
EARLY_BAR, LATE_BAR, ORIENTATION_BAR = 1e-9, 1e-6, 0.005


def test_there_are_records_of_every_task_and_setting():
    seen = {(str(record["task"]), str(record["setting"])) for record in map(np.load, RECORDS)}
    assert seen >= {(task, setting) for task in PAPER_TASKS for setting in ("base", "R", "I")}
    assert {task for task, _ in seen} <= set(cm.tasks)
    assert sum(path.stat().st_size for path in RECORDS) < 1_000_000


@pytest.mark.parametrize("path", RECORDS, ids=lambda path: path.stem)
def test_replay(path):
    replay = parity.replay(path)
    is_flipper = replay.task == "Flipper-v0"
    assert replay.same_endings
    assert replay.early <= (ORIENTATION_BAR if is_flipper else EARLY_BAR)
    assert replay.late <= (ORIENTATION_BAR if is_flipper else LATE_BAR)


def test_unstable_world_ends_as_recorded():
    record = np.load(ROOT / "tests" / "data" / "tasks" / "base_walker_unstable.npz")
    assert record["unstable"]
    env = parity.make_env(record)
    env.reset(seed=0)
    for step, action in enumerate(record["actions"]):
        before = env.points()
        observation, reward, terminated, truncated, info = env.step(action)
        assert terminated == info["unstable"] == (step == len(record["actions"]) - 1)
        if not terminated:
            last, last_return = observation, info["return"]
    assert reward == -3.0
    assert not truncated
    np.testing.assert_array_equal(observation, last)
    np.testing.assert_array_equal(env.points(), before)
    assert info["score"] == last_return
    assert info["return"] == last_return - 3.0
    # A new episode is as if nothing had been.
    first, info = env.reset()
    np.testing.assert_array_equal(first, parity.make_env(record).reset()[0])
    assert not info["unstable"]
