"""Reads what a task watches from a simulator's points: the snapshots before and after a step, and what voxels sense."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from evogymcm.envs.task import Snapshot, Task, Window
from evogymcm.envs.voxels import fill_voxels
from evogymcm.sim.constants import MISSING, VOXEL
from evogymcm.sim.lanes import N_LANES
from evogymcm.sim.readings import N_SUMS, Terrain, new_readings, read_object, read_window
from evogymcm.sim.simulator import Block, Simulator

BlockReader = Callable[[Block, np.ndarray], None]  # a block and its (8,) worlds, MISSING for those not to be read


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


class _Source(NamedTuple):
    """What the kernels that read a block need besides its state."""

    objects: list[tuple[Any, ...]]  # for `read_object`: the robot, then the watched objects
    terrains: list[Terrain]  # for `read_window`: of each window
    cells: tuple[np.ndarray, np.ndarray, int]  # for `fill_voxels`


class Reader:
    """Keeps two snapshots of all worlds: the present one and the one before, whose arrays the next step overwrites.

    Args:
        task: what is read.
        simulator: from which.

    Attributes:
        now: the present readings.
        before: the readings of the step before.
    """

    def __init__(self, task: Task, simulator: Simulator) -> None:
        self._task, self._simulator = task, simulator
        most_points = max(block.scene.objects[0].topology.n_points for block in simulator.blocks)
        windows = ((task.floor, False), (task.ceiling, True))
        self._windows = [(window, is_ceiling) for window, is_ceiling in windows if window is not None]
        self._sources = [self._make_source(block, most_points) for block in simulator.blocks]
        self.now, self.before = self._new_snapshot(most_points), self._new_snapshot(most_points)

    def _make_source(self, block: Block, most_points: int) -> _Source:
        topology, layout, n = block.scene.objects[0].topology, block.layout, block.scene.n_points
        initial = np.concatenate([layout.initial, layout.static_points])
        scratch = np.zeros((2, 2 * most_points + 2), np.int64), np.zeros((N_SUMS, 1, N_LANES))

        def known(name: str, with_hull: bool = False) -> tuple[Any, ...]:
            points = block.scene.object(name).points
            return np.where(points < n, points, MISSING), initial[points], with_hull, *scratch

        return _Source(
            [known(block.scene.objects[0].name, self._task.reads_hull), *map(known, self._task.watches)],
            [self._make_terrain(block, window) for window, _ in self._windows],
            # Copies, since arrays that are read-only here are not so in a copied engine: that needs kernels of its own.
            (topology.cells.copy(), topology.corner_points.copy(), self._simulator.grid_shape[1]),
        )

    @staticmethod
    def _make_terrain(block: Block, window: Window) -> Terrain:
        """Returns what a window sees."""
        points = np.concatenate([block.scene.object(name).points for name in window.objects])
        n = block.scene.n_points
        fixed = block.layout.static_points[points[points >= n] - n] / VOXEL
        # Fixed corners of soft voxels have lanes, but their place never changes either.
        return Terrain(fixed[np.argsort(fixed[:, 0], kind="stable")], points[points < n])

    def _new_snapshot(self, n_points: int) -> Snapshot:
        n, task = self._simulator.n_worlds, self._task
        scene = self._simulator.blocks[0].scene
        return Snapshot(
            robot=new_readings(n, n_points),
            objects={name: new_readings(n, scene.object(name).topology.n_points) for name in task.watches},
            floor=np.zeros((n, 2 * task.floor.radius + 1)) if task.floor else None,
            ceiling=np.zeros((n, 2 * task.ceiling.radius + 1)) if task.ceiling else None,
        )

    def turn(self) -> None:
        """Makes the present readings those before; new ones take the place of the older, beside the same memory."""
        self.now, self.before = replace(self.before, memory=self.now.memory), self.now

    def remember(self, memory: Mapping[str, np.ndarray], chosen: np.ndarray | None = None) -> None:
        """Puts copies of the task's memory into the present snapshot, for the worlds of the (N,) mask (all by default).

        The others go on showing what they showed.
        """
        shown = {name: np.array(values) for name, values in memory.items()}
        if chosen is not None:
            for name, values in self.now.memory.items():
                shown[name][~chosen] = values[~chosen]
        self.now = replace(self.now, memory=shown)

    def block_reader(self, sensed: Sensed | None) -> BlockReader:
        """Returns the function that reads a block's worlds, to be run in the thread that advanced them.

        Without `sensed` it leaves voxels out.
        """
        now, sources, rows = self.now, self._sources, (self._simulator.n_worlds, -1)
        objects = [now.robot, *now.objects.values()]
        windows = [(w.radius, is_ceiling, now.ceiling if is_ceiling else now.floor) for w, is_ceiling in self._windows]
        if sensed is not None:
            template, voxels = sensed.template.reshape(rows), sensed.voxels.reshape(rows)
            for_voxels = now.robot.numbers, sensed.stiffness, sensed.actuation, template, voxels

        def read(block: Block, worlds: np.ndarray) -> None:
            points, source = block.state.points, sources[block.index]
            for known, readings in zip(source.objects, objects, strict=True):
                read_object(points, worlds, *known, *readings)
            if windows:
                for terrain, window in zip(source.terrains, windows, strict=True):
                    read_window(points, worlds, *terrain, now.robot.com, *window)
            if sensed is not None:
                fill_voxels(points, worlds, *source.cells, *for_voxels)

        return read

    def read(self, chosen: np.ndarray, read_block: BlockReader) -> None:
        """Reads the worlds of the (N,) mask as they are now."""
        for block in self._simulator.blocks:
            worlds = np.where((block.worlds != MISSING) & chosen[block.worlds], block.worlds, MISSING)
            if (worlds != MISSING).any():
                read_block(block, worlds)

    def keep(self, kept: np.ndarray) -> None:
        """Copies the readings before into the present ones, for the worlds of the (N,) mask."""

        def arrays(snapshot: Snapshot) -> Iterator[np.ndarray | None]:
            for readings in (snapshot.robot, *snapshot.objects.values()):
                yield from readings
            yield from (snapshot.floor, snapshot.ceiling)

        for new, old in zip(arrays(self.now), arrays(self.before), strict=True):
            if new is not None and old is not None:
                new[kept] = old[kept]
