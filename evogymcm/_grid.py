"""Grids of cells, shared by bodies and worlds: codes, text form, validation, adjacency."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evogymcm._messages import brief, some

EMPTY, RIGID, SOFT, H_ACT, V_ACT, FIXED = range(6)
CELL_CHARS = ".RSHVF"  # the character of a cell code is CELL_CHARS[code]
BODY_CHARS = CELL_CHARS[:FIXED]  # fixed cells are for terrain

Grid: TypeAlias = NDArray[np.int8]
Connections: TypeAlias = NDArray[np.int64]


def is_connected(grid: ArrayLike) -> bool:
    """Returns whether the occupied cells form one piece under side adjacency; the empty grid does not."""
    cells = np.asarray(grid)
    left_over = {(int(r), int(c)) for r, c in np.argwhere(cells != EMPTY)}
    if not left_over:
        return False
    frontier = [left_over.pop()]
    while frontier:
        r, c = frontier.pop()
        for cell in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
            if cell in left_over:
                left_over.remove(cell)
                frontier.append(cell)
    return not left_over


def has_actuator(grid: ArrayLike) -> bool:
    """Returns whether some cell is a horizontal or vertical actuator."""
    cells = np.asarray(grid)
    return bool(np.any((cells == H_ACT) | (cells == V_ACT)))


def full_connections(grid: ArrayLike) -> Connections:
    """Returns all pairs of side-adjacent occupied cells as flat indices of shape (2, k).

    Cells come in row-major order, each with its right neighbour first and its lower one second.
    """
    occupied = np.asarray(grid) != EMPTY
    index = np.arange(occupied.size).reshape(occupied.shape)
    right = occupied[:, :-1] & occupied[:, 1:]
    below = occupied[:-1] & occupied[1:]
    first = np.concatenate([index[:, :-1][right], index[:-1][below]])
    second = np.concatenate([index[:, 1:][right], index[1:][below]])
    order = np.lexsort((second, first))
    return np.stack([first[order], second[order]]).astype(np.int64)


def check_connections(connections: ArrayLike, grid: ArrayLike) -> Connections:
    """Returns the connections without repetition, in the order of `full_connections`.

    Unlike EvoGym, which ignores pairs of cells that are not side-adjacent, this is strict.

    Raises:
        ValueError: The shape is not (2, k), or a pair does not join two side-adjacent occupied cells.
    """
    cells = np.asarray(grid)
    pairs = np.asarray(connections)
    if not pairs.size:
        pairs = np.empty((2, 0), np.int64)  # how EvoGym's own files write none
    if pairs.ndim != 2 or len(pairs) != 2 or not np.issubdtype(pairs.dtype, np.integer):
        raise ValueError(f"connections: got {pairs.dtype} of shape {pairs.shape}, expected integers of shape (2, k)")
    allowed = {(int(a), int(b)) for a, b in full_connections(cells).T}
    given = {(min(a, b), max(a, b)) for a, b in pairs.T.tolist()}
    if wrong := sorted(given - allowed):
        raise ValueError(
            f"connections: {some(wrong)} are not pairs of side-adjacent voxels (flat row-major indices) of "
            f"{brief('/'.join(grid_rows(cells)))}"
        )
    return np.array(sorted(given), dtype=np.int64).reshape(-1, 2).T.copy()


def grid_rows(grid: ArrayLike) -> list[str]:
    """Returns the grid as rows of text, top row first."""
    return ["".join(CELL_CHARS[code] for code in row) for row in np.asarray(grid)]


def grid_from_rows(rows: Sequence[str], chars: str = CELL_CHARS) -> Grid:
    """Returns the int8 cell codes of rows of text, top row first.

    Raises:
        ValueError: There is no cell, the rows differ in length, or a character is not one of `chars`.
    """
    if not rows or not rows[0] or len({len(row) for row in rows}) > 1:
        lengths = brief([len(row) for row in rows])
        raise ValueError(f"rows of cells: got lengths {lengths} of {brief(list(rows))}, expected equal and above 0")
    if unknown := sorted(set("".join(rows)) - set(chars)):
        raise ValueError(f"cells {brief(''.join(unknown))}: the allowed characters are {chars!r}")
    return np.array([[chars.index(char) for char in row] for row in rows], dtype=np.int8)


def as_numbers(values: ArrayLike) -> NDArray[np.float64]:
    """Returns a new array of numbers, also of rows that are arrays in an array of objects, as data frames hold them.

    Raises:
        TypeError, ValueError: They are no numbers, or rows of different length.
    """
    rows = list(values) if isinstance(values, np.ndarray) and values.dtype == object and values.ndim else values
    return np.array(rows, dtype=np.float64)


def check_grid(grid: ArrayLike, n_codes: int) -> Grid:
    """Returns a new int8 array of the cell codes given, which may be floats of integer value.

    Raises:
        ValueError: The grid is not 2-D, has no cell, or holds something else than 0 ... n_codes - 1.
    """
    try:
        cells = as_numbers(grid)
    except (TypeError, ValueError) as error:
        raise ValueError(f"grid: expected equally long rows of numbers, got {brief(grid)}") from error
    if cells.ndim != 2 or cells.size == 0:
        raise ValueError(f"grid: got shape {cells.shape}, expected (rows, cols), both at least 1")
    if unknown := sorted(set(cells.ravel().tolist()) - set(range(n_codes))):
        raise ValueError(f"grid: got cell codes {some(unknown)}, allowed are 0 to {n_codes - 1}")
    return cells.astype(np.int8)
