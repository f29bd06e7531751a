"""Tasks: a world, what is observed and rewarded in it, and when an episode ends.

A task is a frozen dataclass whose fields hold every number. It works on all worlds at once: every array has one row a
world. The engine (`core.py`) owns what all tasks share: actions, the penalty for instability, the time limit, resets.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from evogymcm.sim.world import World

if TYPE_CHECKING:  # the package registers its tasks at import, and must not load numba for it
    from evogymcm.sim.kernels.readings import Readings


# Which worlds end, (N,) bool; what that adds to the reward; and whether it is a goal, see `Task.endings`.
Ending = tuple[np.ndarray, float] | tuple[np.ndarray, float, bool]


@dataclass(frozen=True)
class Window:
    """An elevation window: `radius` columns to each side of the COM's, over the points of some objects."""

    objects: tuple[str, ...]
    radius: int = 5


@dataclass(frozen=True)
class Snapshot:
    """Readings of all worlds at one moment.

    Attributes:
        robot: The robot's readings.
        objects: Readings of the objects that the task names in `watches`.
        floor: (N, columns) the floor window, metres.
        ceiling: (N, columns) the ceiling window, metres.
        memory: What the task drew for the episodes or has remembered since; arrays with N rows.
    """

    robot: "Readings"
    objects: "Mapping[str, Readings]" = field(default_factory=dict)
    floor: np.ndarray | None = None
    ceiling: np.ndarray | None = None
    memory: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def object(self) -> "Readings":
        """Readings of the first object that the task watches; ValueError where it watches none."""
        for readings in self.objects.values():
            return readings
        raise ValueError("object: this task watches none")

    @property
    def x(self) -> np.ndarray:
        """(N,) the robot's COM, across."""
        return self.robot.x

    @property
    def y(self) -> np.ndarray:
        """(N,) the robot's COM, up."""
        return self.robot.y


@dataclass(frozen=True)
class Task:
    """Base of all tasks.

    Attributes:
        id: Name, as in EvoGym.
        world: Its world, or the name of one of `evogymcm.sim.world_names()`.
        spawn: World cell of the lower-left cell of the body array.
        time_limit: Env-steps after which an episode is cut.
        observes: Parts of the flat observation, in order, by their names in `observation_parts`. Parts of a
            watched object may name it, as in "offset:package"; without a name they refer to the first.
        floor: The window under the robot, where it is observed.
        ceiling: The window over the robot, where it is observed.
        reads_hull: Whether the reward needs the hull's area.
        watches: Objects other than the robot that the task reads.
        moves_at_reset: Objects that each episode places anew, by the "offset" (2 voxels) that `draw` returns.
        about: What to do, in a few words, for tables of tasks.
    """

    id: str
    world: str | World
    spawn: tuple[int, int]
    time_limit: int
    observes: tuple[str, ...]
    floor: Window | None = None
    ceiling: Window | None = None
    reads_hull: bool = False
    watches: tuple[str, ...] = ()
    moves_at_reset: tuple[str, ...] = ()
    about: str = field(default="", kw_only=True)

    def draw(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Returns what an episode of one world draws at random: arrays that become rows of `Snapshot.memory`."""
        return {}

    def remember(self, after: Snapshot) -> Mapping[str, np.ndarray]:
        """Returns the memory for the next step."""
        return after.memory

    def reward(self, before: Snapshot, after: Snapshot) -> np.ndarray:
        """Returns (N,) the reward of a step, without bonuses and penalties."""
        raise NotImplementedError

    def endings(self, after: Snapshot) -> Iterator[Ending]:
        """Yields what ends an episode: a condition, (N,) bool, what it adds to the reward, and whether it is a goal.

        The third may be left out: an ending that adds more than 0 is then a goal, and any other a failure.
        """
        return iter(())

    def score_ceiling(self, start: Snapshot) -> np.ndarray | None:
        """Returns (N,) the largest score possible from the readings at reset, None where it is not known."""
        return None

    def observation_parts(self, now: Snapshot) -> dict[str, np.ndarray | None]:
        """Returns everything that `observes` may name, each with N rows (None where the task does not read it)."""
        parts = {
            "velocity": now.robot.velocity,
            "orientation": now.robot.orientation,
            "relative": now.robot.relative,
            "floor": now.floor,
            "ceiling": now.ceiling,
        }
        for i, (name, readings) in enumerate(now.objects.items()):
            own = {
                "offset": readings.com - now.robot.com,
                "object_velocity": readings.velocity,
                "object_orientation": readings.orientation,
            }
            parts |= {f"{part}:{name}": values for part, values in own.items()}
            parts |= own if i == 0 else {}
        return parts

    def observation(self, now: Snapshot) -> dict[str, np.ndarray]:
        """Returns the parts of the flat observation, in order, each (N, width)."""
        parts = self.observation_parts(now)
        return {name: np.asarray(parts[name]).reshape(len(now.robot.com), -1) for name in self.observes}
