"""Objects in the JSON of the EvoGym Design Tool, read as EvoGym reads them.

There an object's cells are flat indices into the world, y * width + x with y up, and its joints are listed from
both ends. Here they are a cropped grid, first row on top, and pairs of flat indices into it.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from evogymcm._grid import CELL_CHARS, Connections, Grid, check_grid, full_connections
from evogymcm._messages import brief, some

MOST_CELLS = 10_000_000  # of a world; files with stray indices would otherwise fill the memory


def read_content(source: str | os.PathLike[str] | Mapping[str, Any]) -> tuple[str, Mapping[str, Any]]:
    """Returns what a world is called in messages, and its content, which has a width and objects by name.

    Args:
        source: The JSON file's path or its parsed content.

    Raises:
        ValueError: It is not JSON, or something is missing or of another kind.
    """
    what, content = "Design Tool world", source
    if not isinstance(source, Mapping):
        what = f"{what} {Path(source).name}"
        try:
            content = json.loads(Path(source).read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"{what}: it is not JSON ({error})") from error
    if not isinstance(content, Mapping) or not {"grid_width", "objects"} <= set(content):
        raise ValueError(f"{what}: needs grid_width and objects, got {brief(content)}")
    size = [content["grid_width"], content.get("grid_height", 0)]
    if not all(type(cells) is int and cells <= MOST_CELLS for cells in size) or size[0] < 1:
        allowed = f"whole numbers of at most {MOST_CELLS:,}"
        raise ValueError(f"{what}: got grid_width and grid_height {brief(size)}, expected {allowed}")
    if not isinstance(content["objects"], Mapping):
        raise ValueError(f"{what}: objects must be given by name, got {brief(content['objects'])}")
    return what, content


def read_object(entry: Any, width: int) -> tuple[Grid, tuple[int, int], Connections | None]:
    """Returns grid, origin and connections (None: all) of an entry in a world that is `width` cells across.

    How high the world is plays no part, as in EvoGym. Cells of type 0 are empty, but belong to the rectangle.

    Raises:
        ValueError: Indices, types and neighbors do not go together, or one is out of its range.
    """
    if not isinstance(entry, Mapping) or not {"indices", "types"} <= set(entry):
        raise ValueError(f"expected indices and types, got {brief(entry)}")
    indices, types = (_numbers(name, entry[name]) for name in ("indices", "types"))
    if len(indices) != len(types):
        raise ValueError(f"got {len(indices)} indices and {len(types)} types, expected one type for each index")
    if not indices.size or not types.any():
        raise ValueError("it has no voxel")
    if indices.min() < 0 or len(np.unique(indices)) != len(indices):
        raise ValueError("indices must be 0 or more and not repeat, got " + some(_first_wrong(indices)))
    y, x = np.divmod(indices, width)
    left, top = x.min(), y.max()
    if (top + 1) * width > MOST_CELLS:
        raise ValueError(f"index {indices.max()} makes a world of {width} x {top + 1} cells, more than {MOST_CELLS:,}")
    grid = np.zeros((top - y.min() + 1, x.max() - left + 1))
    grid[top - y, x - left] = types
    cells = dict(zip(indices.tolist(), np.ravel_multi_index((top - y, x - left), grid.shape).tolist(), strict=True))
    checked = check_grid(grid, len(CELL_CHARS))
    return checked, (int(left), int(y.min())), _read_neighbors(entry.get("neighbors"), cells, checked)


def _numbers(name: str, values: Any) -> np.ndarray:
    """Returns a list of integers as an array, empty or not."""
    try:
        numbers = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.empty((0, 0))
    if numbers.ndim != 1 or not np.array_equal(numbers, np.trunc(numbers)) or (abs(numbers) > 2**31).any():
        raise ValueError(f"{name}: expected a list of integers, got {brief(values)}")
    return numbers.astype(np.int64)


def _first_wrong(indices: np.ndarray) -> list[int]:
    values, counts = np.unique(indices, return_counts=True)
    return values[(values < 0) | (counts > 1)].tolist()


def _read_neighbors(neighbors: Any, cells: dict[int, int], grid: Grid) -> Connections | None:
    """Returns the connections meant by neighbour lists; `cells` turns world indices into grid indices.

    One end is enough. As in EvoGym, pairs that do not touch with a side join nothing.
    """
    if neighbors is None:
        return None
    try:
        pairs = [(int(index), int(other)) for index, others in neighbors.items() for other in others]
        listed = {int(index) for index in neighbors}
    except (AttributeError, TypeError, ValueError, OverflowError):
        raise ValueError(f"neighbors: expected lists of indices by index, got {brief(neighbors)}") from None
    if strangers := sorted((listed | {other for _, other in pairs}) - set(cells)):
        raise ValueError(f"neighbors: {some(strangers)} are none of its {len(cells)} indices")
    if without := sorted(set(cells) - listed):
        raise ValueError(
            f"neighbors: none are given for {some(without)} (an empty list joins nothing; without neighbors all cells "
            "are joined)"
        )
    touching = set(map(tuple, full_connections(grid).T.tolist()))
    joined = {(min(cells[a], cells[b]), max(cells[a], cells[b])) for a, b in pairs} & touching
    return np.array(sorted(joined), dtype=np.int64).reshape(-1, 2).T


def write_object(grid: Grid, origin: tuple[int, int], connections: Connections | None, width: int) -> dict[str, Any]:
    """Returns the entry of an object in a world of that width."""
    cells = np.flatnonzero(grid)
    row, column = np.unravel_index(cells, grid.shape)
    world = (origin[1] + len(grid) - 1 - row) * width + origin[0] + column
    index = dict(zip(cells.tolist(), world.tolist(), strict=True))
    neighbors: dict[str, list[int]] = {str(own): [] for own in index.values()}
    for a, b in (full_connections(grid) if connections is None else connections).T.tolist():
        neighbors[str(index[a])].append(index[b])
        neighbors[str(index[b])].append(index[a])
    return {"indices": list(index.values()), "types": grid.ravel()[cells].tolist(), "neighbors": neighbors}
