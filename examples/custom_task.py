"""A world of your own, a task on it, and a body with its own connections."""

from collections.abc import Iterator
from dataclasses import dataclass

import gymnasium
import numpy as np

import evogymcm as cm
from evogymcm.envs import Snapshot, Task, Window
from evogymcm.sim.world import World
from evogymcm.testing import check_task

# Cells: . empty, R rigid, S soft, H and V actuators, F fixed. The top row comes first.
STEPS = World.from_picture(
    """
    object ground at 0 0
    ................FFFFFFFFFFFF
    ..........FFFFFFFFFFFFFFFFFF
    FFFFFFFFFFFFFFFFFFFFFFFFFFFF
    object ball at 8 1
    SS
    SS
    """
)


@dataclass(frozen=True)
class Ascent(Task):
    """Climb the steps: a metre up counts three times a metre forward; the top ends the episode."""

    up_gain: float = 3.0
    goal: tuple[float, float] = (2.0, 0.5)
    bonus: float = 1.0

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        return after.x - before.x + self.up_gain * (after.y - before.y)

    def endings(self, after: Snapshot) -> Iterator[tuple[np.ndarray, float]]:
        yield (after.x > self.goal[0]) & (after.y > self.goal[1]), self.bonus


cm.register_task(
    Ascent(
        "Ascent-v0",
        world=STEPS,
        spawn=(1, 1),
        time_limit=200,
        observes=("velocity", "relative", "offset", "floor"),
        floor=Window(("ground",)),
        watches=("ball",),
        about="climb the steps",
    )
)


def main() -> float:
    """Returns the return of one episode of random actions."""
    # Legs that touch without being joined: only the listed pairs of cells (row-major indices) are.
    pairs = [(0, 1), (1, 2), (2, 3), (0, 4), (1, 5), (2, 6), (3, 7), (4, 8), (5, 9), (6, 10), (7, 11)]
    body = cm.Body("HHHH/VVVV/VVVV", connections=np.transpose(pairs))
    env = gymnasium.make("evogymcm/Ascent-v0", body=body)
    env.action_space.seed(0)
    env.reset(seed=0)
    while True:
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            return float(info["return"])


def check() -> None:
    """Runs a small version, for the tests; raises AssertionError where it goes wrong."""
    check_task("Ascent-v0")
    assert -5.0 < main() < 5.0


if __name__ == "__main__":
    print(f"return {main():.3f}")
