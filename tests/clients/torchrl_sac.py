# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm"]
# ///
"""TorchRL's SAC: a replay buffer and losses for one flat action, on the batched simulator in TorchRL's wrapper."""

import gymnasium as gym
import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn, optim
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import DoubleToFloat, ExplorationType, GymWrapper, TransformedEnv, set_exploration_type
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate

import evogymcm  # noqa: F401 - registers the ids

NUM_ENVS, BATCH = 16, 320


def make_env():
    options = {"body": "HHH/V.V", "max_episode_steps": 20, "autoreset_mode": "SameStep"}
    envs = gym.make_vec("evogymcm/AreaMaximizer-v0", num_envs=NUM_ENVS, **options)
    return TransformedEnv(GymWrapper(envs), DoubleToFloat())


def make_losses(env):
    sees, acts = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    space = env.action_spec_unbatched.space
    net = nn.Sequential(MLP(sees, 2 * acts, num_cells=[64, 64]), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(net, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=env.action_spec_unbatched,
        distribution_class=TanhNormal,
        distribution_kwargs={"low": space.low, "high": space.high},
    )
    value = ValueOperator(MLP(sees + acts, 1, num_cells=[64, 64]), in_keys=["observation", "action"])
    losses = SACLoss(actor, value, num_qvalue_nets=2, alpha_init=0.01)
    losses.make_value_estimator(gamma=0.95)
    return actor, losses


def evaluate(env, actor):
    """Returns the mean return of an episode by the policy's means."""
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        data = env.rollout(20, actor, break_when_any_done=False)
    assert data["next", "truncated"][:, -1].all()
    assert not data["next", "done"][:, :-1].any()
    return data["next", "reward"].sum(1).mean().item()


def train(batches, updates=16):
    """Returns the policy's parameters, and the mean return of an episode before training and after it."""
    torch.manual_seed(0)
    env = make_env()
    actor, losses = make_losses(env)
    before = evaluate(env, actor)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(10_000), batch_size=256)
    target, optimiser = SoftUpdate(losses, tau=0.02), optim.Adam(losses.parameters(), 3e-3)
    collector = Collector(env, actor, frames_per_batch=BATCH, total_frames=batches * BATCH)
    for data in collector:
        assert data.shape == (NUM_ENVS, BATCH // NUM_ENVS)
        buffer.extend(data.reshape(-1))
        for _ in range(updates):
            parts = losses(buffer.sample())
            optimiser.zero_grad()
            (parts["loss_actor"] + parts["loss_qvalue"] + parts["loss_alpha"]).backward()
            optimiser.step()
            target.step()
    collector.shutdown(close_env=False)
    assert all(value.isfinite().all() for value in parts.values())
    return dict(actor.named_parameters()), before, evaluate(env, actor)


def main():
    _, before, after = train(12)
    assert after > before + 0.05, f"return {before} before, {after} after"
    first, again = (train(1, updates=2)[0] for _ in range(2))
    assert all(torch.equal(first[name], again[name]) for name in first), "one seed gave two policies"


if __name__ == "__main__":
    main()
