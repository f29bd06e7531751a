"""Scores and returns of deterministic episodes."""

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from evogymcm.algos import evaluate, make_actor
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
