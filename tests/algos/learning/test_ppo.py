"""The learner's arithmetic: advantages at endings, one ratio per body, learning rate, KL guard."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from evogymcm.algos import PPOConfig, PPOLearner, make_actor, make_critic
from evogymcm.algos.learning.ppo import evened
from tests.algos.toy_env import ToyEnv, ToyTask

CONFIG = PPOConfig(num_worlds=3, rollout_steps=12, epochs=3, minibatch=18, hidden=8, target_kl=0.0, gamma=0.9)


@pytest.fixture
def rollout() -> TensorDict:
    """Two resets by time limit in each world."""
    env = ToyEnv(ToyTask(time_limit=5), num_worlds=3)
    torch.manual_seed(0)
    with torch.no_grad():
        return env.rollout(12, make_actor(env, 8), break_when_any_done=False)


def _learner(config: PPOConfig = CONFIG) -> PPOLearner:
    torch.manual_seed(1)
    env = ToyEnv(num_worlds=3)
    return PPOLearner(make_actor(env, 8), make_critic(env, 8), config)


def _gae_by_hand(learner: PPOLearner, rollout: TensorDict) -> torch.Tensor:
    """Advantages and targets as the definition has them, step by step."""
    gamma, lmbda = learner.config.gamma, learner.config.gae_lambda
    with torch.no_grad():
        value = learner.critic(rollout.clone())["state_value"]
        following = learner.critic(rollout["next"].clone())["state_value"]
    done, terminated = rollout["next", "done"].float(), rollout["next", "terminated"].float()
    reward = learner.config.reward_scale * rollout["next", "reward"]
    delta = reward + gamma * (1 - terminated) * following - value
    advantage, carried = torch.zeros_like(delta), torch.zeros(3, 1)
    for t in reversed(range(12)):
        carried = delta[:, t] + gamma * lmbda * (1 - done[:, t]) * carried
        advantage[:, t] = carried
    return advantage, advantage + value


@pytest.mark.parametrize("ending", ["truncated", "terminated"])
def test_advantages_bootstrap_where_time_ran_out_and_only_there(rollout, ending):
    if ending == "terminated":
        rollout["next", "terminated"] = rollout["next", "done"].clone()
    learner = _learner()
    samples, _ = learner._samples(rollout)
    advantage, target = _gae_by_hand(learner, rollout)
    torch.testing.assert_close(samples["value_target"].reshape(3, 12, 1), target, atol=1e-5, rtol=1e-4)
    expected = (advantage - advantage.mean()) / advantage.std()
    torch.testing.assert_close(samples["advantage"].reshape(3, 12, 1), expected, atol=1e-3, rtol=1e-3)


def test_advantages_scaled_by_world_are_those_over_the_mean_of_both_variances(rollout):
    rollout["next", "reward"][0] *= 50.0  # the world of a body that goes far
    learner = _learner(replace(CONFIG, advantage_scale="world"))
    samples, _ = learner._samples(rollout)
    advantage, target = _gae_by_hand(learner, rollout)
    torch.testing.assert_close(samples["value_target"].reshape(3, 12, 1), target, atol=1e-4, rtol=1e-4)
    scaled = torch.stack(
        [(world - advantage.mean()) / ((world.var() + advantage.var()) / 2).sqrt() for world in advantage]
    )
    expected = (scaled - scaled.mean()) / scaled.std()
    torch.testing.assert_close(samples["advantage"].reshape(3, 12, 1), expected, atol=1e-3, rtol=1e-3)
    plain = _learner()._samples(rollout)[0]["advantage"].reshape(3, 12, 1)
    assert expected[1:].std() > 1.2 * plain[1:].std()  # the others count for more


def test_designs_that_learn_side_by_side_are_scaled_each_by_itself():
    advantage = torch.randn(6, 5, 1, generator=torch.Generator().manual_seed(0))
    advantage[1::2] *= 30  # worlds of the second of two designs
    both, alone = evened(advantage, 2), evened(advantage[::2], None)
    torch.testing.assert_close(both[::2], alone)
    torch.testing.assert_close(both[1::2], evened(advantage[1::2], None))


def test_update_does_not_change_the_rollout(rollout):
    before = rollout.clone()
    _learner().update(rollout)
    assert (before == rollout).all()
    assert set(before.keys(True)) == set(rollout.keys(True))


def test_ratio_is_one_per_body_and_one_at_first(rollout):
    env = ToyEnv(num_worlds=3)
    torch.manual_seed(0)
    actor = make_actor(env, 8)
    learner = PPOLearner(actor, make_critic(env, 8), CONFIG)
    samples, _ = learner._samples(rollout)  # collected by the same weights
    out = learner.loss(samples)
    assert samples["action_log_prob"].shape == (36,)
    assert out["kl_approx"].item() == pytest.approx(0, abs=1e-5)  # the mean of the ratio's logarithm
    assert out["ESS"].item() == pytest.approx(1, abs=1e-5)  # the effective share of samples: all ratios are the same


def test_learning_rate_decays_with_what_remains(rollout):
    assert _learner().update(rollout, 0.25)["learning_rate"] == pytest.approx(0.25 * CONFIG.learning_rate)
    constant = _learner(replace(CONFIG, decay_learning_rate=False))
    assert constant.update(rollout, 0.25)["learning_rate"] == CONFIG.learning_rate


def test_exploration_is_limited_ever_more_tightly(rollout):
    learner = _learner(replace(CONFIG, initial_std=1.0, final_std=0.25, learning_rate=1e-6))
    learner.update(rollout, 1.0)
    assert learner.actor.log_std.exp().tolist() == pytest.approx([1.0, 1.0], abs=1e-3)
    learner.update(rollout, 0.5)
    assert learner.actor.log_std.exp().tolist() == pytest.approx([0.5, 0.5], abs=1e-3)
    with torch.no_grad():
        learner.actor.log_std.fill_(-3.0)  # less than the limit: left as learned
    learner.update(rollout, 0.5)
    assert learner.actor.log_std.tolist() == pytest.approx([-3.0, -3.0], abs=1e-3)


def test_saturated_actions_leave_the_weights_finite(rollout):
    learner = _learner()
    with torch.no_grad():
        learner.actor.heads.weight.mul_(1e5)
        learner.actor.log_std.fill_(-2.0)
    rollout["action", "actuation"][:, ::2] = 1.6
    for _ in range(3):
        learner.update(rollout)
    assert all(value.isfinite().all() for value in learner.actor.state_dict().values())


def test_a_step_without_a_finite_gradient_is_left_out(rollout):
    learner = _learner()
    before = [value.clone() for value in learner.actor.parameters()]
    rollout["action_log_prob"].fill_(-1e4)  # the ratio overflows
    learner.update(rollout)
    assert all(torch.equal(a, b) for a, b in zip(before, learner.actor.parameters(), strict=True))


def test_large_policy_change_ends_the_update(rollout):
    assert _learner(replace(CONFIG, learning_rate=0.1, target_kl=1e-6)).update(rollout)["epochs"] == 1
    assert _learner(replace(CONFIG, learning_rate=0.1)).update(rollout)["epochs"] == 3


def test_actor_and_critic_share_no_weights_and_all_learn(rollout):
    learner = _learner()
    before = {f"{net}.{key}": value.clone() for net in ("actor", "critic")
              for key, value in getattr(learner, net).named_parameters()}  # fmt: skip
    learner.update(rollout)
    for net in ("actor", "critic"):
        for key, value in getattr(learner, net).named_parameters():
            assert not torch.equal(value, before[f"{net}.{key}"]), f"{net}.{key}"
