"""Objects in the JSON of the EvoGym Design Tool.

There an object's cells are flat indices into the world, y * width + x with y up, and its joints are listed from
both ends. Here they are a cropped grid, first row on top, and pairs of flat indices into it.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from evogymcm._grid import CELL_CHARS, Connections, Grid, check_grid, full_connections


def read_object(
    name: str, entry: Mapping[str, Any], width: int, height: int
) -> tuple[Grid, tuple[int, int], Connections | None]:
    """Returns grid, origin and connections (None: all) of an entry in a world of width x height cells.

    Raises:
        ValueError: Indices and types do not go together, or an index is outside the world or the object.
    """
    indices, types = np.asarray(entry.get("indices", [])), np.asarray(entry.get("types", []))
    if indices.ndim != 1 or indices.size == 0 or indices.shape != types.shape or 0 in types:
        raise ValueError(f"object {name!r}: expected a cell code above 0 for each index, got {dict(entry)}")
    if indices.dtype.kind != "i" or indices.min() < 0 or indices.max() >= width * height:
        raise ValueError(f"object {name!r}: got indices {indices.tolist()}, allowed are 0 to {width * height - 1}")
    if len(np.unique(indices)) != len(indices):
        raise ValueError(f"object {name!r}: indices repeat, got {indices.tolist()}")
    y, x = np.divmod(indices, width)
    left, top = x.min(), y.max()
    grid = np.zeros((top - y.min() + 1, x.max() - left + 1))
    grid[top - y, x - left] = types
    cells = dict(zip(indices.tolist(), np.ravel_multi_index((top - y, x - left), grid.shape).tolist(), strict=True))
    return (
        check_grid(grid, len(CELL_CHARS)),
        (int(left), int(y.min())),
        _read_neighbors(name, entry.get("neighbors"), cells),
    )


def _read_neighbors(name: str, neighbors: Mapping[str, Any] | None, cells: dict[int, int]) -> Connections | None:
    """Returns the connections meant by neighbour lists; `cells` turns world indices into grid indices."""
    if neighbors is None:
        return None
    pairs = [(int(index), int(other)) for index, others in neighbors.items() for other in others]
    if strangers := {index for pair in pairs for index in pair} - set(cells):
        raise ValueError(f"object {name!r}: neighbors name {sorted(strangers)}, its indices are {sorted(cells)}")
    return np.array([(cells[a], cells[b]) for a, b in pairs], dtype=np.int64).reshape(-1, 2).T


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
