"""The designs that a simulator's worlds hold: each robot in its scenery once, however many worlds share it."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from evogymcm.sim.constants import Physics
from evogymcm.sim.kernels.vectors import aligned_zeros, on_lines
from evogymcm.sim.scene import Scene, Scenery
from evogymcm.sim.tables import pack
from evogymcm.sim.world import WorldObject

Objects = tuple[WorldObject, ...]  # the robot first, then the others in simulation order
KEPT = 256  # sceneries that no design uses are kept for later resets, up to so many in all
_SLACK = 1.125  # rows are made this much wider than the present need, so that other robots seldom need wider ones


class Rows:
    """Pairs of rows, of int32 and of float64, that are taken and given back; they grow where need be."""

    def __init__(self) -> None:
        self.ints, self.floats = np.zeros((0, 0), np.int32), np.zeros((0, 0))
        self._free: list[int] = []

    def put(self, row: tuple[np.ndarray, np.ndarray]) -> int:
        """Stores a pair of rows and returns its number."""
        if not self._free or row[0].size > self.ints.shape[1] or row[1].size > self.floats.shape[1]:
            self._grow(row)
        number = self._free.pop()
        self.ints[number, : row[0].size], self.floats[number, : row[1].size] = row
        return number

    def give_back(self, number: int) -> None:
        """Lets others have a number's place."""
        self._free.append(number)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Has the numbers begin on a cache line, as a copied array need not."""
        self.__dict__.update(state)
        floats = self.floats
        self.floats = aligned_zeros(*floats.shape)
        self.floats[:] = floats

    def _grow(self, row: tuple[np.ndarray, np.ndarray]) -> None:
        n = len(self.ints)
        height = n if self._free else n + max(1, n // 4)
        widths = []
        for new, old in ((row[0], self.ints), (row[1], self.floats)):
            fits = new.size <= old.shape[1]
            widths.append(old.shape[1] if fits else on_lines(int(_SLACK * new.size) if n else new.size))
        ints, floats = np.zeros((height, widths[0]), np.int32), aligned_zeros(height, widths[1])
        ints[:n, : self.ints.shape[1]], floats[:n, : self.floats.shape[1]] = self.ints, self.floats
        self.ints, self.floats = ints, floats
        self._free = [*range(height - 1, n - 1, -1), *self._free]


class Designs:
    """Scenes by their objects, and their tables in common arrays.

    Args:
        edge_rule: See `Scenery`.
        placed: Objects that a reset may place anew.
        physics: Constants.
        grid_shape: (rows, columns) of the padded grid.
    """

    def __init__(self, edge_rule: str, placed: Sequence[str], physics: Physics, grid_shape: tuple[int, int]) -> None:
        self._options: tuple[Any, ...] = (edge_rule, tuple(placed), physics)
        self._grid_shape = grid_shape
        self._sceneries: dict[Objects, tuple[Scenery, int]] = {}
        self._numbers: dict[Objects, int] = {}
        self._users: dict[int, int] = {}
        self.scenes: dict[int, Scene] = {}  # by their numbers
        self._objects: dict[int, Objects] = {}
        self.layouts, self.terrains = Rows(), Rows()

    def take(self, objects: Objects) -> tuple[int, int]:
        """Returns the numbers of a design and of its scenery, for one more world that holds it."""
        others = objects[1:]
        if others not in self._sceneries:
            if len(self._sceneries) >= KEPT:
                self._forget()
            scenery = Scenery(others, *self._options)
            self._sceneries[others] = scenery, self.terrains.put(pack(scenery.terrain))
        scenery, terrain = self._sceneries[others]
        number = self._numbers.get(objects)
        if number is None:
            scene = scenery.scene(objects[0], self._grid_shape)
            number = self.layouts.put(pack(scene.layout))
            self._numbers[objects], self.scenes[number], self._objects[number] = number, scene, objects
            self._users[number] = 0
        self._users[number] += 1
        return number, terrain

    def _forget(self) -> None:
        """Drops the sceneries that no design uses: resets may draw places without end."""
        used = {objects[1:] for objects in self._numbers}
        for others in [others for others in self._sceneries if others not in used]:
            self.terrains.give_back(self._sceneries.pop(others)[1])

    def give_back(self, number: int) -> None:
        """Says that a world no longer holds a design."""
        self._users[number] -= 1
        if not self._users[number]:
            del self._users[number], self.scenes[number], self._numbers[self._objects.pop(number)]
            self.layouts.give_back(number)
