"""Simulator: many worlds, advanced together."""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from evogymcm.sim._jit import announce_compilation, entry
from evogymcm.sim._threads import Threads
from evogymcm.sim.advance import Room, Scratch, Storage, advance, new_scratch, set_stiffness
from evogymcm.sim.constants import SUBSTEPS, Physics
from evogymcm.sim.designs import Designs, Objects
from evogymcm.sim.parts import PlacedObject
from evogymcm.sim.scene import Scene
from evogymcm.sim.tables import END_CELL, FIRST_CELL
from evogymcm.sim.vectors import aligned_zeros, on_lines
from evogymcm.sim.world import WorldObject

_LISTED = 4  # candidates, for each surface voxel, that a list has room for at first
_SLACK = 1.125  # states grow by this much more than a larger robot needs
POSITIONS, VELOCITIES, FORMER = range(3)  # of points
_CONSTANTS, _FACTORS, _GOALS = range(3)  # of springs


class Simulator:
    """Many voxel worlds that advance together; arrays in, arrays out, indexed by world.

    Each world is a job of its own: its result depends neither on the others nor on the number of threads, to the last
    bit, and worlds of different robots cost no more than equal ones.

    Args:
        worlds: For each world its placed objects, the robot first.
        edge_rule: How stiffness acts on shared edges, see `Scenery`.
        physics: The constants; the benchmark's by default.
        num_threads: Threads for the worlds; all cores by default.
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
        self.grid_shape = needed if grid_shape is None else (int(grid_shape[0]), int(grid_shape[1]))
        self._check_size(needed)
        announce_compilation(advance)
        self.physics = physics or Physics()
        self.edge_rule = edge_rule
        self.n_worlds = len(worlds)
        available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
        self.num_threads = num_threads or available
        self._threads = Threads(self.num_threads)
        self._placed = tuple(placed)
        self._worlds = [tuple(objects) for objects in worlds]
        self._first = list(self._worlds)  # before a reset has placed anything anew
        self._offsets = np.zeros((self.n_worlds, 2), np.int64)
        self._all = np.arange(self.n_worlds)
        self._unchanged = np.empty((0, self.n_cells))  # what stands for no stiffness
        self._costs = np.zeros(self.n_worlds, np.int64)  # springs of each world
        self._designs = Designs(edge_rule, self._placed, self.physics, self.grid_shape)
        self._design_of = np.array([self._designs.take(objects) for objects in self._worlds], np.int64)
        self._state = aligned_zeros(self.n_worlds, 0)
        self._room = Room(0, 0, 0, 0, 0, 0, 0, 0)
        self._scratches: list[Scratch] = []  # one a thread
        self._advance: Any = None  # the kernel, once there are scratches
        self._constants = np.array(self.physics.values())
        self._lay_out(self._designs.scenes.values())
        for world in range(self.n_worlds):
            self._begin(world)

    def _check_size(self, needed: tuple[int, int]) -> None:
        if self.grid_shape[0] < needed[0] or self.grid_shape[1] < needed[1]:
            raise ValueError(f"grid_shape: got {self.grid_shape}, the robots need at least {needed}")

    def _lay_out(self, scenes: Iterable[Scene]) -> None:
        """Makes room for new scenes, where there is too little, and takes up the designs' present tables."""
        size, room = self._state.shape[1], self._room
        for scene in scenes:
            layout = scene.layout
            numbers, springs, cells = len(layout.initial), len(layout.rest), len(layout.surface)
            robots = int(layout.objects[END_CELL] - layout.objects[FIRST_CELL])
            lists = _LISTED * cells + 32, 2 * cells + 32
            need = Room(
                numbers, springs, on_lines(cells), robots * robots, len(layout.node_place), len(scene.objects), *lists
            )
            room = Room(*(max(one, two) for one, two in zip(room, need, strict=True)))
            size = max(size, 3 * numbers + 3 * springs)
        if size > self._state.shape[1]:
            if self._state.shape[1]:
                size = on_lines(int(_SLACK * size))
            state = aligned_zeros(self.n_worlds, size)
            state[:, : self._state.shape[1]] = self._state
            self._state = state
        if room != self._room:
            self._room, self._scratches = room, []
        layouts, terrains = self._designs.layouts, self._designs.terrains
        tables = layouts.ints, layouts.floats, terrains.ints, terrains.floats
        self._storage = Storage(*tables, self._design_of, self._state, self._constants)

    def _begin(self, world: int) -> None:
        """Puts a world to its very beginning: at reset, every spring at its rest length and stiffness 1."""
        layout = self._scene(world).layout
        self._costs[world] = len(layout.rest)
        springs = self._springs(world)
        springs[_CONSTANTS], springs[_FACTORS], springs[_GOALS] = layout.constants, 1.0, layout.rest
        self._put_back(world)

    def _put_back(self, world: int) -> None:
        points = self._points(world)
        points[VELOCITIES] = 0.0
        points[POSITIONS] = points[FORMER] = self._scene(world).layout.initial.reshape(-1, 2)

    @property
    def n_cells(self) -> int:
        """Cells of the padded grid, V."""
        return self.grid_shape[0] * self.grid_shape[1]

    @property
    def storage(self) -> Storage:
        """The worlds' memory as kernels take it; other memory after `set_robot` or a `reset` that places objects."""
        return self._storage

    def _scene(self, world: int) -> Scene:
        return self._designs.scenes[int(self._design_of[world, 0])]

    def _points(self, world: int) -> np.ndarray:
        """Returns (3, points, 2) to be changed: a world's moving points, their velocities and former positions."""
        n = len(self._scene(world).layout.initial)
        return self._state[world, : 3 * n].reshape(3, -1, 2)

    def _springs(self, world: int) -> np.ndarray:
        """Returns (3, springs) to be changed: constants, factors and goals."""
        layout = self._scene(world).layout
        n, s = len(layout.initial), len(layout.rest)
        return self._state[world, 3 * n : 3 * n + 3 * s].reshape(3, -1)

    def objects(self, world: int = 0) -> tuple[PlacedObject, ...]:
        """Returns the objects of a world, the robot first."""
        return self._scene(world).objects

    def object(self, name: str, world: int = 0) -> PlacedObject:
        """Returns an object of a world; ValueError where it has none of that name."""
        return self._scene(world).object(name)

    def set_robot(self, robot: WorldObject, world: int) -> None:
        """Gives a world another robot, at reset and with stiffness 1.

        Raises:
            ValueError: It is larger than the padded grid.
        """
        self._check_size(robot.shape)
        self._set_objects(world, (robot, *self._worlds[world][1:]))
        self._begin(world)

    def _set_objects(self, world: int, objects: Objects) -> None:
        if objects == self._worlds[world]:
            return
        former = int(self._design_of[world, 0])
        self._design_of[world] = self._designs.take(objects)
        self._designs.give_back(former)
        self._worlds[world] = objects
        self._lay_out([self._scene(world)])

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
        for world in self._chosen(mask):
            if offsets is not None:
                self._place(int(world), offsets[world])
            self._put_back(world)

    def _place(self, world: int, offset: np.ndarray) -> None:
        """Moves the objects named in `placed` by whole voxels from where they first stood."""
        robot, *others = self._worlds[world]
        moved = []
        for first, now in zip(self._first[world][1:], others, strict=True):
            if first.name in self._placed:
                origin = int(first.origin[0] + offset[0]), int(first.origin[1] + offset[1])
                now = now if now.origin == origin else replace(first, origin=origin)
            moved.append(now)
        self._offsets[world] = offset
        self._set_objects(world, (robot, *moved))

    def set_stiffness(self, stiffness: np.ndarray, mask: np.ndarray | None = None) -> None:
        """Sets the stiffness field of worlds, until it is set again.

        Args:
            stiffness: (N, V) factors, float64; cells without a voxel have no effect.
            mask: (N,) bool, the worlds to set; all by default.

        Raises:
            ValueError: For another shape.
        """
        stiffness = self._rows("stiffness", stiffness, self.n_cells)
        set_stiffness(self._storage, self._chosen(mask), stiffness)

    def step(
        self,
        actuation: np.ndarray,
        stiffness: np.ndarray | None = None,
        mask: np.ndarray | None = None,
        then: Callable[[np.ndarray, int], None] | None = None,
    ) -> np.ndarray:
        """Advances worlds by one env-step (30 substeps).

        Args:
            actuation: (N, V) target lengths relative to rest, float64; used as they are, at cells with an actuator.
            stiffness: (N, V) stiffness factors, float64, or None to keep the present ones.
            mask: (N,) bool, the worlds to advance; all by default.
            then: Called with (m,) worlds, and the number of the thread that has advanced them, in this thread.

        Returns:
            (N,) bool, the worlds that became unstable: these are in the state from before the step.

        Raises:
            ValueError: For another shape.
        """
        return self.substeps(SUBSTEPS, actuation, stiffness, mask, then)

    def substeps(
        self,
        n: int,
        actuation: np.ndarray,
        stiffness: np.ndarray | None = None,
        mask: np.ndarray | None = None,
        then: Callable[[np.ndarray, int], None] | None = None,
    ) -> np.ndarray:
        """Advances worlds by `n` substeps, see `step`."""
        unstable = np.zeros(self.n_worlds, bool)
        actuation = self._rows("actuation", actuation, self.n_cells)
        factors = self._unchanged if stiffness is None else self._rows("stiffness", stiffness, self.n_cells)
        chosen = self._all if mask is None else self._chosen(mask)
        if not self._scratches:
            self._get_ready()

        def run(worlds: np.ndarray, thread: int) -> None:
            done = self._advance(self._storage, self._scratches[thread], worlds, actuation, factors, n, unstable)
            while done < len(worlds):
                self._enlarge(thread)
                scratch = self._scratches[thread]
                done += self._advance(self._storage, scratch, worlds[done:], actuation, factors, n, unstable)
            if then is not None:
                then(worlds, thread)

        if self.num_threads == 1 or len(chosen) < 2:
            if len(chosen):
                run(chosen, 0)
        else:
            self._threads.run(run, chosen, self._costs[chosen])
        return unstable

    def _get_ready(self) -> None:
        """Makes what threads need to advance worlds."""
        self._scratches = [new_scratch(self._room) for _ in range(self.num_threads)]
        none = np.zeros(0, bool)
        self._advance = entry(
            advance, self._storage, self._scratches[0], self._all, self._unchanged, self._unchanged, SUBSTEPS, none
        )

    def _enlarge(self, thread: int) -> None:
        """Makes more room for a thread's lists."""
        room = Room(*self._scratches[thread].ints[: len(Room._fields)].tolist())
        more = room._replace(candidates=2 * room.candidates, contacts=2 * room.contacts)
        self._scratches[thread] = new_scratch(more)

    def positions(self, name: str = "robot", world: int = 0) -> np.ndarray:
        """Returns (2, n) positions in metres of an object's points in one world."""
        return self._read(self.object(name, world).places, world, POSITIONS)

    def velocities(self, name: str = "robot", world: int = 0) -> np.ndarray:
        """Returns (2, n) integrated velocities of an object's points in one world."""
        return self._read(self.object(name, world).places, world, VELOCITIES)

    def _read(self, places: np.ndarray, world: int, row: int) -> np.ndarray:
        static = self._scene(world).terrain.static.reshape(-1, 2)
        out, is_moving = np.zeros((len(places), 2)), places >= 0
        out[is_moving] = self._points(world)[row, places[is_moving] >> 1]
        if row != VELOCITIES:
            out[~is_moving] = static[~places[~is_moving] >> 1]
        return np.ascontiguousarray(out.T)

    def _all_places(self, world: int) -> np.ndarray:
        return np.concatenate([placed.places for placed in self.objects(world)])

    def points(self, world: int = 0) -> np.ndarray:
        """Returns (2, n) positions in metres of all points of a world, object by object, the robot's first."""
        return self._read(self._all_places(world), world, POSITIONS)

    def set_points(self, positions: np.ndarray, velocities: np.ndarray, former: np.ndarray, world: int = 0) -> None:
        """Sets positions, integrated velocities and the positions one substep ago, where points can move.

        Args:
            positions: (2, n) metres, of all points of the world, in the order of `points`.
            velocities: (2, n).
            former: (2, n) metres.
            world: The world.
        """
        places = self._all_places(world)
        is_moving = places >= 0
        self._points(world)[:, places[is_moving] >> 1] = np.stack([positions, velocities, former])[
            :, :, is_moving
        ].transpose(0, 2, 1)

    def move(self, name: str, offset: tuple[float, float], world: int) -> None:
        """Shifts an object that has no fixed voxel by (x, y) metres, without giving it a velocity."""
        placed = self.object(name, world)
        if placed.topology.is_fixed.any():
            raise ValueError(f"move: {name!r} has fixed voxels")
        self._points(world)[[[POSITIONS], [FORMER]], placed.places >> 1] += offset

    def state(self) -> list[np.ndarray]:
        """Returns a copy of the state of all worlds, for `set_state`: the offsets, then a row a world."""
        rows = [np.concatenate([self._points(w).ravel(), self._springs(w).ravel()]) for w in range(self.n_worlds)]
        return [self._offsets.copy(), *rows]

    def set_state(self, state: Sequence[np.ndarray]) -> None:
        """Takes up the state that `state` returned, of a simulator made with the same arguments.

        Raises:
            ValueError: It is another simulator's, or of a release that kept states otherwise; then nothing has changed.
        """
        offsets, *rows = state
        sizes = [self._points(world).size + self._springs(world).size for world in range(self.n_worlds)]
        if np.shape(offsets) != self._offsets.shape or [np.size(row) for row in rows] != sizes:
            raise ValueError(f"state: it is not of {self.n_worlds} such worlds, or of a release that kept it otherwise")
        for world, row in enumerate(rows):
            self._place(world, offsets[world])
            self._state[world, : len(row)] = row

    def _rows(self, name: str, values: np.ndarray, n_columns: int) -> np.ndarray:
        """Returns (N, n_columns) float64 as kernels take it: they check neither shape nor indices."""
        values = np.ascontiguousarray(values, np.float64)
        if values.shape != (self.n_worlds, n_columns):
            raise ValueError(f"{name}: got shape {values.shape}, expected {(self.n_worlds, n_columns)}")
        return values

    def _chosen(self, mask: np.ndarray | None) -> np.ndarray:
        """Returns the numbers of the chosen worlds."""
        if mask is None:
            return self._all
        if mask.shape != (self.n_worlds,) or mask.dtype != bool:
            raise ValueError(f"mask: got {mask.dtype} of shape {mask.shape}, expected bool of shape ({self.n_worlds},)")
        return np.flatnonzero(mask)

    def close(self) -> None:
        """Ends the threads. A later step starts them again, so that nothing is lost by closing too early."""
        self._threads.close()

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_scratches": [], "_advance": None, "_storage": None, "_state": self._state.copy()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Lays the state out as in a new simulator: a copied array need not begin on a cache line."""
        self.__dict__.update(state)
        saved = self._state
        self._state = aligned_zeros(*saved.shape)
        self._state[:] = saved
        self._lay_out([])


__all__ = ["Objects", "Simulator"]
