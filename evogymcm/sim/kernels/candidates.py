"""Which voxels could touch: lists that hold for a while, so that the exact rule has little to look at.

`list_candidates` lists each (corner, voxel) whose corner lies within SKIN of the voxel's bounding box. The list holds
until a point has moved by half of SKIN, and holds more than what touches, never less; contacts are applied in an order
of their own (`contact.py`), so that the moment of listing cannot be seen in a result.
"""

import numpy as np

from evogymcm.sim.constants import MISSING, VOXEL
from evogymcm.sim.kernels._jit import inlined, inner
from evogymcm.sim.kernels.vectors import absolute, alternating, less_equal, load, spread
from evogymcm.sim.tables import (
    END_CELL,
    END_POINT,
    FIRST_CELL,
    FIRST_POINT,
    N_OBJECT_COLUMNS,
    Surface,
    Terrain,
)
from evogymcm.sim.topology import BL, BR, TL, TR

SKIN = 0.02  # metres
N_FOUND = 6  # numbers of a candidate, see `list_candidates`
LOW_X, LOW_Y, HIGH_X, HIGH_Y = range(4)  # rows of `boxes`
_ROUNDING = 1e-6  # of a voxel: fixed corners stand on the grid up to rounding
_PER_METRE = 1.0 / VOXEL  # voxels
_CORNER_AT = ((TR, TL), (BR, BL))  # which corner of a cell a lattice point is: by rows up, columns right to the cell
_X_BITS = 0b01010101  # of a mask of four pairs


@inlined
def lists_hold(xy: np.ndarray, listed: np.ndarray) -> bool:
    """Returns whether no point has moved too far since the lists were made at `listed` (False for NaN)."""
    still = 255
    for i in range(0, xy.shape[0], 8):
        still &= less_equal(absolute(load(xy, i) - load(listed, i)), 0.5 * SKIN)
    return still == 255


