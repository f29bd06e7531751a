"""Tasks with an object: carry it, push it, throw it, catch it, lift it, topple it, slide it.

`dp` below is the object's COM after the step minus before, `d` the robot's.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from evogymcm.envs.task import Ending, Snapshot, Task

_PACKAGE = ("velocity", "offset", "object_velocity", "relative")
_TURNING_PACKAGE = ("velocity", "offset", "object_velocity", "object_orientation", "relative")
_BEAM = ("offset", "velocity", "object_velocity", "object_orientation", "relative")


def _moved(before: Snapshot, after: Snapshot) -> tuple[np.ndarray, np.ndarray]:
    """Returns (N, 2) how the robot's and the object's COM moved."""
    return after.robot.com - before.robot.com, after.object.com - before.object.com


def _approach(before: Snapshot, after: Snapshot) -> np.ndarray:
    """Returns (N,) by how much the horizontal distance between robot and object shrank."""
    return np.abs(before.x - before.object.com[:, 0]) - np.abs(after.x - after.object.com[:, 0])


def _dropped(after: Snapshot, way: np.ndarray, lowest: float | np.ndarray) -> np.ndarray:
    """Returns (N,) ten times the object's way up or down, where it is below `lowest`."""
    return np.where(after.object.com[:, 1] < lowest, 10.0 * way, 0.0)


@dataclass(frozen=True)
class Manipulation(Task):
    """Base: an object, and a goal for the robot's (or the object's) COM."""

    watches: tuple[str, ...] = ("package",)
    goal_x: float | None = None
    goal_bonus: float = 1.0

    def endings(self, after: Snapshot) -> Iterator[Ending]:
        if self.goal_x is not None:
            yield after.x > self.goal_x, self.goal_bonus, True


@dataclass(frozen=True)
class PlainManipulation(Manipulation):
    """Base: velocities are formed in metres, not in voxels, which changes last digits."""

    def observation_parts(self, now: Snapshot) -> dict[str, np.ndarray | None]:
        own = dict.fromkeys(("object_velocity", f"object_velocity:{self.watches[0]}"), now.object.plain_velocity)
        return super().observation_parts(now) | {"velocity": now.robot.plain_velocity} | own


@dataclass(frozen=True)
class Carrying(PlainManipulation):
    """Move forward with a package that must not fall below `lowest`."""

    lowest: float = 0.3

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        d, dp = _moved(before, after)
        return 0.5 * dp[:, 0] + 0.5 * d[:, 0] + _dropped(after, dp[:, 1], self.lowest)


@dataclass(frozen=True)
class CarryingToTable(PlainManipulation):
    """Bring the robot to `target`, with a package that must not fall; only the robot's own way pays, as in EvoGym."""

    target: float = 4.0
    step_x: float = 2.0  # beyond it the ground, and so the limit, is lower
    lowest: tuple[float, float] = (0.6, 0.4)

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        _, dp = _moved(before, after)
        lowest = np.where(after.object.com[:, 0] > self.step_x, self.lowest[1], self.lowest[0])
        nearer = np.abs(self.target - before.x) - np.abs(self.target - after.x)
        return nearer + _dropped(after, dp[:, 1], lowest)


@dataclass(frozen=True)
class Pushing(PlainManipulation):
    """Move a package forward, and stay near it."""

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        d, dp = _moved(before, after)
        return 0.75 * dp[:, 0] + 0.5 * d[:, 0] + _approach(before, after) + _dropped(after, dp[:, 1], 0.0)


@dataclass(frozen=True)
class Throwing(PlainManipulation):
    """Throw the package far; the robot's own way away from x = 0 costs a quarter."""

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        d, dp = _moved(before, after)
        return dp[:, 0] - np.where(after.x >= 0, 0.25, -0.25) * d[:, 0]


@dataclass(frozen=True)
class Catching(Manipulation):
    """Be under a package that falls from a random place. Each episode draws the place of package and pegs."""

    moves_at_reset: tuple[str, ...] = ("package", "peg1", "peg2")
    offsets_x: tuple[int, int] = (-6, 4)  # inclusive, voxels
    offsets_y: tuple[int, int] = (0, 5)
    lowest: float = 0.5

    def draw(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        ranges = (self.offsets_x, self.offsets_y)
        return {"offset": np.array([rng.integers(low, high, endpoint=True) for low, high in ranges])}

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        _, dp = _moved(before, after)
        return _approach(before, after) + _dropped(after, dp[:, 1], self.lowest)


@dataclass(frozen=True)
class Lifting(PlainManipulation):
    """Lift a package out of a pit."""

    target: float = 0.55
    floor_y: float = 0.3  # below it the robot's own way up counts too

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        d, dp = _moved(before, after)
        nearer = np.abs(self.target - before.object.com[:, 0]) - np.abs(self.target - after.object.com[:, 0])
        return 10.0 * dp[:, 1] + 10.0 * nearer + np.where(after.y < self.floor_y, 20.0 * d[:, 1], 0.0)


@dataclass(frozen=True)
class BeamMoving(Manipulation):
    """Base: a beam on pegs; an episode ends with the beam far to the left, as in EvoGym."""

    watches: tuple[str, ...] = ("beam",)
    beam_goal_x: float = 0.2

    def endings(self, after: Snapshot) -> Iterator[Ending]:
        yield after.object.com[:, 0] < self.beam_goal_x, self.goal_bonus, True


@dataclass(frozen=True)
class Toppling(BeamMoving):
    """Knock a beam off its pegs."""

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        _, dp = _moved(before, after)
        way = np.abs(dp)
        return _approach(before, after) + way[:, 0] + 3.0 * way[:, 1] - 10.0 * dp[:, 1]


@dataclass(frozen=True)
class Sliding(BeamMoving):
    """Slide a beam over its pegs, to the right."""

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        _, dp = _moved(before, after)
        return _approach(before, after) + dp[:, 0]


TASKS = (
    Carrying("Carrier-v0", "Carrier-v0", (1, 1), 500, about="carry a soft package", observes=_PACKAGE, goal_x=9.9),
    CarryingToTable(
        "Carrier-v1", "Carrier-v1", (1, 4), 1000, about="carry a rigid package to a table", observes=_PACKAGE
    ),
    Pushing("Pusher-v0", "Pusher-v0", (1, 1), 500, about="push a soft package", observes=_PACKAGE, goal_x=9.9),
    Pushing("Pusher-v1", "Pusher-v1", (13, 1), 600, about="drag a rigid package", observes=_PACKAGE, goal_x=6.9),
    Throwing("Thrower-v0", "Thrower-v0", (1, 1), 300, about="throw a package", observes=_PACKAGE),
    Catching(
        "Catcher-v0", "Catcher-v0", (22, 1), 400, about="catch a package that falls from a random place", observes=_BEAM
    ),
    Lifting("Lifter-v0", "Lifter-v0", (2, 3), 300, about="lift a package out of a pit", observes=_TURNING_PACKAGE),
    Toppling("BeamToppler-v0", "BeamToppler-v0", (1, 1), 1000, about="topple a beam", observes=_BEAM),
    Sliding("BeamSlider-v0", "BeamSlider-v0", (1, 1), 1000, about="slide a beam", observes=_BEAM),
)
