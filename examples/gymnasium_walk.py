"""An EvoGym script; what EvoGym has instead is noted beside the two lines that differ."""

import gymnasium as gym
import numpy as np

import evogymcm as cm  # import evogym.envs


def main(steps: int = 500) -> float:
    """Lets a wave run through a robot, and prints and returns how far that carries it."""
    body = cm.robots["Walk_Bot"]  # or any grid of codes 0 to 4, first row on top
    env = gym.make("evogymcm/Walker-v0", body=body)  # gym.make("Walker-v0", body=grid)
    _, info = env.reset(seed=0)
    phases = 0.7 * np.arange(body.n_actuators)
    for step in range(steps):
        action = 1.1 + 0.5 * np.sin(0.3 * step + phases)
        _, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
    print(f"return {info['return']:.3f}, centre of mass at x = {info['com'][0]:.3f} m")
    env.close()
    return float(info["return"])


def check() -> None:
    """Runs a small version, for the tests; raises AssertionError where it goes wrong."""
    assert 0.0 < abs(main(steps=20)) < 1.0


if __name__ == "__main__":
    main()
