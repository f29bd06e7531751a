"""Roll-outs recorded from the original programs, replayed: positions, velocities, observations, rewards, endings.

Every bit agrees where the C library is the recorder's. Where it is not, its roundings grow: only the beginning agrees.
"""

import json

import gymnasium
import numpy as np
import pytest

import evogymcm as cm
from evogymcm.envs import Snapshot
from evogymcm.envs.tasks import own_tasks
from evogymcm.sim.kernels.readings import new_readings
from tests.envs.tools import PAPER_TASKS
from tests.golden import DATA, SAME_LIBRARY, parity

RECORDS = sorted((DATA / "tasks").glob("*.npz"))
EPISODES = sorted((DATA / "episodes").glob("*.npz"))
QUICK = ("bridge_at_x_150", "carrier_v0_7", "climber_v2_7", "loose_blocks_7")


def test_there_are_records_of_every_task_and_setting():
    seen = {(str(record["task"]), str(record["setting"])) for record in map(np.load, RECORDS)}
    assert seen >= {(task, setting) for task in PAPER_TASKS for setting in ("base", "R", "I")}
    assert {task for task, _ in seen} == set(own_tasks()) - set(parity.ADDED_TASKS)
    assert sum(path.stat().st_size for path in RECORDS) < 1_000_000


@pytest.mark.parametrize("path", RECORDS, ids=lambda path: path.stem)
def test_every_bit_of_a_record(path):
    replay = parity.replay(path, last=None if SAME_LIBRARY else 30)
    assert replay.steps >= 5
    if not SAME_LIBRARY:  # Flipper-v0 rewards differences of orientations, which jump with the last bit of a cosine
        assert replay.worst <= (0.005 if replay.task == "Flipper-v0" else 1e-9)
        assert "ended" not in replay.first
    elif "offset" in path.stem:  # a shift by hand also moves what the original measures orientations from
        assert set(replay.first) <= {"obs"}
        assert replay.is_equal
    else:
        assert replay.is_identical


@pytest.mark.skipif(not SAME_LIBRARY, reason="tanh or acos of this C library have other bits than the recorder's")
@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=() if p.stem in QUICK else pytest.mark.slow, id=p.stem) for p in EPISODES],
)
def test_every_bit_of_a_long_episode(path):
    """Positions and velocities of all objects, read from EvoGym's simulator itself; observations, rewards, endings."""
    replay = parity.replay(path)
    assert replay.steps >= 200
    assert replay.is_identical


POLES = [  # EvoGym's numbers: task, COM before and after, of which one coordinate passes its target, and reward
    (
        "Balancer-v0",
        (1.700967729152224, 0.5431317336115566),
        (1.6984262531069114, 0.5404012104093443),
        0.002124505461347459,
    ),
    (
        "Balancer-v1",
        (3.95842767298264, 0.6030283910674084),
        (3.9583957415513535, 0.5960360806205501),
        -0.000903596880755031,
    ),
]


@pytest.mark.parametrize(("task", "before", "after", "reward"), POLES)
def test_targets_are_rounded_as_in_evogym(task, before, after, reward):
    robots = [new_readings(1, 1), new_readings(1, 1)]
    robots[0].com[0], robots[1].com[0] = before, after
    assert cm.tasks[task].reward(*(Snapshot(robot) for robot in robots))[0] == reward


@pytest.mark.skipif(not SAME_LIBRARY, reason="tanh or acos of this C library have other bits than the recorder's")
@pytest.mark.parametrize("case", json.loads((DATA / "readings.json").read_text()), ids=lambda case: case["task"])
def test_every_bit_of_what_evogyms_methods_return(case):
    env = gymnasium.make(f"evogymcm/{case['task']}", body=case["body"]).unwrapped
    env.reset()
    for action in parity.draw_actions(case["seed"], case["steps"], *env.action_space.shape):
        env.step(action)
    for name, arguments, expected in case["readings"]:
        assert parity.digest(getattr(env, name)(*arguments)) == expected, (name, arguments)


def test_a_replay_tells_what_differs_first_and_how_far(tmp_path):
    with np.load(DATA / "episodes" / "carrier_v0_7.npz") as file:
        record = dict(file)
    record["digest_vel"][3] += 1
    record["pos"][1] += 1e-3
    np.savez(tmp_path / "changed.npz", **record)
    replay = parity.replay(tmp_path / "changed.npz", last=100)
    assert {"pos": 100, "vel": 3}.items() <= replay.first.items()
    assert replay.worst == pytest.approx(1e-3)
    assert not replay.is_equal


def test_unstable_world_ends_as_recorded():
    record = parity.load(DATA / "tasks" / "base_walker_unstable.npz")
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
