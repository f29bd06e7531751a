"""A plain PettingZoo loop: random actions for a population, then the next generation in the same environment."""

from dataclasses import dataclass

import numpy as np
import tyro

import evogymcm as cm
from evogymcm.envs import parallel_env


@dataclass(frozen=True)
class Settings:
    """Settings of the run.

    Attributes:
        task: the task of all bodies.
        bodies: how many bodies there are.
        generations: how many populations are tried, each made of changed copies of the last one's best body.
        steps: env-steps of an episode, at most.
        seed: of bodies and actions.
    """

    task: str = "Walker-v0"
    bodies: int = 8
    generations: int = 3
    steps: int = 100
    seed: int = 0


def main(settings: Settings) -> list[float]:
    """Runs all generations and returns the best return of each."""
    rng = np.random.default_rng(settings.seed)
    bodies = [cm.sample_body((5, 5), rng) for _ in range(settings.bodies)]
    env = parallel_env(settings.task, bodies, material="reactive", grid_shape=(5, 5), seed=settings.seed)
    for i, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(settings.seed + i)
    best: list[float] = []
    for generation in range(settings.generations):
        _, infos = env.reset(options={"bodies": bodies})
        returns = {agent: info["return"] for agent, info in infos.items()}
        for _ in range(settings.steps):
            if not env.agents:  # each body leaves when its own episode ends
                break
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            _, _, _, _, infos = env.step(actions)
            returns |= {agent: info["return"] for agent, info in infos.items()}
        winner = max(returns, key=lambda agent: returns[agent])
        best.append(returns[winner])
        parent = env.bodies[env.possible_agents.index(winner)]
        print(f"generation {generation}: best return {best[-1]:.4f} by {parent.text}")
        bodies = [parent] + [cm.mutate_body(parent, rng) or parent for _ in range(settings.bodies - 1)]
    env.close()
    return best


def check() -> None:
    """Runs a small version, for the tests; raises AssertionError where it goes wrong."""
    best = main(Settings(bodies=3, generations=2, steps=5))
    assert len(best) == 2
    assert all(0.0 < abs(metres) < 0.5 for metres in best)


if __name__ == "__main__":
    main(tyro.cli(Settings))
