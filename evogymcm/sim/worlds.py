"""The memory of many voxel worlds: which objects each of them holds, and its state."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from evogymcm.sim.constants import Physics
from evogymcm.sim.designs import Designs, Objects
from evogymcm.sim.kernels.advance import Room, Storage
from evogymcm.sim.kernels.vectors import aligned_zeros, on_lines
from evogymcm.sim.parts import PlacedObject
from evogymcm.sim.scene import Scene
from evogymcm.sim.tables import END_CELL, FIRST_CELL
from evogymcm.sim.world import WorldObject

_LISTED = 4  # candidates, for each surface voxel, that a list has room for at first
_SLACK = 1.125  # states grow by this much more than a larger robot needs
POSITIONS, VELOCITIES, FORMER = range(3)  # of points
_CONSTANTS, _FACTORS, _GOALS = range(3)  # of springs


class Worlds:
    """The memory of a `Simulator`, with the same arguments.

    Raises:
        ValueError: For no worlds, a grid too small, or an unknown edge rule.
    """

    def __init__(
        self,
        worlds: Sequence[Objects],
        edge_rule: str,
        physics: Physics | None,
        grid_shape: tuple[int, int] | None,
        placed: Sequence[str],
    ) -> None:
        if not worlds:
            raise ValueError("worlds: got none, at least one is needed")
        shapes = np.array([objects[0].grid.shape for objects in worlds])
        needed = (int(shapes[:, 0].max()), int(shapes[:, 1].max()))
        self.grid_shape = needed if grid_shape is None else (int(grid_shape[0]), int(grid_shape[1]))
        self._check_size(needed)
        self.physics = physics or Physics()
        self.edge_rule = edge_rule
        self.n_worlds = len(worlds)
        self._placed = tuple(placed)
        self._worlds = [tuple(objects) for objects in worlds]
        self._first = list(self._worlds)  # before a reset has placed anything anew
        self._offsets = np.zeros((self.n_worlds, 2), np.int64)
        self._costs = np.zeros(self.n_worlds, np.int64)  # springs of each world
        self._designs = Designs(edge_rule, self._placed, self.physics, self.grid_shape)
        self._design_of = np.array([self._designs.take(objects) for objects in self._worlds], np.int64)
        self._state = aligned_zeros(self.n_worlds, 0)
        self._room = Room(0, 0, 0, 0, 0, 0, 0, 0)
        self._constants = np.array(self.physics.values())
        self._lay_out(self._designs.scenes.values())
        for world in range(self.n_worlds):
            self._costs[world] = len(self._scene(world).layout.rest)
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
            size = max(size, scene.n_numbers)
        if size > self._state.shape[1]:
            if self._state.shape[1]:
                size = on_lines(int(_SLACK * size))
            state = aligned_zeros(self.n_worlds, size)
            state[:, : self._state.shape[1]] = self._state
            self._state = state
        self._room = room
        layouts, terrains = self._designs.layouts, self._designs.terrains
        tables = layouts.ints, layouts.floats, terrains.ints, terrains.floats
        self._storage = Storage(*tables, self._design_of, self._state, self._constants)

    def _begin(self, world: int) -> None:
        """Puts a world to its very beginning: at reset, every spring at its rest length and stiffness 1."""
        layout, springs = self._scene(world).layout, self._springs(world)
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
        """Returns an object of a world by name; ValueError if there is none."""
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
        if objects != self._worlds[world]:
            self._put_in({world: objects}, {world: self._designs.take(objects)})

    def _put_in(self, objects: Mapping[int, Objects], designs: Mapping[int, tuple[int, int]]) -> None:
        """Has worlds hold other objects, of which the designs are taken."""
        for world, design in designs.items():
            self._designs.give_back(int(self._design_of[world, 0]))
            self._design_of[world], self._worlds[world] = design, objects[world]
        self._lay_out([self._scene(world) for world in designs])
        for world in designs:
            self._costs[world] = len(self._scene(world).layout.rest)

    def _moved(self, world: int, offset: np.ndarray) -> Objects:
        """Returns a world's objects, those named in `placed` moved by whole voxels from where they first stood."""
        robot, *others = self._worlds[world]
        moved = []
        for first, now in zip(self._first[world][1:], others, strict=True):
            if first.name in self._placed:
                origin = int(first.origin[0] + offset[0]), int(first.origin[1] + offset[1])
                now = now if now.origin == origin else replace(first, origin=origin)
            moved.append(now)
        return (robot, *moved)

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

    def move(self, name: str, offset: tuple[float, float] | np.ndarray, world: int) -> None:
        """Shifts an object that has no fixed voxel, or each of its points, without giving it a velocity.

        Args:
            name: Of the object.
            offset: (x, y) metres, or (n, 2) for its n points.
            world: The world.

        Raises:
            ValueError: It has fixed voxels, or there is no such object.
        """
        placed = self.object(name, world)
        if placed.topology.is_fixed.any():
            raise ValueError(f"move: {name!r} has fixed voxels")
        self._points(world)[[[POSITIONS], [FORMER]], placed.places >> 1] += offset

    def state(self) -> list[np.ndarray]:
        """Returns a copy of the state of all worlds, for `set_state`: the offsets, then a row a world."""
        rows = [np.concatenate([self._points(w).ravel(), self._springs(w).ravel()]) for w in range(self.n_worlds)]
        return [self._offsets.copy(), *rows]

    def set_state(self, state: Sequence[np.ndarray], robots: Sequence[WorldObject] | None = None) -> None:
        """Restores a state from `state`, of a simulator made with the same arguments.

        Args:
            state: The state.
            robots: The robot that each world had; the current ones by default.

        Raises:
            ValueError: It belongs to another simulator, or to a release with another format; then nothing has changed.
        """
        offsets, *rows = [np.asarray(part, np.float64) for part in state] or [np.zeros(0)]
        fits = offsets.shape == self._offsets.shape and len(rows) == self.n_worlds
        changed: dict[int, Objects] = {}
        for world in range(self.n_worlds if fits else 0):
            robot, *others = self._moved(world, offsets[world])
            objects = (robot if robots is None else robots[world], *others)
            if objects != self._worlds[world]:
                changed[world] = objects
        designs = {world: self._designs.take(objects) for world, objects in changed.items()}
        numbers = [int(designs.get(world, self._design_of[world])[0]) for world in range(self.n_worlds)]
        if not fits or [row.shape for row in rows] != [(self._designs.scenes[n].n_numbers,) for n in numbers]:
            for number, _ in designs.values():
                self._designs.give_back(number)
            raise ValueError(f"state: it is not of {self.n_worlds} such worlds, or of a release that kept it otherwise")
        self._put_in(changed, designs)
        self._offsets[:] = offsets
        for world, row in enumerate(rows):
            self._state[world, : len(row)] = row

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_storage": None, "_state": self._state.copy()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Lays the state out as in a new simulator: a copied array need not begin on a cache line."""
        self.__dict__.update(state)
        saved = self._state
        self._state = aligned_zeros(*saved.shape)
        self._state[:] = saved
        self._lay_out([])
