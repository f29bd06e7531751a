"""Tasks whose episodes draw at random: seeds are obeyed, each world has its own generator, states keep them."""

import gymnasium
import numpy as np
import pytest

import evogymcm as cm
from evogymcm.envs import SoftRobotEnv
from tests.envs.tools import SMALL, assert_same, make_engine, outputs, random_actions, step_randomly

RANDOM_TASKS = ("BidirectionalWalker-v0", "Catcher-v0")


def drawn(engine):
    """What the episodes drew, one row a world."""
    return np.concatenate([values.reshape(engine.num_worlds, -1) for values in engine.memory.values()], axis=1)


def test_these_are_all_random_tasks():
    rng = np.random.default_rng(0)
    assert sorted(RANDOM_TASKS) == sorted(task for task in cm.tasks if cm.tasks[task].draw(rng))


@pytest.mark.parametrize("task", RANDOM_TASKS)
def test_seeds_decide(task):
    first, same, other = (make_engine(task, SMALL, 4, seed=seed) for seed in (5, 5, 50))
    np.testing.assert_array_equal(drawn(same), drawn(first))
    assert (drawn(other) != drawn(first)).any()
    start = drawn(first).copy()
    first.reset()
    assert (drawn(first) != start).any()  # a new episode is another draw
    same.reset()
    np.testing.assert_array_equal(drawn(same), drawn(first))
    first.set_seed(5)
    first.reset()
    np.testing.assert_array_equal(drawn(first), start)


@pytest.mark.parametrize("task", RANDOM_TASKS)
def test_worlds_have_generators_of_their_own(task):
    batch = make_engine(task, SMALL, 4, seed=5)
    for world in range(4):
        np.testing.assert_array_equal(drawn(make_engine(task, SMALL, seed=5 + world))[0], drawn(batch)[world])
    before = drawn(batch).copy()
    batch.reset(np.array([False, True, False, False]))
    assert (drawn(batch) != before).any(1).tolist() == [False, True, False, False]
    batch.set_seed([5, 6, 7, 8])
    batch.reset()
    np.testing.assert_array_equal(drawn(batch), before)
    with pytest.raises(ValueError, match=r"2 seeds.*4 worlds"):
        batch.set_seed([1, 2])


@pytest.mark.parametrize("task", RANDOM_TASKS)
def test_batch_equals_singles(task):
    batch = make_engine(task, SMALL, 10, seed=0)
    singles = [make_engine(task, SMALL, seed=world) for world in range(10)]
    for actuation in random_actions(batch, 8)[0]:
        batch.step(actuation)
        for world, single in enumerate(singles):
            single.step(actuation[[world]])
            assert_same({k: v[[world]] for k, v in outputs(batch).items()}, outputs(single))


@pytest.mark.parametrize("task", RANDOM_TASKS)
def test_state_keeps_draws_and_generators(task):
    engine, other = make_engine(task, SMALL, 3, seed=1), make_engine(task, SMALL, 3, seed=2)
    step_randomly(engine, 3)
    other.set_state(engine.state())
    for _ in range(2):
        step_randomly(engine, 2)
        step_randomly(other, 2)
        assert_same(outputs(other), outputs(engine))
        engine.reset(np.array([True, False, True]))
        other.reset(np.array([True, False, True]))
        assert_same(outputs(other), outputs(engine))


@pytest.mark.parametrize("task", RANDOM_TASKS)
def test_seeds_through_the_adapters(task):
    env = gymnasium.make(f"evogymcm/{task}", body=SMALL)
    vec = gymnasium.make_vec(f"evogymcm/{task}", num_envs=3, body=SMALL)
    torch_env = SoftRobotEnv(task, SMALL, 3, seed=0)
    torch_env.set_seed(4)
    expected = drawn(make_engine(task, SMALL, 3, seed=4))
    env.reset(seed=4)
    vec.reset(seed=4)
    torch_env.reset()
    np.testing.assert_array_equal(drawn(env.unwrapped.engine), expected[:1])
    np.testing.assert_array_equal(drawn(vec.unwrapped.engine), expected)
    np.testing.assert_array_equal(drawn(torch_env.engine), expected)
    vec.reset(seed=[6, 5, 4])
    np.testing.assert_array_equal(drawn(vec.unwrapped.engine)[2], expected[0])


def test_goals_follow_their_rule():
    engine = make_engine("BidirectionalWalker-v0", SMALL, 20, seed=0)
    for row, n in zip(engine.memory["goals"], engine.memory["n_goals"], strict=True):
        goals = np.round(row[:n] / 0.1)
        assert ((goals >= 20) & (goals <= 49)).all()
        way = np.abs(np.diff([35, *goals])).cumsum()
        assert way[-1] >= 100
        assert (way[:-1] < 100).all()


def test_reached_goal_is_replaced_by_the_next_in_the_reward():
    engine = make_engine("BidirectionalWalker-v0", SMALL, seed=0)
    goals, n = engine.memory["goals"][0].copy(), int(engine.memory["n_goals"][0])
    idle = np.ones((1, 6))
    for k in range(n):
        engine.simulator.move("robot", (goals[k] - engine.com[0, 0], 0.0), 0)
        engine.refresh()
        before = engine.com[0, 0]
        shown = engine.memory["goal"][0]
        engine.step(idle)
        x = engine.com[0, 0]
        position = engine.task.observation(engine.snapshot)["goal"][0]
        np.testing.assert_allclose(position, [shown, goals[shown], goals[shown] - x], rtol=0, atol=1e-12)
        now = int(engine.memory["goal"][0])
        is_last = bool(engine.terminated[0])
        expected = abs(goals[now] - before) - abs(goals[now] - x) + is_last
        np.testing.assert_allclose(engine.reward[0], expected, rtol=0, atol=1e-12)
        assert now > k or is_last
        if is_last:
            break
    assert is_last


def test_catchers_package_starts_where_it_was_drawn():
    engine = make_engine("Catcher-v0", SMALL, 8, seed=0)
    offsets = engine.memory["offset"]
    for world, (x, y) in enumerate(offsets):
        assert -6 <= x <= 4
        assert 0 <= y <= 5
        for name, corner in (("package", (21, 41)), ("peg1", (17, 39)), ("peg2", (19, 25))):
            points = engine.simulator.positions(name, world)
            np.testing.assert_allclose(points.min(1), 0.1 * np.add(corner, (x, y)), rtol=0, atol=1e-12)
    assert len({tuple(offset) for offset in offsets}) > 1
