"""The six tasks of the EvoGymCM paper: their numbers, rewards and endings."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

import evogymcm as cm
from evogymcm.envs.tasks.walking import Walking
from evogymcm.sim.constants import Physics
from tests.envs.tools import PAPER_ROBOTS, PAPER_TASKS, SMALL, make_engine, move, step_randomly, turn

# EvoGym 2.0.0 with the paper's robots and the constant action 1.0 for a whole episode.
# Points, actuators, size of the observation, COM and hull area at reset, return, final COM.
CHECKS = {
    "Walker-v0": (28, 10, 58, (0.35, 0.31428571), 0.2, 0.0117735, (0.3617735, 0.3111925)),
    "BridgeWalker-v0": (33, 11, 69, (0.43939394, 0.76969697), 0.235, 0.0527773, (0.4921712, 0.7181129)),
    "DownStepper-v0": (26, 9, 66, (0.31538462, 1.38846154), 0.2, 0.0932736, (0.4086583, 1.1992206)),
    "CaveCrawler-v0": (24, 8, 72, (0.32083333, 0.42916667), 0.17, 0.1690721, (0.4899055, 0.2908530)),
    "AreaMaximizer-v0": (36, 11, 72, (0.95833333, 0.35555556), 0.245, -0.0713284, (0.8658679, 0.3382888)),
    "AreaMinimizer-v0": (26, 9, 52, (0.95769231, 0.35384615), 0.205, 0.2976156, (0.8564892, 0.2772111)),
}
LIMITS = dict.fromkeys(PAPER_TASKS, 500) | {
    "CaveCrawler-v0": 1000,
    "AreaMaximizer-v0": 600,
    "AreaMinimizer-v0": 600,
}
CEILINGS = {"Walker-v0": 9.55, "BridgeWalker-v0": 5.561, "DownStepper-v0": 7.085, "CaveCrawler-v0": 6.579}


def idle(engine):
    return np.ones(engine.occupancy.shape)


@pytest.mark.parametrize("task", PAPER_TASKS)
def test_reset_matches_evogym(task):
    engine = make_engine(task, PAPER_ROBOTS[task])
    points, actuators, size, com, _, _, _ = CHECKS[task]
    assert engine.simulator.positions("robot", 0).shape == (2, points)
    assert engine.actuators.sum() == actuators
    assert engine.flat.shape == (1, size)
    assert engine.flat.dtype == np.float64
    np.testing.assert_allclose(engine.com[0], com, rtol=0, atol=5e-9)


@pytest.mark.parametrize("task", PAPER_TASKS)
def test_hull_area_at_reset(task):
    # The ceiling of the shrinking task is ten times the area, whatever the robot.
    engine = make_engine("AreaMinimizer-v0", PAPER_ROBOTS[task])
    np.testing.assert_allclose(engine.score_ceiling, 10 * CHECKS[task][4], rtol=0, atol=1e-12)


@pytest.mark.parametrize("task", PAPER_TASKS)
def test_idle_episode_matches_evogym(task):
    engine = make_engine(task, PAPER_ROBOTS[task], with_voxels=False)
    for _ in range(LIMITS[task]):
        assert not engine.truncated[0]
        engine.step(idle(engine))
    assert engine.truncated[0]
    assert not engine.terminated[0]
    # Cave_Bot falls without deforming, corner over corner of the floor: the last bit decides, and is followed.
    np.testing.assert_allclose(engine.returns, CHECKS[task][5], rtol=0, atol=1e-7)
    np.testing.assert_allclose(engine.com[0], CHECKS[task][6], rtol=0, atol=1e-7)


@pytest.mark.parametrize("task", PAPER_TASKS)
def test_limits_and_ceilings(task):
    engine = make_engine(task, PAPER_ROBOTS[task])
    assert engine.task.time_limit == LIMITS[task]
    if task in CEILINGS:
        np.testing.assert_allclose(engine.score_ceiling, CEILINGS[task], rtol=0, atol=5e-4)
    elif task == "AreaMaximizer-v0":
        assert np.isnan(engine.score_ceiling[0])


def test_symmetric_body_starts_half_a_grid_from_the_spawn():
    engine = make_engine("Walker-v0", "HHHHH/HHHHH")
    np.testing.assert_allclose(engine.com[0], (0.35, 0.2), rtol=0, atol=1e-12)
    np.testing.assert_allclose(engine.score_ceiling, 9.55, rtol=0, atol=1e-12)


def test_empty_bottom_row_starts_one_voxel_higher():
    low, high = make_engine("Walker-v0", "HHH"), make_engine("Walker-v0", "HHH/...")
    np.testing.assert_allclose(high.com - low.com, [[0.0, 0.1]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("task", PAPER_TASKS[:4])
def test_reward_is_the_way_forward(task):
    engine = make_engine(task, PAPER_ROBOTS[task])
    for _ in range(20):
        before = engine.com[0, 0]
        step_randomly(engine, 1)
        np.testing.assert_allclose(engine.reward, engine.com[:, 0] - before, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("task", "goal", "bonus", "y"),
    [
        ("Walker-v0", 9.9, 1.0, 0.0),
        ("BridgeWalker-v0", 6.0, 1.0, 0.0),
        ("DownStepper-v0", 7.4, 2.0, -0.9),
        ("CaveCrawler-v0", 6.9, 1.0, 2.0),  # behind a wall: seen from above the cave
    ],
)
def test_goal_ends_the_episode_with_its_bonus(task, goal, bonus, y):
    engine = make_engine(task, PAPER_ROBOTS[task], 2)
    start = engine.com[0, 0]
    move(engine, goal - start - 0.03, y, world=0)
    move(engine, goal - start + 0.03, y, world=1)
    before = engine.com[:, 0]
    engine.step(idle(engine))
    assert engine.terminated.tolist() == [False, True]
    assert not engine.truncated.any()
    np.testing.assert_allclose(engine.reward, engine.com[:, 0] - before + [0.0, bonus], rtol=0, atol=1e-12)
    assert engine.reached.tolist() == [False, True]
    np.testing.assert_array_equal(engine.score, 0.0)  # the first step is the last
    np.testing.assert_array_equal(engine.returns, engine.reward)


@pytest.mark.parametrize("task", PAPER_TASKS[:4])
@pytest.mark.parametrize("angle", [1.5, 1.65, math.pi, 4.65, 4.8])
def test_only_the_stairs_punish_falling_over(task, angle):
    engine = make_engine(task, PAPER_ROBOTS[task])
    move(engine, y=2.0)
    turn(engine, angle)
    before = engine.com[0, 0]
    engine.step(idle(engine))
    is_fallen = task == "DownStepper-v0" and math.pi / 2 < angle < 3 * math.pi / 2
    assert engine.terminated[0] == is_fallen
    assert not engine.reached[0]
    np.testing.assert_allclose(engine.reward[0], engine.com[0, 0] - before - 3.0 * is_fallen, rtol=0, atol=1e-12)


def test_goal_and_fall_in_one_step_both_count():
    engine = make_engine("DownStepper-v0", "Down_Bot")
    move(engine, 7.43 - engine.com[0, 0], 1.0)
    turn(engine, math.pi)
    before = engine.com[0, 0]
    engine.step(idle(engine))
    assert engine.terminated[0]
    assert engine.reached[0]
    np.testing.assert_allclose(engine.reward[0], engine.com[0, 0] - before + 2.0 - 3.0, rtol=0, atol=1e-12)


def test_falling_off_the_left_end_is_no_goal_whatever_the_last_reward():
    engine = make_engine("Flipper-v0", "Walk_Bot", 2)
    move(engine, 0.09 - engine.com[0, 0], 1.0)
    move(engine, y=1.0, world=1)
    for world in range(2):
        turn(engine, 1.0, world)  # moved outside a step, so the next pays for nothing ...
    engine._reader.now.robot.orientation[:] = 0.5  # ... but from here on for the turn
    engine.step(idle(engine))
    assert (engine.reward > 0.0).all()
    assert engine.terminated.tolist() == [True, False]
    assert not engine.reached.any()


@dataclass(frozen=True)
class Ending(Walking):
    """Walking that ends at once, as `ending` says."""

    ending: tuple = ()

    def endings(self, after):
        yield (after.x > 0.0, *self.ending)


@pytest.mark.parametrize(
    ("ending", "is_goal"),
    [((0.5,), True), ((0.0,), False), ((-1.0,), False), ((0.0, True), True), ((1.0, False), False)],
)
def test_ending_is_a_goal_where_it_says_so_or_pays(ending, is_goal):
    task = Ending("Ending", "Walker-v0", (1, 1), 9, ("velocity",), ending=ending)
    engine = make_engine(task, SMALL, 2)
    engine.step(idle(engine), mask=np.array([True, False]))
    assert engine.terminated.tolist() == [True, False]
    assert engine.reached.tolist() == [is_goal, False]
    state = engine.state()
    engine.reset()
    assert not engine.reached.any()
    engine.set_state(state)
    assert engine.reached.tolist() == [is_goal, False]


def test_unstable_step_reaches_no_goal():
    task = Ending("Ending", "Walker-v0", (1, 1), 99, ("velocity",), ending=(1.0, True))
    engine = make_engine(task, "Walk_Bot", physics=Physics(substep=2e-3))
    for _ in range(60):
        step_randomly(engine, 1)
        assert engine.reached[0] != engine.unstable[0]
        if engine.unstable[0]:
            return
    raise AssertionError("the far too long substep should have blown the robot up")


@pytest.mark.parametrize(("task", "gain"), [("AreaMaximizer-v0", 10.0), ("AreaMinimizer-v0", -10.0)])
def test_area_reward_telescopes(task, gain):
    engine = make_engine(task, PAPER_ROBOTS[task])
    step_randomly(engine, 25)
    ceiling = make_engine("AreaMinimizer-v0", PAPER_ROBOTS[task]).score_ceiling[0]
    assert not engine.terminated[0]
    area = engine.snapshot.robot.hull_area[0]
    np.testing.assert_allclose(engine.returns[0], gain * (area - ceiling / 10), rtol=0, atol=1e-12)


def test_time_limit_truncates_at_its_own_step():
    engine = make_engine(replace(cm.tasks["Walker-v0"], time_limit=3), "Walk_Bot")
    seen = []
    for _ in range(3):
        engine.step(idle(engine))
        seen.append((bool(engine.truncated[0]), bool(engine.terminated[0])))
    assert seen == [(False, False), (False, False), (True, False)]
    engine.reset()
    assert not engine.truncated[0]
    assert engine.length[0] == 0


def test_time_limit_and_goal_in_one_step():
    engine = make_engine(replace(cm.tasks["Walker-v0"], time_limit=1), "Walk_Bot")
    move(engine, 9.6)
    engine.step(idle(engine))
    assert engine.terminated[0]
    assert engine.truncated[0]


def test_score_leaves_out_the_last_reward_only():
    engine = make_engine("Walker-v0", "Walk_Bot", 2)
    rewards = []
    for _ in range(6):
        step_randomly(engine, 1)
        rewards.append(engine.reward.copy())
    np.testing.assert_allclose(engine.returns, np.sum(rewards, 0), rtol=0, atol=1e-15)
    np.testing.assert_allclose(engine.score, np.sum(rewards[:-1], 0), rtol=0, atol=1e-15)


def test_registering_the_same_task_again_does_nothing_and_another_raises():
    task = cm.tasks["Walker-v0"]
    assert cm.register_task(task) is task
    with pytest.raises(ValueError, match="Walker-v0"):
        cm.register_task(replace(task, time_limit=7))
