"""Reads what a task watches from a simulator's points: the snapshots before and after a step, and what voxels sense."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from evogymcm.envs.task import Snapshot, Task, Window
from evogymcm.sim.constants import VOXEL
from evogymcm.sim.readings import N_SCRATCH, new_readings, read_object, read_voxels, read_window
from evogymcm.sim.simulator import Simulator

_NOTHING: Mapping[str, np.ndarray] = {}
WorldReader = Callable[[np.ndarray, int], None]  # (m,) worlds, and the number of the thread that reads them


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
        self._watched = [numbers[name] for name in task.watches]
        present = (len(simulator.objects(world)[0].places) for world in range(simulator.n_worlds))
        self._robot_points = max(most_points, *present)
        most = max(self._robot_points, max(len(placed.places) for placed in objects))
        windows = ((task.floor, False), (task.ceiling, True))
        self._windows = [(window, is_ceiling) for window, is_ceiling in windows if window is not None]
        self._terrains = [self._make_terrain(window) for window, _ in self._windows]
        self._scratches = np.zeros((simulator.num_threads, N_SCRATCH * (most + 2)))
        self.now, self.before = self._new_snapshot(), self._new_snapshot()

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
        sizes = [most if number == 0 else len(objects[number].places) for number in self._watched]
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
            for number, readings in zip([0, *self._watched], [snapshot.robot, *snapshot.objects.values()], strict=True):
                if number == 0:
                    readings.relative[world] = 0.0

    def turn(self) -> None:
        """Makes the present readings those before; new ones take the place of the older, beside the same memory."""
        latest = self.before if self.before.memory is self.now.memory else replace(self.before, memory=self.now.memory)
        self.now, self.before = latest, self.now

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

    def reader(self, sensed: Sensed | None) -> WorldReader:
        """Returns the function that reads worlds, to be run in the thread that advanced them.

        Without `sensed` it leaves voxels out.
        """
        now, storage, hull = self.now, self._simulator.storage, self._task.reads_hull
        watched = list(zip(self._watched, now.objects.values(), strict=True))
        for_voxels: tuple[Any, ...] = ()
        if sensed is not None:
            template, voxels = (array.reshape(len(array), -1) for array in (sensed.template, sensed.voxels))
            for_voxels = now.robot.numbers, sensed.stiffness, sensed.actuation, template, voxels

        def read(worlds: np.ndarray, thread: int) -> None:
            scratch = self._scratches[thread]
            read_object(storage, worlds, 0, hull, scratch, *now.robot)
            for number, readings in watched:
                read_object(storage, worlds, number, False, scratch, *readings)
            for (window, is_ceiling), terrain in zip(self._windows, self._terrains, strict=True):
                out = now.ceiling if is_ceiling else now.floor
                read_window(storage, worlds, *terrain, now.robot.numbers, window.radius, is_ceiling, out)
            if for_voxels:
                read_voxels(storage, worlds, *for_voxels)

        return read

    def keep(self, kept: np.ndarray) -> None:
        """Copies the readings before into the present ones, for the worlds of the (N,) mask."""

        def arrays(snapshot: Snapshot) -> Iterator[np.ndarray | None]:
            for readings in (snapshot.robot, *snapshot.objects.values()):
                yield from readings
            yield from (snapshot.floor, snapshot.ceiling)

        for new, old in zip(arrays(self.now), arrays(self.before), strict=True):
            if new is not None and old is not None:
                new[kept] = old[kept]
