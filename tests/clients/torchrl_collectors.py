# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm"]
# ///
"""TorchRL's collectors in processes of their own, over many bodies: its PPO loss, and new weights for the workers."""

from dataclasses import replace
from functools import partial

import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn, optim
from torchrl.collectors import MultiAsyncCollector, MultiSyncCollector
from torchrl.envs import ParallelEnv, check_env_specs
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import evogymcm as cm
from evogymcm.envs import SoftRobotEnv

TASK = replace(cm.tasks["AreaMaximizer-v0"], time_limit=20)
BODIES = ["HHH/V.V", "VVV/H.H", "HV/VH"]
WORLDS, WORKERS, STEPS = 6, 2, 20
make_env = partial(SoftRobotEnv, TASK, BODIES, num_worlds=WORLDS, num_threads=1)


class PerVoxel(nn.Module):
    """Looks at each voxel alone, so that it fits all bodies: (..., V, F) to two numbers (..., V) for an action."""

    def __init__(self, features):
        super().__init__()
        self.net = nn.Sequential(MLP(features, 2, num_cells=[64]), NormalParamExtractor())

    def forward(self, voxels):
        loc, scale = self.net(voxels)
        return loc.squeeze(-1), scale.squeeze(-1)


class Mean(nn.Module):
    """The mean of the voxels' values, (..., V, F) to (..., 1)."""

    def __init__(self, features):
        super().__init__()
        self.net = MLP(features, 1, num_cells=[64])

    def forward(self, voxels):
        return self.net(voxels).mean(-2)


def make_policy():
    """Returns an actor and a critic."""
    env = make_env()
    features, space = env.observation_spec["voxels"].shape[-1], env.full_action_spec["action", "actuation"].space
    actor = ProbabilisticActor(
        TensorDictModule(PerVoxel(features), ["voxels"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        out_keys=[("action", "actuation")],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": space.low[0], "high": space.high[0]},
        return_log_prob=True,
        log_prob_key="log_prob",
    )
    return actor, ValueOperator(Mean(features), in_keys=["voxels"])


def make_collector(kind, actor, batches):
    """Returns a collector whose batches hold one episode of each world."""
    frames = WORKERS * WORLDS * STEPS
    options = {"frames_per_batch": frames, "total_frames": batches * frames}
    collector = kind([make_env] * WORKERS, actor, **options)
    collector.set_seed(0)
    return collector


def train(batches):
    """Returns the mean return of each batch, and the first batch."""
    torch.manual_seed(0)
    actor, critic = make_policy()
    advantage = GAE(gamma=0.95, lmbda=0.95, value_network=critic)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.001)
    loss.set_keys(action=("action", "actuation"), sample_log_prob="log_prob")
    optimiser = optim.Adam(loss.parameters(), 3e-3)
    collector, returns, first = make_collector(MultiSyncCollector, actor, batches), [], None
    try:
        for data in collector:
            assert data.shape == (WORKERS, WORLDS, STEPS)
            assert data["next", "truncated"][..., -1, :].all()
            first = data.clone() if first is None else first
            with torch.no_grad():
                expected = actor(data.select("voxels"))["loc"]
            torch.testing.assert_close(data["loc"], expected)  # the workers act by the newest weights
            returns.append(data["next", "reward"].sum(-2).mean().item())
            for _ in range(5):
                advantage(data)
                for some in data.reshape(-1).split(120):
                    parts = loss(some)
                    optimiser.zero_grad()
                    (parts["loss_objective"] + parts["loss_critic"] + parts["loss_entropy"]).backward()
                    optimiser.step()
            collector.update_policy_weights_()
    finally:
        collector.shutdown()
    return returns, first


def main():
    returns, first = train(10)
    assert returns[-1] > returns[0] + 0.02, f"mean returns {returns}"
    again = train(1)[1]
    assert torch.equal(again["action", "actuation"], first["action", "actuation"]), "one seed gave two batches"

    collector = make_collector(MultiAsyncCollector, make_policy()[0], 2)
    for data in collector:  # of whichever worker is ready
        assert data["next", "reward"].isfinite().all()
    collector.shutdown()

    workers = ParallelEnv(WORKERS, make_env)
    check_env_specs(workers)
    assert workers.rollout(3).shape == (WORKERS, WORLDS, 3)
    workers.close()


if __name__ == "__main__":
    main()
