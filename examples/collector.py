"""Collects rollouts of many different robots with TorchRL's own collector."""

import numpy as np
from torchrl.collectors import Collector
from torchrl.envs import Compose, InitTracker, RewardSum, TransformedEnv

import evogymcm as cm
from evogymcm.algos import make_actor
from evogymcm.envs import SoftRobotEnv


def main(num_worlds: int = 32, steps: int = 250, batches: int = 2) -> list[float]:
    """Prints how far the eight robots of a random population get, and returns it for the last batch."""
    rng = np.random.default_rng(0)
    bodies = [cm.sample_body((5, 5), rng) for _ in range(8)]
    worlds = SoftRobotEnv("Walker-v0", bodies, num_worlds, material="reactive")
    env = TransformedEnv(worlds, Compose(InitTracker(), RewardSum()))  # TorchRL's collectors ask for the first
    frames = num_worlds * steps
    collector = Collector(env, make_actor(env), frames_per_batch=frames, total_frames=batches * frames)
    reached: list[float] = []
    for data in collector:  # a TensorDict of shape [num_worlds, steps]
        reached = data["next", "episode_reward"][:, -1, 0].reshape(-1, len(bodies)).mean(0).tolist()
        print(", ".join(f"{body.text}: {metres:+.3f}" for body, metres in zip(bodies, reached, strict=True)))
    collector.shutdown()
    return reached


def check() -> None:
    """Runs a small version, for the tests; raises AssertionError where it goes wrong."""
    reached = main(num_worlds=8, steps=3, batches=2)
    assert len(reached) == 8
    assert all(0.0 < abs(metres) < 0.3 for metres in reached)


if __name__ == "__main__":
    main()
