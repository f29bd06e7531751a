"""Reads what a task watches from a simulator's points: the snapshots before and after a step, and what voxels sense."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from evogymcm.envs.task import Snapshot, Task, Window
from evogymcm.sim.constants import VOXEL
from evogymcm.sim.kernels._jit import entry
from evogymcm.sim.kernels.readings import N_SCRATCH, new_readings, read_object, read_voxels, read_window
from evogymcm.sim.simulator import Simulator

_NOTHING: Mapping[str, np.ndarray] = {}


class Sensed(NamedTuple):
    """What the observations of voxels are formed of, besides the points, and where they go.

    Attributes:
        stiffness: (N, V) stiffness in force.
        actuation: (N, V) actuation in force.
        template: (N, V, F) the features that never change.
        voxels: (N, V, F) to be written.
    """

    stiffness: np.ndarray
    actuation: np.ndarray
    template: np.ndarray
    voxels: np.ndarray


class Reader:
    """Keeps two snapshots of all worlds: the present one and the one before, whose arrays the next step overwrites.

    Args:
        task: what is read.
        simulator: from which.
        most_points: of any robot that a world may get; those of the present ones by default.

    Attributes:
        now: the present readings.
        before: the readings of the step before.
    """

    def __init__(self, task: Task, simulator: Simulator, most_points: int = 0) -> None:
        self._task, self._simulator = task, simulator
        objects = simulator.objects()
        numbers = {placed.name: number for number, placed in enumerate(objects)}
        self._watched = [(numbers[name], name) for name in task.watches]
        self._reads_hull = task.reads_hull
        present = (len(simulator.objects(world)[0].places) for world in range(simulator.n_worlds))
        self._robot_points = max(most_points, *present)
        most = max(self._robot_points, max(len(placed.places) for placed in objects))
        windows = ((task.floor, False), (task.ceiling, True))
        self._looks = [(self._make_terrain(window), window.radius, up) for window, up in windows if window is not None]
        self._of_voxels: tuple[np.ndarray, ...] | None = None
        self._scratches = np.zeros((min(simulator.num_threads, simulator.n_worlds), N_SCRATCH * (most + 2)))
        self.now, self.before = self._new_snapshot(), self._new_snapshot()
        self._parts: list[list[np.ndarray] | None] = []  # see `_views`, of the present snapshot and of the other
        self._bind()

    def _make_terrain(self, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Returns what a window sees: (Q, 2) fixed points in voxels by ascending x, and the places of moving ones."""
        seen = [placed for placed in self._simulator.objects() if placed.name in window.objects]
        points = self._simulator.positions
        fixed = np.concatenate([points(placed.name)[:, placed.places < 0] for placed in seen], axis=1)
        moving = np.concatenate([placed.places[placed.places >= 0] for placed in seen])
        # Fixed corners of soft voxels are state, but their place never changes either.
        return np.ascontiguousarray((fixed[:, np.argsort(fixed[0], kind="stable")] / VOXEL).T), moving

    def _new_snapshot(self) -> Snapshot:
        n, task = self._simulator.n_worlds, self._task
        most, objects = self._robot_points, self._simulator.objects()
        sizes = [most if number == 0 else len(objects[number].places) for number, _ in self._watched]
        return Snapshot(
            memory=_NOTHING,
            robot=new_readings(n, most),
            objects={name: new_readings(n, size) for name, size in zip(task.watches, sizes, strict=True)},
            floor=np.zeros((n, 2 * task.floor.radius + 1)) if task.floor else None,
            ceiling=np.zeros((n, 2 * task.ceiling.radius + 1)) if task.ceiling else None,
        )

    def clear(self, world: int) -> None:
        """Forgets the points of a world whose robot changes: a smaller one does not overwrite all of them."""
        for snapshot in (self.now, self.before):
            snapshot.robot.relative[world] = 0.0
            for number, name in self._watched:
                if number == 0:
                    snapshot.objects[name].relative[world] = 0.0

    def turn(self) -> None:
        """Makes the present readings those before; new ones take the place of the older, beside the same memory."""
        latest = self.before if self.before.memory is self.now.memory else replace(self.before, memory=self.now.memory)
        self.now, self.before = latest, self.now
        self._parts.reverse()

    def remember(self, memory: Mapping[str, np.ndarray], chosen: np.ndarray | None = None) -> None:
        """Puts copies of the task's memory into the present snapshot, for the worlds of the (N,) mask (all by default).

        The others go on showing what they showed.
        """
        if not memory:
            return
        shown = {name: np.array(values) for name, values in memory.items()}
        if chosen is not None:
            for name, values in self.now.memory.items():
                shown[name][~chosen] = values[~chosen]
        self.now = replace(self.now, memory=shown)

    def sense(self, sensed: Sensed) -> None:
        """Has `read` form the observations of voxels too, from now on."""
        template, voxels = (array.reshape(len(array), -1) for array in (sensed.template, sensed.voxels))
        self._of_voxels = sensed.stiffness, sensed.actuation, template, voxels

    def read(self, worlds: np.ndarray, thread: int) -> None:
        """Reads (m,) worlds into the present snapshot, in the thread of that number, which has advanced them."""
        now, storage, scratch = self.now, self._simulator.storage, self._scratches[thread]
        numbers = now.robot.numbers
        self._read_object(storage, worlds, 0, self._reads_hull, scratch, numbers, now.robot.relative)
        for number, name in self._watched:
            self._read_object(storage, worlds, number, False, scratch, *now.objects[name])
        for look, terrain, radius, is_ceiling in self._windows:
            out = now.ceiling if is_ceiling else now.floor
            look(storage, worlds, *terrain, numbers, radius, is_ceiling, out)
        if self._of_voxels is not None:
            read_voxels(storage, worlds, numbers, *self._of_voxels)

    def flat(self) -> np.ndarray:
        """Returns (N, D) the task's own flat observation (fresh memory), where all bodies are equal."""
        if not self._parts:
            self._parts = [self._views(self.now), self._views(self.before)]
        parts = self._parts[0]
        if parts is None:
            parts = list(self._task.observation(self.now).values())
        return np.concatenate(parts, axis=1)

    def _bind(self) -> None:
        """Finds the kernels once that every step needs."""
        worlds = self._simulator.storage, np.zeros(0, np.int64)
        self._read_object = entry(read_object, *worlds, 0, False, self._scratches[0], *self.now.robot)
        rows = self.now.robot.numbers
        self._windows = [
            (entry(read_window, *worlds, *terrain, rows, radius, is_ceiling, rows), terrain, radius, is_ceiling)
            for terrain, radius, is_ceiling in self._looks
        ]

    def _views(self, snapshot: Snapshot) -> list[np.ndarray] | None:
        """Returns the parts of a snapshot's flat observation, where they all are views of its arrays for ever."""
        task = type(self._task)
        if (task.observation, task.observation_parts) != (Task.observation, Task.observation_parts):
            return None  # it may form others each time
        parts, arrays = list(self._task.observation(snapshot).values()), list(_arrays(snapshot))
        is_view = (any(np.may_share_memory(part, array) for array in arrays) for part in parts)
        return parts if all(is_view) else None

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in self.__dict__.items() if name not in ("_read_object", "_windows")}
        return kept | {"_parts": [], "_of_voxels": None}  # views of a copy's arrays are made anew

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def keep(self, kept: np.ndarray) -> None:
        """Copies the readings before into the present ones, for the worlds of the (N,) mask."""
        for new, old in zip(_arrays(self.now), _arrays(self.before), strict=True):
            new[kept] = old[kept]


def _arrays(snapshot: Snapshot) -> Iterator[np.ndarray]:
    """Yields the arrays that hold a snapshot's readings."""
    for readings in (snapshot.robot, *snapshot.objects.values()):
        yield from readings
    for window in (snapshot.floor, snapshot.ceiling):
        if window is not None:
            yield window
