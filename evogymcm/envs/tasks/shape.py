"""Tasks whose reward is a change of the robot's shape, in a box."""

from dataclasses import dataclass

import numpy as np

from evogymcm.envs.task import Snapshot, Task


@dataclass(frozen=True)
class HullArea(Task):
    """Grow (or shrink) the convex hull: the return is `gain` times the change of its area, in square metres."""

    gain: float = 10.0
    reads_hull: bool = True

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        return self.gain * (after.robot.hull_area - before.robot.hull_area)

    def score_ceiling(self, start: Snapshot) -> np.ndarray | None:
        return -self.gain * start.robot.hull_area if self.gain < 0 else None


@dataclass(frozen=True)
class Span(Task):
    """Grow along one axis: the return is the change of the robot's extent, in metres."""

    axis: int = 0  # 0 across, 1 up

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        def span(snapshot: Snapshot) -> np.ndarray:
            return snapshot.robot.high[:, self.axis] - snapshot.robot.low[:, self.axis]

        return span(after) - span(before)


_BOX, _SPAWN, _SHAPE_ONLY = "ShapeChange", (7, 1), ("relative",)

TASKS = (
    HullArea("AreaMaximizer-v0", _BOX, _SPAWN, 600, _SHAPE_ONLY, about="grow the convex hull", gain=10.0),
    HullArea("AreaMinimizer-v0", _BOX, _SPAWN, 600, _SHAPE_ONLY, about="shrink the convex hull", gain=-10.0),
    Span("WingspanMazimizer-v0", _BOX, _SPAWN, 600, _SHAPE_ONLY, about="grow wide", axis=0),  # EvoGym's spelling
    Span("HeightMaximizer-v0", _BOX, _SPAWN, 500, _SHAPE_ONLY, about="grow tall", axis=1),
)
