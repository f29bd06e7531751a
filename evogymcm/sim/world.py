"""Worlds: named objects on a grid of cells, read from pictures or from the EvoGym Design Tool's JSON."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from evogymcm._grid import (
    CELL_CHARS,
    EMPTY,
    Connections,
    Grid,
    check_connections,
    check_grid,
    full_connections,
    grid_rows,
    has_actuator,
)
from evogymcm._messages import brief, some
from evogymcm._settings import check_count, check_pair
from evogymcm.sim._design_tool import MOST_CELLS, read_content, read_object, write_object
from evogymcm.sim._pictures import load_picture, read_picture

FILE_SUFFIXES = (".json", ".txt")
ROBOT = "robot"  # the name of the object that is simulated first


@dataclass(frozen=True, eq=False)
class WorldObject:
    """A named piece of voxels, joined where `connections` say so. Equal content makes equal objects.

    Args:
        name: Its name, unique in a world.
        grid: Cell codes 0 to 5 of shape (rows, cols), first row on top. Stored as a read-only int8 copy.
        origin: World cell (x right, y up, from 0) of the grid's lower-left corner.
        connections: Joined pairs of flat row-major indices into the grid, of shape (2, k). None joins all
            side-adjacent voxels.

    Raises:
        ValueError: The name is empty, the grid is not valid or has no voxel, the origin is negative, or a
            connection does not join two side-adjacent voxels.
    """

    name: str
    grid: Grid
    origin: tuple[int, int]
    connections: Connections | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip() or "\n" in self.name:
            raise ValueError(f"object name: got {brief(self.name)}, expected one line of text")
        try:
            grid = check_grid(self.grid, len(CELL_CHARS))
        except ValueError as error:
            raise ValueError(f"object {brief(self.name)}: {error}") from error
        if not grid.any():
            raise ValueError(f"object {brief(self.name)} has no voxel")
        try:
            x, y = (check_count("origin", cell, 0) for cell in check_pair("origin", self.origin))
        except ValueError as error:
            raise ValueError(f"object {brief(self.name)}: {error}") from error
        grid.flags.writeable = False
        object.__setattr__(self, "grid", grid)
        object.__setattr__(self, "origin", (x, y))
        if self.connections is not None:
            connections = check_connections(self.connections, grid)
            connections.flags.writeable = False
            is_full = np.array_equal(connections, full_connections(grid))
            object.__setattr__(self, "connections", None if is_full else connections)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return self.grid.shape[0], self.grid.shape[1]

    @property
    def end(self) -> tuple[int, int]:
        """World cell (x, y) just beyond the grid's upper-right corner."""
        return self.origin[0] + self.grid.shape[1], self.origin[1] + self.grid.shape[0]

    @cached_property
    def _key(self) -> tuple[object, ...]:
        connections = None if self.connections is None else self.connections.tobytes()
        return self.name, self.origin, self.shape, self.grid.tobytes(), connections

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, WorldObject) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)


