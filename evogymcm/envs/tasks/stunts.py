"""Tasks for acrobats: flip, jump, balance, and walk to and fro."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi

import numpy as np

from evogymcm.envs.task import Ending, Snapshot, Task, Window


@dataclass(frozen=True)
class Flipping(Task):
    """Turn counter-clockwise, again and again; the left end of the ground ends an episode."""

    end_x: float = 0.1

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        was, now = before.robot.orientation, after.robot.orientation
        back = (was < pi / 3) & (now > 5 * pi / 3)
        over = (was > 5 * pi / 3) & (now < pi / 3)
        # A turn is taken off the larger of the two, so that the difference is rounded as in EvoGym.
        return (now - 2 * pi * back) - (was - 2 * pi * over)

    def endings(self, after: Snapshot) -> Iterator[Ending]:
        yield after.x < self.end_x, 0.0, False


@dataclass(frozen=True)
class Jumping(Task):
    """Rise, and stay in place."""

    gain_y: float = 10.0
    cost_x: float = 5.0

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        return self.gain_y * (after.y - before.y) - self.cost_x * np.abs(after.x - before.x)


@dataclass(frozen=True)
class Balancing(Task):
    """Bring the COM to a place on a pole."""

    target: tuple[float, float] = (0.0, 0.0)

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        was, now = np.abs(self.target - before.robot.com), np.abs(self.target - after.robot.com)
        return (was - now).sum(1)


@dataclass(frozen=True)
class Patrolling(Task):
    """Walk to a random row of goals, one after another. Each episode draws its goals.

    Attributes:
        start: Voxel from which the way over the goals counts.
        goals: Range of a goal, inclusive, voxels.
        way: Goals are drawn until the way over them is this long, voxels.
        reach: A goal is reached when nearer than this, metres.
        bonus: For the last goal.
    """

    start: int = 35
    goals: tuple[int, int] = (20, 49)
    way: int = 100
    reach: float = 0.2
    bonus: float = 1.0
    most_goals: int = 256  # room for a row; ten are usual

    def draw(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        row, at, travelled = np.zeros(self.most_goals), self.start, 0
        count = 0
        while travelled < self.way and count < self.most_goals:
            goal = int(rng.integers(*self.goals, endpoint=True))
            travelled, at = travelled + abs(at - goal), goal
            row[count] = 0.1 * goal
            count += 1
        return {"goals": row, "n_goals": np.array(count), "goal": np.array(0)}

    def _advance(self, after: Snapshot) -> tuple[np.ndarray, np.ndarray]:
        """Returns (N,) the present goal after this step, and whether the last has been reached."""
        memory, goal = after.memory, after.memory["goal"].copy()
        worlds = np.arange(len(goal))
        while True:
            reached = np.abs(memory["goals"][worlds, goal] - after.x) < self.reach
            onward = reached & (goal < memory["n_goals"] - 1)
            if not onward.any():
                return goal, reached
            goal += onward

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        goal, _ = self._advance(after)  # the goal that comes after a reached one replaces it in the reward
        x = after.memory["goals"][np.arange(len(goal)), goal]
        return np.abs(x - before.x) - np.abs(x - after.x)

    def endings(self, after: Snapshot) -> Iterator[Ending]:
        yield self._advance(after)[1], self.bonus, True

    def remember(self, after: Snapshot) -> dict[str, np.ndarray]:
        return dict(after.memory) | {"goal": self._advance(after)[0]}

    def observation_parts(self, now: Snapshot) -> dict[str, np.ndarray | None]:
        goal = now.memory["goal"]
        x = now.memory["goals"][np.arange(len(goal)), goal]
        return super().observation_parts(now) | {"goal": np.stack([goal, x, x - now.x], axis=1)}


TASKS = (
    Flipping(
        "Flipper-v0", "Flipper-v0", (60, 1), 600, about="turn over and over", observes=("orientation", "relative")
    ),
    Jumping(
        "Jumper-v0",
        "Jumper-v0",
        (32, 1),
        500,
        about="jump on the spot",
        observes=("velocity", "relative", "floor"),
        floor=Window(("ground",), 2),
    ),
    # The target is the pole's left edge, not its middle, as in EvoGym: numbers as products of voxels are rounded.
    Balancing(
        "Balancer-v0",
        "Balancer-v0",
        (15, 3),
        600,
        about="balance on a pole",
        observes=("orientation", "relative"),
        target=(17 * 0.1, 0.5),
    ),
    Balancing(
        "Balancer-v1",
        "Balancer-v1",
        (10, 1),
        600,
        about="get onto a pole",
        observes=("orientation", "relative"),
        target=(1.75, 6 * 0.1),
    ),
    Patrolling(
        "BidirectionalWalker-v0",
        "BidirectionalWalker-v0",
        (33, 1),
        1000,
        about="walk to and fro between random goals",
        observes=("velocity", "relative", "goal"),
    ),
)
