"""One shared actor learns to drive a population of different bodies, each an agent of one environment.

Every body ends and restarts alone. A rollout of the group, (steps, bodies), is turned into one of single worlds,
(bodies, steps), which is what `PPOLearner` takes.
"""

from dataclasses import dataclass

import numpy as np
import torch
import tyro
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.envs import InitTracker, TransformedEnv

import evogymcm as cm
from evogymcm.algos import PPOConfig, PPOLearner, make_actor, make_critic
from evogymcm.envs import population_env


@dataclass(frozen=True)
class Settings:
    """Settings of the run.

    Attributes:
        task: the task of all bodies.
        bodies: how many bodies there are.
        rollout_steps: env-steps of every body between two updates.
        updates: how often the actor learns.
        seed: of bodies, weights and exploration.
    """

    task: str = "Walker-v0"
    bodies: int = 16
    rollout_steps: int = 128
    updates: int = 50
    seed: int = 0


class OnBodies(TensorDictModuleBase):
    """Lets a policy made for single worlds act for all bodies of the group."""

    def __init__(self, policy: TensorDictModuleBase) -> None:
        super().__init__()
        self.policy = policy
        self.in_keys = [("bodies", key) for key in policy.in_keys]
        self.out_keys = [("bodies", *(key if isinstance(key, tuple) else (key,))) for key in policy.out_keys]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the bodies' actions into `tensordict` and returns it."""
        self.policy(tensordict["bodies"])
        return tensordict


def by_body(data: TensorDictBase) -> TensorDictBase:
    """Returns a rollout of the group as one of single worlds, (bodies, steps)."""
    rollout = data["bodies"].transpose(0, 1)
    rollout["next"] = data["next", "bodies"].transpose(0, 1)
    return rollout


def main(settings: Settings) -> list[float]:
    """Trains the actor and returns the mean reward of each rollout."""
    torch.set_num_threads(1)
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    parent = cm.robots["Walk_Bot"]
    bodies = [parent] + [cm.mutate_body(parent, rng) or parent for _ in range(settings.bodies - 1)]
    env = population_env(settings.task, bodies, material="reactive", seed=settings.seed)
    actor, critic = make_actor(env.worlds), make_critic(env.worlds)
    learner = PPOLearner(actor, critic, PPOConfig(minibatch=256))
    collector = Collector(
        TransformedEnv(env, InitTracker()),  # which TorchRL's collectors ask for
        OnBodies(actor),
        frames_per_batch=settings.rollout_steps,
        total_frames=settings.rollout_steps * settings.updates,
    )
    rewards: list[float] = []
    for update, data in enumerate(collector):
        rollout = by_body(data)
        if update == 0:  # input scales: the first policy hardly depends on its inputs
            actor.observe(rollout)
            critic.observe(rollout)
        learner.update(rollout, 1 - update / settings.updates)
        rewards.append(rollout["next", "reward"].mean().item())
        ended = rollout["next", "done"].sum(1).flatten().tolist()
        print(f"update {update}: mean reward {rewards[-1]:.5f}, episodes that ended, by body: {ended}")
    collector.shutdown()
    return rewards


def check() -> None:
    """Runs a small version, for the tests; raises AssertionError where it goes wrong."""
    rewards = main(Settings(bodies=3, rollout_steps=8, updates=2))
    assert len(rewards) == 2
    assert all(0.0 < abs(reward) < 0.1 for reward in rewards)


if __name__ == "__main__":
    main(tyro.cli(Settings))