@inner
def bound(corners: np.ndarray, xy: np.ndarray, boxes: np.ndarray) -> None:
    """Sets the (4, C or more) bounding boxes of the moving surface voxels."""
    for c in range(corners.shape[0] // 4):
        p = corners[4 * c]
        low_x = high_x = xy[p]
        low_y = high_y = xy[p + 1]
        for k in range(1, 4):
            p = corners[4 * c + k]
            x, y = xy[p], xy[p + 1]
            low_x, high_x = x if x < low_x else low_x, x if x > high_x else high_x
            low_y, high_y = y if y < low_y else low_y, y if y > high_y else high_y
        boxes[LOW_X, c] = low_x
        boxes[LOW_Y, c] = low_y
        boxes[HIGH_X, c] = high_x
        boxes[HIGH_Y, c] = high_y


@inlined
def position(xy: np.ndarray, static: np.ndarray, place: int) -> tuple[float, float]:
    """Returns where a moving or fixed point is."""
    if place >= 0:
        return xy[place], xy[place + 1]
    return static[~place], static[~place + 1]


@inlined
def _append(layout: Surface, terrain: Terrain, place: int, c: int, found: np.ndarray, n: int) -> int:
    """Adds a point against a voxel to the list, unless it is the voxel's own, and returns the new length.

    A list that is too short shows as a length beyond it.
    """
    corners, first = (layout.corners, 4 * c) if c >= 0 else (terrain.corners, 4 * ~c)
    for k in range(4):
        if corners[first + k] == place:
            return n
    if n < found.shape[0]:
        found[n, 0], found[n, 1] = place, c
        for k in range(4):
            found[n, 2 + k] = corners[first + k]
    return n + 1


@inner
def _list_points(
    layout: Surface,
    terrain: Terrain,
    xy: np.ndarray,
    box: tuple[float, float, float, float],
    first: int,
    end: int,
    c: int,
    found: np.ndarray,
    n: int,
) -> int:
    """Lists the surface points between two places within SKIN of the box of voxel `c`."""
    low = alternating(box[0] - SKIN, box[1] - SKIN)
    high = alternating(box[2] + SKIN, box[3] + SKIN)
    for i in range(first, end, 8):
        numbers = load(xy, i)
        inside = less_equal(low, numbers) & less_equal(numbers, high)
        inside &= inside >> 1 & _X_BITS
        if inside:
            for k in range(0, 8, 2):
                p = (i + k) >> 1
                if inside >> k & 1 and layout.uses_start[p] != layout.uses_start[p + 1]:
                    n = _append(layout, terrain, np.int64(i + k), np.int64(c), found, n)
    return n


@inlined
def _box(boxes: np.ndarray, c: int) -> tuple[float, float, float, float]:
    return boxes[LOW_X, c], boxes[LOW_Y, c], boxes[HIGH_X, c], boxes[HIGH_Y, c]


@inlined
def _near(one: tuple, two: tuple, margin: float) -> bool:
    """Returns whether two boxes are no more than `margin` apart."""
    return (
        one[0] - margin <= two[2]
        and two[0] - margin <= one[2]
        and one[1] - margin <= two[3]
        and two[1] - margin <= one[3]
    )


@inner
def _object_box(layout: Surface, xy: np.ndarray, first: int, end: int) -> tuple[float, float, float, float]:
    """Returns the box around the surface points between two places: some are corners of fixed voxels alone."""
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for i in range(first, end, 2):
        if layout.uses_start[i >> 1] != layout.uses_start[(i >> 1) + 1]:
            low_x, low_y = min(low_x, xy[i]), min(low_y, xy[i + 1])
            high_x, high_y = max(high_x, xy[i]), max(high_y, xy[i + 1])
    return low_x, low_y, high_x, high_y


@inlined
def _range(first: float, last: float, n: int) -> tuple[int, int]:
    """Returns the start and end of the whole numbers from `first` to `last` in 0 ... n - 1 (none for NaN)."""
    if not (first < n and last >= 0.0):
        return 0, 0
    return int(max(first, 0.0)), int(min(last, n - 1.0)) + 1


@inlined
def _cells(low: float, high: float, n_cells: int) -> tuple[int, int]:
    """Returns the first and end world cells that the interval, SKIN wider, touches."""
    first, last = np.floor((low - SKIN) * _PER_METRE - _ROUNDING), np.floor((high + SKIN) * _PER_METRE + _ROUNDING)
    return _range(first, last, n_cells)


@inlined
def _lines(low: float, high: float, n_cells: int) -> tuple[int, int]:
    """Returns the first and end lines of the grid of world cells in the interval, SKIN wider."""
    first, last = np.ceil((low - SKIN) * _PER_METRE - _ROUNDING), np.floor((high + SKIN) * _PER_METRE + _ROUNDING)
    return _range(first, last, n_cells + 1)


@inner
def _list_near_fixed(
    layout: Surface, terrain: Terrain, first: int, end: int, xy: np.ndarray, found: np.ndarray, n: int
) -> int:
    """Lists the surface points between two places near fixed voxels, which stand on the grid of world cells."""
    height, width = terrain.extent[0], terrain.extent[1]
    for i in range(first, end, 2):
        if layout.uses_start[i >> 1] == layout.uses_start[(i >> 1) + 1]:
            continue  # not on the surface
        first_row, end_row = _cells(xy[i + 1], xy[i + 1], height)
        if first_row == end_row:
            continue
        first_column, end_column = _cells(xy[i], xy[i], width)
        for row in range(first_row, end_row):
            for column in range(first_column, end_column):
                d = terrain.cell_at[row * width + column]
                if d != MISSING:
                    n = _append(layout, terrain, np.int64(i), np.int64(~d), found, n)
    return n


@inner
def _list_fixed_near(
    layout: Surface, terrain: Terrain, first: int, end: int, boxes: np.ndarray, found: np.ndarray, n: int
) -> int:
    """Lists the fixed points near some moving voxels: grid crossings in a box, and the cells round them."""
    height, width = terrain.extent[0], terrain.extent[1]
    for c in range(first, end):
        first_row, end_row = _lines(boxes[LOW_Y, c], boxes[HIGH_Y, c], height)
        if first_row == end_row:
            continue
        first_column, end_column = _lines(boxes[LOW_X, c], boxes[HIGH_X, c], width)
        for row in range(first_row, end_row):
            for column in range(first_column, end_column):
                start = n
                for up in range(max(row - 1, 0), min(row + 1, height)):
                    for right in range(max(column - 1, 0), min(column + 1, width)):
                        d = terrain.cell_at[up * width + right]
                        if d == MISSING:
                            continue
                        place = terrain.corners[4 * d + _CORNER_AT[up - row + 1][right - column + 1]]
                        if place >= 0:
                            continue  # its object lists it
                        is_new = True
                        for m in range(start, min(n, found.shape[0])):
                            is_new &= found[m, 0] != place
                        if is_new:
                            n = _append(layout, terrain, np.int64(place), np.int64(c), found, n)
    return n


@inner
def _list_crowded(layout: Surface, boxes: np.ndarray, crowded: np.ndarray) -> int:
    """Lists the pairs of the robot's voxels, more than a cell apart in the grid, that are near each other."""
    n, first, end = 0, layout.objects[FIRST_CELL], layout.objects[END_CELL]
    row = 0
    for a in range(first, end):
        low_x, low_y = spread(boxes[LOW_X, a] - SKIN), spread(boxes[LOW_Y, a] - SKIN)
        high_x, high_y = spread(boxes[HIGH_X, a] + SKIN), spread(boxes[HIGH_Y, a] + SKIN)
        for eight in range(first, a, 8):
            meets = less_equal(low_x, load(boxes[HIGH_X], eight)) & less_equal(load(boxes[LOW_X], eight), high_x)
            meets &= less_equal(low_y, load(boxes[HIGH_Y], eight)) & less_equal(load(boxes[LOW_Y], eight), high_y)
            meets &= layout.apart[row]
            row += 1
            if meets:
                for k in range(8):
                    if meets >> k & 1:
                        crowded[n, 0] = a
                        crowded[n, 1] = eight + k
                        n += 1
    return n


@inner
def list_candidates(
    layout: Surface, terrain: Terrain, xy: np.ndarray, boxes: np.ndarray, found: np.ndarray, crowded: np.ndarray
) -> tuple[int, int]:
    """Makes the lists anew.

    Args:
        layout: The scene's tables.
        terrain: Its fixed voxels.
        xy: Positions.
        boxes: (4, C + 8 at least) scratch for bounding boxes.
        found: (capacity, N_FOUND) receives rows of the place of a point, a voxel, and the places of its corners.
        crowded: (n, 2) receives the pairs of robot voxels that the stability count has to look at.

    Returns:
        The lengths of both lists; the first is beyond the capacity where it did not fit.
    """
    bound(layout.corners, xy, boxes)
    n = int(np.int64(0))  # a constant would be compiled for apart
    objects = layout.objects
    n_objects = objects.shape[0] // N_OBJECT_COLUMNS
    for k in range(n_objects):
        own = N_OBJECT_COLUMNS * k
        first, end = objects[own + FIRST_POINT], objects[own + END_POINT]
        if first == end:
            continue  # all of it is fixed
        first_cell, end_cell = objects[own + FIRST_CELL], objects[own + END_CELL]
        for c in range(first_cell, end_cell):
            n = _list_points(layout, terrain, xy, _box(boxes, c), first, end, c, found, n)
        if terrain.corners.shape[0]:
            n = _list_near_fixed(layout, terrain, first, end, xy, found, n)
            n = _list_fixed_near(layout, terrain, first_cell, end_cell, boxes, found, n)
        if n_objects == 1:
            continue
        around = _object_box(layout, xy, first, end)
        for j in range(n_objects):
            other = N_OBJECT_COLUMNS * j
            if j == k or objects[other + FIRST_POINT] == objects[other + END_POINT]:
                continue
            for c in range(objects[other + FIRST_CELL], objects[other + END_CELL]):
                box = _box(boxes, c)
                if _near(around, box, SKIN):
                    n = _list_points(layout, terrain, xy, box, first, end, c, found, n)
    return n, _list_crowded(layout, boxes, crowded)


@inlined
def collapsed(corners: np.ndarray, n_cells: int, xy: np.ndarray, crowded: np.ndarray, n_crowded: int) -> bool:
    """Returns whether a robot overlaps itself in more ordered pairs of voxels than it has surface voxels, `n_cells`.

    Args:
        corners: Of all moving surface voxels.
        n_cells: Their number.
        xy: Positions.
        crowded: Pairs to look at.
        n_crowded: Their number.
    """
    count = 0
    for n in range(n_crowded):
        if _near(_box_now(corners, xy, crowded[n, 0]), _box_now(corners, xy, crowded[n, 1]), 0.0):
            count += 2
    return count > n_cells


@inlined
def _box_now(corners: np.ndarray, xy: np.ndarray, c: int) -> tuple[float, float, float, float]:
    """Returns a moving voxel's box."""
    p = corners[4 * c]
    low_x = high_x = xy[p]
    low_y = high_y = xy[p + 1]
    for k in range(1, 4):
        p = corners[4 * c + k]
        low_x, high_x = min(low_x, xy[p]), max(high_x, xy[p])
        low_y, high_y = min(low_y, xy[p + 1]), max(high_y, xy[p + 1])
    return low_x, low_y, high_x, high_y
