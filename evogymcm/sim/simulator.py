"""Simulator: many worlds, advanced together."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from evogymcm.sim._jit import announce_compilation
from evogymcm.sim.advance import State, advance, laid_out, new_state, reset_lanes, set_constants
from evogymcm.sim.constants import MISSING, SUBSTEPS, Physics
from evogymcm.sim.lanes import N_LANES
from evogymcm.sim.scene import Layout, Scene, build_scene
from evogymcm.sim.springs import N_STATE_ROWS, OLD_X, OLD_Y, VX, VY, X, Y
from evogymcm.sim.world import WorldObject

Objects = tuple[WorldObject, ...]  # the robot first, then the others in simulation order


@dataclass(eq=False)
class Block:
    """Up to eight worlds of one scene. `worlds` holds the world of each lane, MISSING for none."""

    index: int
    scene: Scene
    layout: Layout
    state: State
    worlds: np.ndarray


class Simulator:
    """Many voxel worlds that advance together; arrays in, arrays out, indexed by world.

    Worlds with equal objects share a block of eight lanes. A world's result depends neither on the others nor on the
    number of threads, to the last bit.

    Args:
        worlds: For each world its placed objects, the robot first.
        edge_rule: How stiffness acts on shared edges, see `build_scene`.
        physics: The constants; the benchmark's by default.
        num_threads: Threads for the blocks; all cores by default.
        grid_shape: (rows, columns) of the grid in which actuation and stiffness are given, V = rows * columns; robots
            stand in its upper left corner. By default the smallest that holds every robot.
        placed: Objects that `reset` may place anew.

    Raises:
        ValueError: For no worlds, a grid too small, a number of threads below 1, or an unknown edge rule.
    """

    def __init__(
        self,
        worlds: Sequence[Objects],
        edge_rule: str = "mean_factor",
        physics: Physics | None = None,
        num_threads: int | None = None,
        grid_shape: tuple[int, int] | None = None,
        placed: Sequence[str] = (),
    ) -> None:
        if not worlds:
            raise ValueError("worlds: got none, at least one is needed")
        if num_threads is not None and num_threads < 1:
            raise ValueError(f"num_threads: got {num_threads}, at least 1 is needed")
        shapes = np.array([objects[0].grid.shape for objects in worlds])
        needed = (int(shapes[:, 0].max()), int(shapes[:, 1].max()))
        self.grid_shape = needed if grid_shape is None else grid_shape
        if self.grid_shape[0] < needed[0] or self.grid_shape[1] < needed[1]:
            raise ValueError(f"grid_shape: got {self.grid_shape}, the robots need at least {needed}")
        self.physics = physics or Physics()
        self.edge_rule = edge_rule
        self.n_worlds = len(worlds)
        self.blocks: list[Block] = []
        self.lane_of = np.zeros((self.n_worlds, 2), np.int64)  # block and lane of each world
        self._values = self.physics.values()
        self._placed = tuple(placed)
        available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
        groups: dict[Objects, list[int]] = {}
        for world, objects in enumerate(worlds):
            groups.setdefault(tuple(objects), []).append(world)
        for objects, members in groups.items():
            self._add_blocks(build_scene(objects, edge_rule, self._placed), members)
        self.num_threads = min(num_threads or available, len(self.blocks))
        announce_compilation(advance)
        self._pool: ThreadPoolExecutor | None = None
        self._pool_process = 0  # the process that has the pool's threads

    @property
    def n_cells(self) -> int:
        """Cells of the padded grid, V."""
        return self.grid_shape[0] * self.grid_shape[1]

    def _add_blocks(self, scene: Scene, members: list[int]) -> None:
        cells = scene.objects[0].topology.cells
        columns = np.append(cells[:, 0] * self.grid_shape[1] + cells[:, 1], MISSING)  # the last entry keeps MISSING
        layout = scene.layout._replace(
            owners=columns[scene.layout.owners].astype(np.int32), drivers=columns[scene.layout.drivers].astype(np.int32)
        )
        for start in range(0, len(members), N_LANES):
            lanes = np.full(N_LANES, MISSING, np.int64)
            mine = members[start : start + N_LANES]
            lanes[: len(mine)] = mine
            self.lane_of[mine, 0] = len(self.blocks)
            self.lane_of[mine, 1] = np.arange(len(mine))
            self.blocks.append(Block(len(self.blocks), scene, layout, new_state(layout), lanes))

    def reset(self, mask: np.ndarray | None = None, offsets: np.ndarray | None = None) -> None:
        """Puts worlds back to their initial positions, at rest.

        Args:
            mask: (N,) bool, the worlds to reset; all by default.
            offsets: (N, 2) voxels, whole numbers, by which the objects named in `placed` are moved from their places.

        Raises:
            ValueError: For another shape.
        """
        if offsets is not None:
            offsets = self._rows("offsets", offsets, 2)
        for block, worlds in self._chosen(mask):
            chosen = worlds != MISSING
            reset_lanes(block.layout, block.state, chosen)
            if offsets is None:
                continue
            for placed in (block.scene.object(name) for name in self._placed):
                for lane in np.flatnonzero(chosen):
                    x, y = placed.origin + offsets[block.worlds[lane]]
                    points = placed.topology.points(int(x), int(y)).T
                    for row in ((X, Y), (OLD_X, OLD_Y)):
                        block.state.points[row[0], placed.points, lane] = points[0]
                        block.state.points[row[1], placed.points, lane] = points[1]

    def set_stiffness(self, stiffness: np.ndarray, mask: np.ndarray | None = None) -> None:
        """Sets the stiffness field of worlds, until it is set again.

        Args:
            stiffness: (N, V) factors, float64; cells without a voxel have no effect.
            mask: (N,) bool, the worlds to set; all by default.

        Raises:
            ValueError: For another shape.
        """
        stiffness = self._rows("stiffness", stiffness, self.n_cells)
        for block, worlds in self._chosen(mask):
            set_constants(block.layout, block.state.springs, worlds, stiffness)

    def step(
        self,
        actuation: np.ndarray,
        stiffness: np.ndarray | None = None,
        mask: np.ndarray | None = None,
        then: Callable[[Block, np.ndarray], None] | None = None,
    ) -> np.ndarray:
        """Advances worlds by one env-step (30 substeps).

        Args:
            actuation: (N, V) target lengths relative to rest, float64; used as they are, at cells with an actuator.
            stiffness: (N, V) stiffness factors, float64, or None to keep the present ones.
            mask: (N,) bool, the worlds to advance; all by default.
            then: Called with each block and its (8,) worlds (MISSING for lanes not advanced) in the thread that
                advanced it, to read off it.

        Returns:
            (N,) bool, the worlds that became unstable: these are in the state from before the step.

        Raises:
            ValueError: For another shape.
        """
        unstable = np.zeros(self.n_worlds, bool)
        actuation = self._rows("actuation", actuation, self.n_cells)
        factors = np.empty((0, self.n_cells)) if stiffness is None else self._rows("stiffness", stiffness, self.n_cells)

        def run(job: tuple[Block, np.ndarray]) -> None:
            block, worlds = job
            layout, values = block.layout, self._values
            while (failed := advance(layout, values, block.state, worlds, actuation, factors, SUBSTEPS)) == MISSING:
                longer = (N_LANES, 2 * block.state.pairs.shape[1], 3)
                block.state = block.state._replace(pairs=np.zeros(longer, np.int32))
            if failed:
                lanes = [lane for lane in range(N_LANES) if failed >> lane & 1]
                unstable[block.worlds[lanes]] = True
            if then is not None:
                then(block, worlds)

        self._for_each(run, self._chosen(mask))
        return unstable

    def positions(self, name: str = "robot", world: int = 0) -> np.ndarray:
        """Returns (2, n) positions in metres of an object's points in one world."""
        return self._points(name, world, X)

    def velocities(self, name: str = "robot", world: int = 0) -> np.ndarray:
        """Returns (2, n) integrated velocities of an object's points in one world."""
        return self._points(name, world, VX)

    def _points(self, name: str, world: int, row: int) -> np.ndarray:
        block_index, lane = self.lane_of[world]
        block = self.blocks[block_index]
        numbers = block.scene.object(name).points
        n = block.scene.n_points
        fixed = block.layout.static_points.T if row == X else np.zeros_like(block.layout.static_points.T)
        return np.concatenate([block.state.points[row : row + 2, :n, lane], fixed], axis=1)[:, numbers]

    def move(self, name: str, offset: tuple[float, float], world: int) -> None:
        """Shifts an object that has no fixed voxel by (x, y) metres, without giving it a velocity."""
        block_index, lane = self.lane_of[world]
        block = self.blocks[block_index]
        placed = block.scene.object(name)
        if placed.topology.is_fixed.any():
            raise ValueError(f"move: {name!r} has fixed voxels")
        for row in range(N_STATE_ROWS):
            if row not in (VX, VY):
                block.state.points[row, placed.points, lane] += offset[row % 2]

    def state(self) -> list[np.ndarray]:
        """Returns a copy of the state of all worlds, for `set_state`."""
        return [np.concatenate([b.state.points[:N_STATE_ROWS].ravel(), b.state.springs.ravel()]) for b in self.blocks]

    def set_state(self, state: Sequence[np.ndarray]) -> None:
        """Takes up the state that `state` returned, of a simulator made with the same arguments."""
        for block, saved in zip(self.blocks, state, strict=True):
            points = block.state.points[:N_STATE_ROWS]
            points[:] = saved[: points.size].reshape(points.shape)
            block.state.springs[:] = saved[points.size :].reshape(block.state.springs.shape)

    def _rows(self, name: str, values: np.ndarray, n_columns: int) -> np.ndarray:
        """Returns (N, n_columns) float64 as kernels take it: they check neither shape nor indices."""
        values = np.ascontiguousarray(values, np.float64)
        if values.shape != (self.n_worlds, n_columns):
            raise ValueError(f"{name}: got shape {values.shape}, expected {(self.n_worlds, n_columns)}")
        return values

    def _chosen(self, mask: np.ndarray | None) -> list[tuple[Block, np.ndarray]]:
        """Returns the blocks with a chosen world, each with its (8,) worlds, MISSING for the others."""
        if mask is None:
            return [(block, block.worlds) for block in self.blocks]
        if mask.shape != (self.n_worlds,) or mask.dtype != bool:
            raise ValueError(f"mask: got {mask.dtype} of shape {mask.shape}, expected bool of shape ({self.n_worlds},)")
        jobs = [
            (block, np.where(mask[block.worlds] & (block.worlds != MISSING), block.worlds, MISSING))
            for block in self.blocks
        ]
        return [(block, worlds) for block, worlds in jobs if (worlds != MISSING).any()]

    def _for_each(self, run: Callable[[Any], None], jobs: list[Any]) -> None:
        """Runs the jobs, on several threads where it pays; the kernels release Python's lock."""
        if self.num_threads == 1 or len(jobs) < 2:
            for job in jobs:
                run(job)
            return
        if self._pool is None or self._pool_process != os.getpid():  # a forked process has none of the threads
            self._pool = ThreadPoolExecutor(self.num_threads - 1, thread_name_prefix="evogymcm")
            self._pool_process = os.getpid()
        next_job = count()

        def work() -> None:
            while (i := next(next_job)) < len(jobs):
                run(jobs[i])

        others = [self._pool.submit(work) for _ in range(min(self.num_threads, len(jobs)) - 1)]
        work()
        for other in others:
            other.result()

    def close(self) -> None:
        """Ends the threads. A later step starts them again, so that nothing is lost by closing too early."""
        if self._pool is not None and self._pool_process == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Lays the tables out as in a new simulator: copied arrays would need kernels of their own, and slower ones."""
        self.__dict__.update(state)
        self.blocks = [replace(block, state=laid_out(block.state)) for block in self.blocks]


__all__ = ["Block", "Objects", "Simulator"]
