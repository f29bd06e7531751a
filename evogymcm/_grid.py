"""Grids of cells, shared by bodies and worlds: codes, text form, validation, adjacency."""

from collections.abc import Sequence
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evogymcm._messages import brief, some

EMPTY, RIGID, SOFT, H_ACT, V_ACT, FIXED = range(6)
CELL_CHARS = ".RSHVF"  # the character of a cell code is CELL_CHARS[code]
BODY_CHARS = CELL_CHARS[:FIXED]  # fixed cells are for terrain

_BITS = bytes.maketrans(b"\0\1", b"01")  # the bytes of booleans to digits

Grid: TypeAlias = NDArray[np.int8]
Connections: TypeAlias = NDArray[np.int64]


def is_connected(grid: ArrayLike) -> bool:
    """Returns whether the occupied cells form one piece under side adjacency; the empty grid does not."""
    occupied = np.asarray(grid) != EMPTY
    rows, columns = occupied.shape
    if not occupied.any():
        return False
    # The cells are bits of one number, the first one the highest: faster than arrays of so few numbers.
    left_over, has_left = int(occupied.tobytes().translate(_BITS), 2), _has_left(rows, columns)
    reached, grown = 0, left_over & -left_over
    while grown != reached:
        reached = grown
        beside = (reached & has_left) << 1 | reached >> 1 & has_left | reached << columns | reached >> columns
        grown |= beside & left_over
    return reached == left_over


@lru_cache(maxsize=64)
def _has_left(rows: int, columns: int) -> int:
    """Returns as bits the cells of a grid that have another one on their left."""
    return int(("0" + "1" * (columns - 1)) * rows, 2)


def has_actuator(grid: ArrayLike) -> bool:
    """Returns whether some cell is a horizontal or vertical actuator."""
    cells = np.asarray(grid)
    return bool(((cells == H_ACT) | (cells == V_ACT)).any())


@lru_cache(maxsize=64)
def _adjacent(rows: int, columns: int) -> Connections:
    """Returns all pairs of side-adjacent cells of a grid, (2, k), in the order of `full_connections`."""
    first = np.repeat(np.arange(rows * columns), 2).reshape(rows, columns, 2)
    second = first + np.array([1, columns])
    is_cell = np.ones(first.shape, bool)
    is_cell[:, -1:, 0] = is_cell[-1:, :, 1] = False
    return np.stack([first[is_cell], second[is_cell]]).astype(np.int64)


def full_connections(grid: ArrayLike) -> Connections:
    """Returns all pairs of side-adjacent occupied cells as flat indices of shape (2, k).

    Cells come in row-major order, each with its right neighbour first and its lower one second.
    """
    occupied = np.asarray(grid) != EMPTY
    pairs = _adjacent(*occupied.shape)
    return pairs.compress(occupied.ravel()[pairs].all(axis=0), axis=1)


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
    full = full_connections(cells)
    if np.array_equal(pairs, full):
        return full
    allowed = {(a, b) for a, b in full.T.tolist()}
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
        TypeError, ValueError: They are no numbers, numbers out of all range, or rows of different length.
    """
    rows = list(values) if isinstance(values, np.ndarray) and values.dtype == object and values.ndim else values
    try:
        return np.array(rows, dtype=np.float64)
    except OverflowError as error:
        raise ValueError(str(error)) from error


def check_grid(grid: ArrayLike, n_codes: int) -> Grid:
    """Returns a new int8 array of the cell codes given, which may be floats of integer value.

    Raises:
        ValueError: The grid is not 2-D, has no cell, or holds something else than 0 ... n_codes - 1.
    """
    if isinstance(grid, np.ndarray) and grid.dtype == np.int8 and grid.ndim == 2 and grid.size:
        codes = grid.tobytes()  # negative ones are bytes above 127
        if max(codes) < n_codes:
            return grid.copy()
    try:
        cells = as_numbers(grid)
    except (TypeError, ValueError) as error:
        raise ValueError(f"grid: expected equally long rows of numbers, got {brief(grid)}") from error
    if cells.ndim != 2 or cells.size == 0:
        raise ValueError(f"grid: got shape {cells.shape}, expected (rows, cols), both at least 1")
    if unknown := sorted(set(cells.ravel().tolist()) - set(range(n_codes))):
        raise ValueError(f"grid: got cell codes {some(unknown)}, allowed are 0 to {n_codes - 1}")
    return cells.astype(np.int8)
