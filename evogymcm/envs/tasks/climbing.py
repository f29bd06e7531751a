"""Tasks whose reward is the way up, in pipes."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from evogymcm.envs.task import Ending, Snapshot, Task, Window


@dataclass(frozen=True)
class Climbing(Task):
    """Climb; the way to the right may count too.

    Attributes:
        gain_x: Reward per metre to the right; a metre up is 1.
        goal_y: Where the COM's y ends an episode, None for no goal.
        goal_bonus: What that adds to the reward.
    """

    gain_x: float = 0.0
    goal_y: float | None = None
    goal_bonus: float = 1.0

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        return after.y - before.y + self.gain_x * (after.x - before.x)

    def endings(self, after: Snapshot) -> Iterator[Ending]:
        if self.goal_y is not None:
            yield after.y > self.goal_y, self.goal_bonus, True

    def score_ceiling(self, start: Snapshot) -> np.ndarray | None:
        return None if self.goal_y is None else self.goal_y - start.y


_SEEN = ("velocity", "relative")

TASKS = (
    Climbing("Climber-v0", "Climber-v0", (1, 1), 400, about="climb a pipe", observes=_SEEN, goal_y=8.6),
    Climbing("Climber-v1", "Climber-v1", (1, 1), 600, about="climb a pipe with soft walls", observes=_SEEN, goal_y=6.5),
    Climbing(
        "Climber-v2",
        "Climber-v2",
        (1, 1),
        1000,
        about="climb a winding pipe",
        observes=("velocity", "orientation", "relative", "ceiling"),
        ceiling=Window(("pipe",), 3),
        gain_x=0.2,
    ),
)
