"""A world as it is drawn: ground that never moves, and loose blocks, for robots to walk in."""

from typing import Any

import numpy as np

from evogymcm._grid import EMPTY, FIXED, H_ACT, RIGID, SOFT, V_ACT, Grid
from evogymcm.envs.tasks.walking import Walking
from evogymcm.envs.terrain import walking_task
from evogymcm.sim.world import World, WorldObject
from evogymcm.studio.sketch import Sketch, label_pieces

GROUND = "ground"


class Terrain(Sketch):
    """A grid of fixed, rigid and soft cells; see `Sketch` for strokes and undo.

    All fixed cells are one object, the ground. Other cells that touch side by side are a loose block each.

    Args:
        grid: Cell codes (0 empty, 1 rigid, 2 soft, 5 fixed) of shape (rows, cols), first row on top.

    Raises:
        ValueError: It holds other codes, or is larger than 30 x 100.
    """

    _smallest, _largest = (4, 10), (30, 100)
    _codes = (FIXED, RIGID, SOFT, EMPTY)

    @classmethod
    def _check_codes(cls, cells: Grid) -> None:
        if np.isin(cells, (H_ACT, V_ACT)).any():
            raise ValueError("terrain: actuators (H, V) are for robots, allowed are '.', 'F', 'R' and 'S'")

    @classmethod
    def flat(cls, rows: int = 12, cols: int = 40) -> "Terrain":
        """Returns flat ground, two cells high."""
        grid = np.zeros(cls._check_shape((rows, cols)), np.int8)
        grid[-2:] = FIXED
        return cls(grid)

    @classmethod
    def of(cls, world: World | str) -> "Terrain":
        """Returns the drawing of a world, or of the package's world of that name, without its robot.

        Raises:
            ValueError: There is no such world, it is larger than 30 x 100, or another object than the robot has
                actuators.
        """
        world = world if isinstance(world, World) else World.load(world)
        robot = world.find_robot()
        world = world if robot is None else world.without(robot.name)
        top = max((obj.end[1] for obj in world.objects), default=0)
        grid = np.zeros(cls._check_shape((max(top + 6, cls._smallest[0]), max(world.width, cls._smallest[1]))), np.int8)
        for obj in world.objects:
            (x, y), (right, end) = obj.origin, obj.end
            part = grid[len(grid) - end : len(grid) - y, x:right]
            part[obj.grid != EMPTY] = obj.grid[obj.grid != EMPTY]
        return cls(grid)

    def _check_code(self, code: int) -> int:
        """Returns the cell code; ValueError where it may not be drawn."""
        if code not in self._codes:
            raise ValueError(f"cell code: got {code}, allowed are {', '.join(map(str, self._codes))}")
        return int(code)

    def world(self) -> World:
        """Returns the world that is drawn.

        Raises:
            ValueError: There is no ground, or a block stands within another's rectangle.
        """
        grid = self._layers[0]
        fixed = grid == FIXED
        if not fixed.any():
            raise ValueError("There is no ground yet (F).")
        objects = [_cut(GROUND, np.where(fixed, grid, EMPTY))]
        loose = label_pieces((grid != EMPTY) & ~fixed)
        for number in range(1, int(loose.max()) + 1):
            objects.append(_cut(f"block_{number}", np.where(loose == number, grid, EMPTY)))
        return World(self.shape[1], self.shape[0], tuple(objects))

    def task(self, rows: int, cols: int) -> Walking:
        """Returns the task to walk to the right end, for robots of that grid.

        Raises:
            ValueError: The world is none, or has no room for the robot at its left end.
        """
        return walking_task(self.world(), room=(rows, cols), id="Terrain")

    def problem(self, rows: int, cols: int) -> str | None:
        """Returns in words why a robot of that grid cannot walk here, None where it can."""
        try:
            self.task(rows, cols)
        except ValueError as error:
            return str(error)
        return None

    def record(self) -> dict[str, Any]:
        """Returns the terrain as JSON has it; `from_record` reads it back."""
        return {"cells": self.text}

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> "Terrain":
        """Returns what `record` wrote; ValueError where it is something else."""
        terrain = cls.flat()
        terrain.write(str(record.get("cells", "")))
        terrain._past.clear()
        return terrain


def _cut(name: str, grid: np.ndarray) -> WorldObject:
    """Returns the occupied part of a grid as an object."""
    rows, cols = (np.flatnonzero((grid != EMPTY).any(axis)) for axis in (1, 0))
    part = grid[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    return WorldObject(name, part, (int(cols[0]), int(len(grid) - 1 - rows[-1])))
