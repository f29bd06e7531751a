"""Scores and returns of deterministic episodes, from one start and from several."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

import evogymcm as cm
from evogymcm.algos import evaluate, make_actor
from evogymcm.envs import SoftRobotEnv, TaskEngine, sine_gait
from evogymcm.sim.constants import Physics
from tests.algos.toy_env import SMALL, WIDE, ToyEnv, ToyTask


class _Wave(TensorDictModuleBase):
    """Acts on the toy's wave in all worlds, weaker in world 0: worlds end at different times."""

    in_keys, out_keys = ["voxels", "task"], [("action", "actuation"), ("action", "stiffness")]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        column, task = tensordict["voxels"][..., 19], tensordict["task"]
        sin, cos = task[..., 1:2], task[..., 2:3]
        wave = sin * torch.cos(2 * column) + cos * torch.sin(2 * column)
        strength = torch.full((len(wave), 1), 0.4)
        strength[0] = 0.1
        tensordict["action", "actuation"] = 1.1 + strength * wave
        tensordict["action", "stiffness"] = torch.full_like(wave, 2.0)
        return tensordict


def _by_hand(env: ToyEnv) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Score, return and length of the first episodes, added up from the rewards."""
    state, policy, n = env.reset(), _Wave(), env.batch_size[0]
    rewards, done = [[] for _ in range(n)], np.zeros(n, dtype=bool)
    while not done.all():
        step = env.step(policy(state))["next"]
        for i in np.flatnonzero(~done):
            rewards[i].append(step["reward"][i].item())
        done |= step["done"].squeeze(-1).numpy()
        state = step.exclude("reward")
    return tuple(np.array(x) for x in zip(*[(sum(r[:-1]), sum(r), len(r)) for r in rewards], strict=True))


def test_score_leaves_out_the_last_step():
    make = {"task": ToyTask(goal_x=0.6, time_limit=60), "bodies": [SMALL, WIDE], "num_worlds": 3}
    result = evaluate(_Wave(), ToyEnv(**make))
    score, returns, length = _by_hand(ToyEnv(**make))
    np.testing.assert_allclose(result.score, score, atol=1e-6)
    np.testing.assert_allclose(result.returns, returns, atol=1e-6)
    np.testing.assert_array_equal(result.length, length)
    assert len(set(length.tolist())) > 1
    assert result.returns[1] > 1.6  # the bonus is in the return
    assert result.score[1] <= 0.6  # and not in the score
    np.testing.assert_array_equal(result.goal, length < 60)
    assert result.summary()["goal_rate"] == result.goal.mean() > 0


def test_fraction_and_summary():
    result = evaluate(_Wave(), ToyEnv(num_worlds=2))
    np.testing.assert_allclose(result.ceiling, 1.0)
    np.testing.assert_allclose(result.fraction, result.score)
    summary = result.summary()
    assert summary["score"] == pytest.approx(result.score.mean())
    assert summary["fraction_of_ceiling"] == pytest.approx(result.fraction.mean())
    assert result.as_dict()["length"] == result.length.tolist()


def test_a_task_without_a_ceiling_has_no_fraction():
    class Open(ToyTask):
        def score_ceiling(self, x):
            return None

    result = evaluate(_Wave(), ToyEnv(Open(), num_worlds=2))
    assert np.isnan(result.ceiling).all()
    assert "fraction_of_ceiling" not in result.summary()


class _Trap(ToyEnv):
    """What looks like a goal is none: the episode ends there, with a bonus."""

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        step = super()._step(tensordict)
        self.reached = np.zeros_like(self.reached)
        return step.set("reached", torch.zeros_like(step["reached"]))


def test_what_ended_an_episode_tells_a_goal_not_the_last_reward():
    result = evaluate(_Wave(), _Trap(ToyTask(goal_x=0.6, time_limit=60), num_worlds=2))
    assert result.length[1] < 60
    assert result.returns[1] > result.score[1]
    assert not result.goal.any()


def test_evaluation_is_deterministic_and_draws_nothing():
    env = ToyEnv(noise=0.1, seed=3)
    actor = make_actor(env)
    before = torch.get_rng_state()
    first = evaluate(actor, ToyEnv(noise=0.1, seed=3))
    again = evaluate(actor, ToyEnv(noise=0.1, seed=3))
    assert torch.equal(before, torch.get_rng_state())
    np.testing.assert_array_equal(first.score, again.score)
    assert (evaluate(actor, ToyEnv(noise=0.1, seed=4)).score != first.score).any()


LONG = replace(cm.tasks["CaveCrawler-v0"], time_limit=160)  # long enough for contact to make much of little
DRAWN = replace(cm.tasks["BidirectionalWalker-v0"], time_limit=12)
TWO = ["Cave_Bot", "Walk_Bot"]


def make_cave(num_worlds, num_threads=1, bodies="Cave_Bot"):
    return SoftRobotEnv(LONG, bodies, num_worlds, material="reactive", num_threads=num_threads)


@pytest.fixture(scope="module")
def crawler():
    """A policy whose actions depend strongly on what it senses."""
    actor = make_actor(make_cave(1), generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        for weights in actor.parameters():
            weights.mul_(3.0)
    return actor


def test_the_exact_start_has_the_score_that_it_has_alone_whatever_other_starts_there_are(crawler):
    alone = evaluate(crawler, make_cave(2, bodies=TWO))
    np.testing.assert_array_equal(alone.starts, alone.score[None])
    assert np.isnan(alone.spread).all()
    assert "robust_score" not in alone.summary()
    some = evaluate(crawler, make_cave(6, bodies=TWO), 3)
    more = evaluate(crawler, make_cave(10, 3, bodies=TWO), 5)
    for name in ("score", "returns", "length", "ceiling"):
        np.testing.assert_array_equal(getattr(some, name), getattr(alone, name))
    np.testing.assert_array_equal(more.starts[:3], some.starts)  # of any number of starts and threads
    assert more.starts.shape == (5, 2)
    assert more.env_steps == 10 * 160
    np.testing.assert_allclose(more.robust, more.starts.mean(0))
    np.testing.assert_allclose(more.spread, more.starts.std(0, ddof=1))
    summary = more.summary()
    assert (summary["robust_score"], summary["spread"]) == pytest.approx((more.robust.mean(), more.spread.mean()))


def test_there_is_no_spread_at_rest_in_the_air_but_in_a_gait_with_contact():
    def still(engine):
        return np.ones(engine.occupancy.shape), None

    floating = TaskEngine(replace(LONG, time_limit=20), "Cave_Bot", 4, physics=Physics(gravity=0.0))
    rest = evaluate(still, floating, 4)
    assert rest.spread[0] < 1e-12
    assert evaluate(sine_gait, TaskEngine("Walker-v0", "Walk_Bot", 4), 4).spread[0] > 1e-3


def test_starts_of_one_world_draw_the_same_and_a_seed_tells_them():
    engine, exact = (TaskEngine(DRAWN, ["HHH/V.V", "VVV/H.H"], 8, seed=3) for _ in range(2))
    engine.set_starts(2, 5)
    engine.reset()
    goals, points = engine.memory["goals"], [engine.simulator.points(world) for world in range(8)]
    np.testing.assert_array_equal(goals[:4], goals[4:])
    assert len(np.unique(goals[:4], axis=0)) == 4
    for world in range(4):
        np.testing.assert_array_equal(points[world], exact.simulator.points(world))
        assert 0 < np.abs(points[world + 4] - points[world]).max() < 6e-6
    engine.set_starts(1)  # each world has its own draws again
    engine.reset()
    exact.reset()
    np.testing.assert_array_equal(engine.memory["goals"][4:], exact.memory["goals"][4:])
    results = [
        evaluate(sine_gait, TaskEngine(DRAWN, "HHH/V.V", 2), 2, start_seed=seed).starts.tolist() for seed in (0, 0, 1)
    ]
    assert results[0] == results[1] != results[2]
    assert results[0][0] == results[2][0]


def test_worlds_that_are_no_repetition_are_refused_before_they_are_played(crawler):
    with pytest.raises(ValueError, match="starts: got 3, which does not share 4 worlds into equal parts"):
        evaluate(crawler, make_cave(4), 3)
    with pytest.raises(ValueError, match="each with all of 2 designs"):
        evaluate(crawler, make_cave(4, bodies=TWO), 4)
    with pytest.raises(ValueError, match="starts: got 0"):
        evaluate(crawler, make_cave(1), 0)
    with pytest.raises(ValueError, match="starts: got 2, under a stream"):
        TaskEngine(DRAWN, lambda rng: cm.sample_body((3, 3), rng), 2, grid_shape=(3, 3)).set_starts(2)
    with pytest.raises(ValueError, match="env: got ToyEnv"):
        evaluate(_Wave(), ToyEnv(num_worlds=2), 2)


def test_work_is_that_of_the_engine_where_it_is_measured():
    options = {"material": "reactive", "num_threads": 1}
    task = replace(cm.tasks["Walker-v0"], time_limit=5)
    env = SoftRobotEnv(task, ["HVH/S.R", "HHH"], work_weight=1e-3, **options)
    policy = make_actor(env)
    result = evaluate(policy, env)
    assert result.work.tolist() == env.engine.work.tolist()
    assert (result.work[:, :2] > 0).all()
    assert result.summary()["net_stiffness_work"] == result.work[:, 3].mean()
    assert evaluate(policy, env, 1).work.tolist() == result.work.tolist()
    engine = TaskEngine(task, ["HVH/S.R", "HHH"], work_weight=0, **options)
    np.testing.assert_allclose(evaluate(policy, engine).work, result.work)  # as features of the engine
    plain = evaluate(policy, SoftRobotEnv(task, ["HVH/S.R", "HHH"], **options))
    assert plain.score.tolist() == result.score.tolist()
    assert plain.returns.tolist() == result.returns.tolist()
    assert np.isnan(plain.work).all()
    assert not [name for name in plain.summary() if "work" in name]
    several = SoftRobotEnv(task, ["HVH/S.R", "HHH"], 4, work_weight=0, **options)
    assert evaluate(policy, several, 2).work.tolist() == result.work.tolist()  # of the exact start
