"""Tasks whose reward is the way forward: over flat ground, bridges, stairs, obstacles and gaps, and through caves."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi

import numpy as np

from evogymcm.envs.task import Ending, Snapshot, Task, Window


@dataclass(frozen=True)
class Walking(Task):
    """Move to the right.

    Attributes:
        gain: Reward per metre.
        goal_x: Where the COM's x ends an episode, None for no goal.
        goal_bonus: What that adds to the reward.
        fallen: Orientations strictly between these (radians) end an episode, None for no such rule.
        lowest_y: A COM below this ends an episode, None for no such rule.
        fall_penalty: What either adds to the reward.
    """

    gain: float = 1.0
    goal_x: float | None = None
    goal_bonus: float = 1.0
    fallen: tuple[float, float] | None = None
    lowest_y: float | None = None
    fall_penalty: float = -3.0

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        return self.gain * (after.x - before.x)

    def endings(self, after: Snapshot) -> Iterator[Ending]:
        if self.goal_x is not None:
            yield after.x > self.goal_x, self.goal_bonus, True
        if self.lowest_y is not None:
            yield after.y < self.lowest_y, self.fall_penalty, False
        if self.fallen is not None:
            low, high = self.fallen
            yield (low < after.robot.orientation) & (after.robot.orientation < high), self.fall_penalty, False

    def score_ceiling(self, start: Snapshot) -> np.ndarray | None:
        return None if self.goal_x is None else self.gain * (self.goal_x - start.x)


_UPSIDE_DOWN = (pi / 2, 3 * pi / 2)
_ON_TERRAIN = ("velocity", "orientation", "relative", "floor")
_IN_CAVE = ("velocity", "relative", "floor", "ceiling")
_GROUND = Window(("ground",))
_TERRAIN = Window(("terrain",))

TASKS = (
    Walking(
        "Walker-v0",
        "Walker-v0",
        (1, 1),
        500,
        about="walk on flat ground",
        observes=("velocity", "relative"),
        goal_x=9.9,
    ),
    Walking(
        "BridgeWalker-v0",
        "BridgeWalker-v0",
        (2, 5),
        500,
        about="cross a soft bridge",
        observes=("velocity", "orientation", "relative"),
        goal_x=6.0,
    ),
    Walking(
        "DownStepper-v0",
        "DownStepper-v0",
        (1, 11),
        500,
        about="go down stairs",
        observes=_ON_TERRAIN,
        floor=_GROUND,
        goal_x=7.4,
        goal_bonus=2.0,
        fallen=_UPSIDE_DOWN,
    ),
    # 15 degrees stricter than the others, as in EvoGym.
    Walking(
        "UpStepper-v0",
        "UpStepper-v0",
        (1, 1),
        600,
        about="climb stairs",
        observes=_ON_TERRAIN,
        floor=_GROUND,
        goal_x=6.9,
        goal_bonus=2.0,
        fallen=(pi / 2 - pi / 12, 3 * pi / 2 + pi / 12),
    ),
    Walking(
        "ObstacleTraverser-v0",
        "ObstacleTraverser-v0",
        (2, 1),
        1000,
        about="walk over bumps",
        observes=_ON_TERRAIN,
        floor=_GROUND,
        goal_x=7.9,
        goal_bonus=2.0,
        fallen=_UPSIDE_DOWN,
    ),
    # The goal lies inside the closing wall: out of reach, and so in EvoGym.
    Walking(
        "ObstacleTraverser-v1",
        "ObstacleTraverser-v1",
        (2, 4),
        1000,
        about="walk over rough ground",
        observes=_ON_TERRAIN,
        floor=_GROUND,
        goal_x=5.9,
        goal_bonus=2.0,
    ),
    Walking(
        "Hurdler-v0",
        "Hurdler-v0",
        (2, 4),
        1000,
        about="get over hurdles",
        observes=_ON_TERRAIN,
        floor=_GROUND,
        fallen=_UPSIDE_DOWN,
    ),
    Walking(
        "PlatformJumper-v0",
        "PlatformJumper-v0",
        (1, 6),
        1000,
        about="move along platforms at different heights",
        observes=_ON_TERRAIN,
        floor=Window(tuple(f"platform_{i}" for i in range(1, 8))),
        lowest_y=0.4,
        fallen=_UPSIDE_DOWN,
    ),
    Walking(
        "GapJumper-v0",
        "GapJumper-v0",
        (1, 6),
        1000,
        about="move along platforms with gaps",
        observes=_ON_TERRAIN,
        floor=Window(tuple(f"platform_{i}" for i in range(1, 6))),
        lowest_y=0.4,
    ),
    Walking(
        "Traverser-v0",
        "Traverser-v0",
        (1, 9),
        600,
        about="cross a pit of loose blocks",
        observes=_ON_TERRAIN,
        floor=Window(("ground", *(f"block_{i}" for i in range(27)))),
        goal_x=5.9,
        goal_bonus=2.0,
    ),
    # The goal lies on the face of the wall that closes the cave: out of reach, and so in EvoGym.
    Walking(
        "CaveCrawler-v0",
        "CaveCrawler-v0",
        (1, 2),
        1000,
        about="get through a low cave",
        observes=_IN_CAVE,
        floor=_TERRAIN,
        ceiling=_TERRAIN,
        goal_x=6.9,
    ),
    # The next two come from the reference code of EvoGymCM's invariant setting; the first's goal is out of reach too.
    Walking(
        "CaveCrawler-v1",
        "cave",
        (1, 2),
        5000,
        about="climb through a cave",
        observes=_IN_CAVE,
        floor=_TERRAIN,
        ceiling=_TERRAIN,
        gain=2.0,
        goal_x=6.9,
    ),
    Walking(
        "HoleCrawler-v0",
        "hole",
        (3, 2),
        2000,
        about="get through a hole",
        observes=_IN_CAVE,
        floor=Window(("floor",)),
        ceiling=Window(("top",)),
        gain=2.0,
        goal_x=6.9,
    ),
)