@dataclass(frozen=True)
class World:
    """Objects on a grid, in the order of adding.

    As in EvoGym, the whole bounding rectangle of an object must be free of voxels when it is added, but later
    objects may stand in its empty cells. Width and height carry no physics.

    Args:
        width: Cells across.
        height: Cells up.
        objects: The objects.

    Raises:
        ValueError: Two objects have one name, an object does not fit in the grid, or its rectangle is not free.
    """

    width: int
    height: int
    objects: tuple[WorldObject, ...] = ()

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            object.__setattr__(self, name, check_count(f"world: {name}", getattr(self, name)))
        if self.width * self.height > MOST_CELLS:
            raise ValueError(f"world: {self.width} x {self.height} cells are more than {MOST_CELLS:,}")
        cells = np.full((self.height, self.width), -1)  # which object has a voxel there; row 0 at the bottom
        names: set[str] = set()
        for number, obj in enumerate(self.objects):
            if obj.name in names:
                raise ValueError(f"object {brief(obj.name)}: the world already has one of that name")
            names.add(obj.name)
            (x, y), (right, top) = obj.origin, obj.end
            if right > self.width or top > self.height:
                raise ValueError(
                    f"object {brief(obj.name)}: ends at {(right, top)}, outside the {self.width} x {self.height} world"
                )
            rectangle = cells[y:top, x:right]
            if (rectangle >= 0).any():
                raise ValueError(
                    f"object {brief(obj.name)}: its bounding rectangle from {(x, y)} to {(right, top)} must be free, "
                    f"but {brief(self.objects[rectangle.max()].name)} has voxels there"
                )
            rectangle[obj.grid[::-1] != EMPTY] = number

    def __getitem__(self, name: str) -> WorldObject:
        """Returns the object of that name."""
        for obj in self.objects:
            if obj.name == name:
                return obj
        raise KeyError(f"{brief(name)}: the world's objects are {some(obj.name for obj in self.objects)}")

    def place(self, obj: WorldObject) -> "World":
        """Returns this world, grown where needed, with one more object.

        Raises:
            ValueError: The name is taken or the object's bounding rectangle is not free.
        """
        right, top = obj.end
        return World(max(self.width, right), max(self.height, top), (*self.objects, obj))

    def find_robot(self) -> WorldObject | None:
        """Returns the object named "robot", else the one with actuators, None where no object has any.

        Raises:
            ValueError: Several objects have actuators, and none is named "robot".
        """
        robots = [obj for obj in self.objects if obj.name == ROBOT or has_actuator(obj.grid)]
        robots = [obj for obj in robots if obj.name == ROBOT] or robots
        if len(robots) > 1:
            names = some(brief(obj.name) for obj in robots)
            raise ValueError(f"world: {names} have actuators, name the one that is meant {ROBOT!r}")
        return robots[0] if robots else None

    def without(self, name: str) -> "World":
        """Returns this world without the object of that name."""
        return World(self.width, self.height, tuple(obj for obj in self.objects if obj.name != name))

    def simulation_order(self) -> tuple[WorldObject, ...]:
        """Returns the objects as EvoGym simulates them: those with actuators first, each kind by name as plain text.

        The robot comes before all others; EvoGym's stands among those with actuators.
        """
        return tuple(sorted(self.objects, key=lambda o: (o.name != ROBOT, not has_actuator(o.grid), o.name)))

    @classmethod
    def load(cls, source: str | os.PathLike[str]) -> "World":
        """Returns a world that comes with the package, see `world_names`, or one read from a file.

        Args:
            source: A name; or a path object, or a text that ends with `.json` (of the EvoGym Design Tool, see
                `from_design_tool`) or `.txt` (see `from_picture`).

        Raises:
            ValueError: There is no such world or file, or it cannot be read.
        """
        if not is_world_file(source):
            return cls.from_picture(load_picture(str(source)))
        path = Path(source)
        if path.suffix.lower() not in FILE_SUFFIXES or not path.is_file():
            raise ValueError(f"world {brief(path.name)}: there is no such file that ends with .json or .txt")
        if path.suffix.lower() == ".json":
            return cls.from_design_tool(path)
        try:
            return cls.from_picture(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"world {brief(path.name)}: {error}") from error

    @classmethod
    def from_picture(cls, text: str, name: str = "ground") -> "World":
        """Returns the world that a text draws.

        A picture is rows of cells (`.` empty, `R` rigid, `S` soft, `H` and `V` actuators, `F` fixed), top row first.
        Where it has no headers, it is one object at the origin. Otherwise each object has a header and then its
        rows, and is added in that order; an object that is a prefab needs no rows:

            size 60 9
            object ground at 0 0
            F....F
            FFFFFF
            object block_0 at 1 1 is rigid_2x2

        Lines that begin with `#`, and blank ones, are skipped. Without a size, the world is as large as its objects.

        Args:
            text: The picture.
            name: The name of the object of a picture without headers.

        Raises:
            ValueError: A header or a row cannot be read, or the objects do not fit together.
        """
        size, parts = read_picture(text, name)
        objects = tuple(WorldObject(*part) for part in parts)
        if size is None:
            size = max(obj.end[0] for obj in objects), max(obj.end[1] for obj in objects)
        return cls(*size, objects)

    def to_picture(self) -> str:
        """Returns the text that `from_picture` turns into this world.

        Raises:
            ValueError: Some neighbours in an object are not joined, which a picture cannot show.
        """
        lines = [f"size {self.width} {self.height}"]
        for obj in self.objects:
            if obj.connections is not None:
                raise ValueError(f"object {brief(obj.name)}: a picture cannot show connections; use to_design_tool()")
            lines += ["", f"object {obj.name} at {obj.origin[0]} {obj.origin[1]}", *grid_rows(obj.grid)]
        return "\n".join(lines) + "\n"

    @classmethod
    def from_design_tool(cls, source: str | os.PathLike[str] | Mapping[str, Any]) -> "World":
        """Returns a world saved by the EvoGym Design Tool, its objects cropped to their bounding rectangles.

        As in EvoGym, only `grid_width` says where a cell is: a world is as high as its objects need, whatever
        `grid_height` says, and other keys are ignored.

        Args:
            source: The JSON file's path or its parsed content: `grid_width` and `objects`, each of which has `indices`
                (y * grid_width + x, y up), `types` (cell codes) and `neighbors` (a list of joined indices for each
                index; if absent, all side-adjacent voxels are joined).

        Raises:
            ValueError: Something is missing, indices or types are out of range, or the objects do not fit together.
        """
        what, content = read_content(source)
        width, height = content["grid_width"], content.get("grid_height", 0)
        objects = []
        for name, entry in content["objects"].items():
            try:
                objects.append(WorldObject(name, *read_object(entry, width)))
            except ValueError as error:
                raise ValueError(f"{what}, object {brief(name)}: {error}") from error
        return cls(width, max([1, height, *(obj.end[1] for obj in objects)]), tuple(objects))

    def to_design_tool(self) -> dict[str, Any]:
        """Returns the content of a Design Tool JSON file for this world."""
        objects = {obj.name: write_object(obj.grid, obj.origin, obj.connections, self.width) for obj in self.objects}
        return {"grid_width": self.width, "grid_height": self.height, "objects": objects}


def is_world_file(source: object) -> "TypeGuard[str | os.PathLike[str]]":
    """Returns whether something is the path of a world's file, not a name: a path object, or a text with its suffix."""
    return isinstance(source, os.PathLike) or (isinstance(source, str) and source.lower().endswith(FILE_SUFFIXES))
