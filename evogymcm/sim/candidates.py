"""Which voxels could touch: lists that hold for a while, so that the exact rule has little to look at.

`list_candidates` makes, for each lane, a list of (main voxel, corner, ref voxel) whose corner lies within SKIN of the
ref voxel's bounding box. It holds until a point has moved by half of SKIN. A list is always in the same order and holds
more than what touches, never less: so neither the other lanes nor the moment of listing can be seen in a result.

The order (object by object, ref voxels outside, corners inside) is part of the benchmark: forces are summed in it, and
where a robot starts corner on corner with the terrain, the rounding of the sums decides what touches next.
"""

import numpy as np

from evogymcm.sim import lanes
from evogymcm.sim._jit import inlined, kernel
from evogymcm.sim.constants import MISSING, VOXEL
from evogymcm.sim.scene import Layout
from evogymcm.sim.springs import LISTED_X, LISTED_Y, X, Y
from evogymcm.sim.topology import BL, BR, TL, TR

SKIN = 0.02  # metres
LOW_X, LOW_Y, HIGH_X, HIGH_Y = range(4)  # rows of `boxes`
_ROUNDING = 1e-6  # of a voxel: fixed corners stand on the grid up to rounding
_CORNER_AT = ((TR, TL), (BR, BL))  # which corner of a cell a lattice point is: by rows up, columns right to the cell


@kernel
def lists_hold(points: np.ndarray, active: int) -> bool:
    """Returns whether no point of an active lane has moved too far since the lists were made (False for NaN)."""
    for p in range(points.shape[1]):
        dx = lanes.absolute(lanes.load(points, X, p) - lanes.load(points, LISTED_X, p))
        dy = lanes.absolute(lanes.load(points, Y, p) - lanes.load(points, LISTED_Y, p))
        if lanes.less_equal(dx, 0.5 * SKIN) & lanes.less_equal(dy, 0.5 * SKIN) & active != active:
            return False
    return True


@kernel
def bound(corners: np.ndarray, points: np.ndarray, boxes: np.ndarray) -> None:
    """Sets the bounding boxes of the moving surface voxels."""
    for c in range(boxes.shape[1]):
        low_x = high_x = lanes.load(points, X, corners[c, 0])
        low_y = high_y = lanes.load(points, Y, corners[c, 0])
        for k in range(1, 4):
            px, py = lanes.load(points, X, corners[c, k]), lanes.load(points, Y, corners[c, k])
            low_x, high_x = lanes.minimum(low_x, px), lanes.maximum(high_x, px)
            low_y, high_y = lanes.minimum(low_y, py), lanes.maximum(high_y, py)
        lanes.store(boxes, LOW_X, c, low_x)
        lanes.store(boxes, LOW_Y, c, low_y)
        lanes.store(boxes, HIGH_X, c, high_x)
        lanes.store(boxes, HIGH_Y, c, high_y)


@inlined
def overlap(boxes: np.ndarray, a: int, b: int, margin: float) -> int:
    """Returns the mask of lanes where the boxes of two voxels are no more than `margin` apart."""
    return (
        lanes.less_equal(lanes.load(boxes, LOW_X, a) - margin, lanes.load(boxes, HIGH_X, b))
        & lanes.less_equal(lanes.load(boxes, LOW_X, b) - margin, lanes.load(boxes, HIGH_X, a))
        & lanes.less_equal(lanes.load(boxes, LOW_Y, a) - margin, lanes.load(boxes, HIGH_Y, b))
        & lanes.less_equal(lanes.load(boxes, LOW_Y, b) - margin, lanes.load(boxes, HIGH_Y, a))
    )


@inlined
def _is_near(px, py, low_x, low_y, high_x, high_y) -> int:  # type: ignore[no-untyped-def]
    """Returns the mask of lanes where p is within SKIN of a box."""
    return (
        lanes.less_equal(low_x - SKIN, px)
        & lanes.less_equal(px, high_x + SKIN)
        & lanes.less_equal(low_y - SKIN, py)
        & lanes.less_equal(py, high_y + SKIN)
    )


@inlined
def _within(points: np.ndarray, boxes: np.ndarray, p: int, c: int) -> int:
    """Returns the mask of lanes where point `p` is within SKIN of voxel `c`'s box."""
    low_x, low_y = lanes.load(boxes, LOW_X, c), lanes.load(boxes, LOW_Y, c)
    high_x, high_y = lanes.load(boxes, HIGH_X, c), lanes.load(boxes, HIGH_Y, c)
    px, py = lanes.load(points, X, p), lanes.load(points, Y, p)
    return _is_near(px, py, low_x, low_y, high_x, high_y)


@inlined
def _append(
    corners: np.ndarray,
    uses_start: np.ndarray,
    uses: np.ndarray,
    p: int,
    c: int,
    n_mains: int,
    mask: int,
    pairs: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Adds the surface voxels below `n_mains` that have corner `p` against voxel `c`, in the lanes of the mask.

    A voxel's own corners never enter it. A list that is too short shows as a count beyond its length.
    """
    if p == corners[c, TL] or p == corners[c, TR] or p == corners[c, BL] or p == corners[c, BR]:
        return
    for lane in range(lanes.N_LANES):
        if mask >> lane & 1:
            n = counts[lane]
            for u in range(uses_start[p], uses_start[p + 1]):
                if uses[u, 0] >= n_mains:
                    break
                if n < pairs.shape[1]:
                    pairs[lane, n, 0] = uses[u, 0]
                    pairs[lane, n, 1] = uses[u, 1]
                    pairs[lane, n, 2] = c
                n += 1
            counts[lane] = n


@kernel
def _list_anchored(
    layout: Layout, i: int, points: np.ndarray, boxes: np.ndarray, active: int, pairs: np.ndarray, counts: np.ndarray
) -> None:
    """Lists what touches in anchored object `i`, and between it and all fixed voxels.

    It stays near its place: only pairs count that were as near at reset as its points have moved since.
    """
    corners, near, near_gap, initial = layout.corners, layout.near, layout.near_gap, layout.initial
    farthest = lanes.spread(0.0)
    for p in range(layout.objects[i, 0], layout.objects[i, 1]):
        dx = lanes.absolute(lanes.load(points, X, p) - initial[p, 0])
        dy = lanes.absolute(lanes.load(points, Y, p) - initial[p, 1])
        farthest = lanes.maximum(farthest, lanes.maximum(dx, dy))
    n_points = points.shape[1]
    for n in range(layout.near_start[i], layout.near_start[i + 1]):
        if not lanes.less_equal(near_gap[n] - SKIN, 2.0 * farthest) & active:
            break
        p, c = near[n, 0], near[n, 1]
        if p < n_points:
            px, py = lanes.load(points, X, p), lanes.load(points, Y, p)
        else:
            q = p - n_points
            px, py = lanes.spread(layout.static_points[q, 0]), lanes.spread(layout.static_points[q, 1])
        if c < boxes.shape[1]:
            low_x, low_y = lanes.load(boxes, LOW_X, c), lanes.load(boxes, LOW_Y, c)
            high_x, high_y = lanes.load(boxes, HIGH_X, c), lanes.load(boxes, HIGH_Y, c)
        else:  # a fixed voxel: a square
            x, y = _corner(initial, layout.static_points, corners[c, BL])
            low_x, low_y = lanes.spread(x), lanes.spread(y)
            x, y = _corner(initial, layout.static_points, corners[c, TR])
            high_x, high_y = lanes.spread(x), lanes.spread(y)
        mask = _is_near(px, py, low_x, low_y, high_x, high_y) & active
        if mask:
            # A fixed voxel against a fixed one has no effect.
            n_mains = corners.shape[0] if c < boxes.shape[1] else boxes.shape[1]
            _append(corners, layout.uses_start, layout.uses, p, c, n_mains, mask, pairs, counts)


@inlined
def _corner(initial: np.ndarray, static_points: np.ndarray, p: int) -> tuple[float, float]:
    """Returns where a fixed point is."""
    n = initial.shape[0]
    if p < n:
        return initial[p, 0], initial[p, 1]
    return static_points[p - n, 0], static_points[p - n, 1]


@kernel
def _list_own(
    layout: Layout, i: int, points: np.ndarray, boxes: np.ndarray, active: int, pairs: np.ndarray, counts: np.ndarray
) -> None:
    """Lists the corners of object `i`, which moves freely, near its own voxels."""
    corners, uses_start, uses, objects = layout.corners, layout.uses_start, layout.uses, layout.objects
    for c in range(objects[i, 2], objects[i, 3]):
        for p in range(objects[i, 0], objects[i, 1]):
            if uses_start[p] == uses_start[p + 1]:
                continue  # not on the surface
            mask = _within(points, boxes, p, c) & active
            if mask:
                _append(corners, uses_start, uses, p, c, boxes.shape[1], mask, pairs, counts)


@kernel
def _list_between(
    layout: Layout,
    i: int,
    j: int,
    points: np.ndarray,
    boxes: np.ndarray,
    active: int,
    nearby: np.ndarray,
    pairs: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Lists the corners of object `i` near the moving voxels of object `j`; `nearby` is scratch for points."""
    corners, uses_start, uses, objects = layout.corners, layout.uses_start, layout.uses, layout.objects
    low_x, low_y, high_x, high_y = _bound_points(points, objects[j, 0], objects[j, 1])
    n = 0
    for p in range(objects[i, 0], objects[i, 1]):
        px, py = lanes.load(points, X, p), lanes.load(points, Y, p)
        mask = _is_near(px, py, low_x, low_y, high_x, high_y) & active
        if mask:
            nearby[n] = p
            n += 1
    if n == 0:
        return
    low_x, low_y, high_x, high_y = _bound_points(points, objects[i, 0], objects[i, 1])
    for c in range(objects[j, 2], objects[j, 3]):
        meets = (
            lanes.less_equal(lanes.load(boxes, LOW_X, c) - SKIN, high_x)
            & lanes.less_equal(low_x, lanes.load(boxes, HIGH_X, c) + SKIN)
            & lanes.less_equal(lanes.load(boxes, LOW_Y, c) - SKIN, high_y)
            & lanes.less_equal(low_y, lanes.load(boxes, HIGH_Y, c) + SKIN)
            & active
        )
        if meets:
            for m in range(n):
                mask = _within(points, boxes, nearby[m], c) & meets
                if mask:
                    _append(corners, uses_start, uses, nearby[m], c, boxes.shape[1], mask, pairs, counts)


@inlined
def _bound_points(points: np.ndarray, first: int, end: int):  # type: ignore[no-untyped-def]
    """Returns the bounding box of the points from `first` to `end`."""
    low_x = high_x = lanes.load(points, X, first)
    low_y = high_y = lanes.load(points, Y, first)
    for p in range(first + 1, end):
        px, py = lanes.load(points, X, p), lanes.load(points, Y, p)
        low_x, high_x = lanes.minimum(low_x, px), lanes.maximum(high_x, px)
        low_y, high_y = lanes.minimum(low_y, py), lanes.maximum(high_y, py)
    return low_x, low_y, high_x, high_y


@inlined
def _range(first: float, last: float, n: int) -> tuple[int, int]:
    """Returns the whole numbers from `first` to `last` that are in 0 ... n - 1, as a start and an end."""
    if not (first < n and last >= 0.0):
        return 0, 0
    return int(max(first, 0.0)), int(min(last, n - 1.0)) + 1


@inlined
def _cells(low: float, high: float, n_cells: int) -> tuple[int, int]:
    """Returns the first and end world cells that the interval, SKIN wider, touches (none for NaN)."""
    return _range(np.floor((low - SKIN) / VOXEL - _ROUNDING), np.floor((high + SKIN) / VOXEL + _ROUNDING), n_cells)


@inlined
def _lines(low: float, high: float, n_cells: int) -> tuple[int, int]:
    """Returns the first and end lines of the grid of world cells in the interval, SKIN wider (none for NaN)."""
    first, last = np.ceil((low - SKIN) / VOXEL - _ROUNDING), np.floor((high + SKIN) / VOXEL + _ROUNDING)
    return _range(first, last, n_cells + 1)


@kernel
def _list_near_fixed(
    layout: Layout, i: int, points: np.ndarray, active: int, pairs: np.ndarray, counts: np.ndarray
) -> None:
    """Lists the corners of object `i` near fixed voxels, which stand on the grid of world cells."""
    n_cells = layout.grid_cells.shape[0]
    corners, uses_start, uses, cell_at = layout.corners, layout.uses_start, layout.uses, layout.cell_at
    height, width = cell_at.shape
    for p in range(layout.objects[i, 0], layout.objects[i, 1]):
        if uses_start[p] == uses_start[p + 1]:
            continue  # not on the surface
        for lane in range(lanes.N_LANES):
            if not active >> lane & 1:
                continue
            px, py = points[X, p, lane], points[Y, p, lane]
            first_row, end_row = _cells(py, py, height)
            first_column, end_column = _cells(px, px, width)
            for row in range(first_row, end_row):
                for column in range(first_column, end_column):
                    c = cell_at[row, column]
                    if c != MISSING:
                        _append(corners, uses_start, uses, p, c, n_cells, 1 << lane, pairs, counts)


@kernel
def _list_fixed_near(
    layout: Layout, i: int, boxes: np.ndarray, active: int, pairs: np.ndarray, counts: np.ndarray
) -> None:
    """Lists the corners of fixed voxels near those of object `i`: grid crossings in a box, and the cells round them."""
    cell_at = layout.cell_at
    height, width = cell_at.shape
    for b in range(layout.objects[i, 2], layout.objects[i, 3]):
        for lane in range(lanes.N_LANES):
            if not active >> lane & 1:
                continue
            first_row, end_row = _lines(boxes[LOW_Y, b, lane], boxes[HIGH_Y, b, lane], height)
            first_column, end_column = _lines(boxes[LOW_X, b, lane], boxes[HIGH_X, b, lane], width)
            for row in range(first_row, end_row):
                for column in range(first_column, end_column):
                    for up in range(max(row - 1, 0), min(row + 1, height)):
                        for right in range(max(column - 1, 0), min(column + 1, width)):
                            a = cell_at[up, right]
                            if a == MISSING:
                                continue
                            n = counts[lane]
                            if n < pairs.shape[1]:
                                pairs[lane, n, 0] = a
                                pairs[lane, n, 1] = _CORNER_AT[up - row + 1][right - column + 1]
                                pairs[lane, n, 2] = b
                            counts[lane] = n + 1


@kernel
def _list_crowded(n_cells: int, cells: np.ndarray, boxes: np.ndarray, active: int, crowded: np.ndarray) -> int:
    """Lists the pairs of the robot's surface voxels, more than a cell apart in the grid, that are near each other."""
    n = 0
    for a in range(n_cells):
        for b in range(a):
            apart = max(abs(cells[a, 0] - cells[b, 0]), abs(cells[a, 1] - cells[b, 1]))
            if apart > 1 and overlap(boxes, a, b, SKIN) & active:
                crowded[n, 0] = a
                crowded[n, 1] = b
                n += 1
    return n


@kernel
def list_candidates(
    layout: Layout,
    points: np.ndarray,
    boxes: np.ndarray,
    active: int,
    nearby: np.ndarray,
    pairs: np.ndarray,
    counts: np.ndarray,
    crowded: np.ndarray,
) -> int:
    """Makes the lists anew, and returns the number of crowded voxel pairs.

    Args:
        layout: The scene.
        points: (N_POINT_ROWS, P, 8) state.
        boxes: (4, C, 8) scratch for bounding boxes.
        active: Mask of the lanes to list.
        nearby: (P,) scratch for points.
        pairs: (8, capacity, 3) receives (main voxel, corner, ref voxel).
        counts: (8,) receives the lengths of the lists; beyond the capacity where a list did not fit.
        crowded: (n, 2) receives the pairs of voxels that the stability count has to look at.
    """
    for lane in range(lanes.N_LANES):
        counts[lane] = 0
    bound(layout.corners, points, boxes)
    n_objects = layout.objects.shape[0]
    for i in range(n_objects):
        if layout.objects[i, 0] == layout.objects[i, 1]:
            continue  # all of it is fixed
        if layout.is_anchored[i]:
            _list_anchored(layout, i, points, boxes, active, pairs, counts)
        else:
            _list_own(layout, i, points, boxes, active, pairs, counts)
            _list_near_fixed(layout, i, points, active, pairs, counts)
            _list_fixed_near(layout, i, boxes, active, pairs, counts)
        for j in range(n_objects):
            if i != j and layout.objects[j, 0] != layout.objects[j, 1]:
                _list_between(layout, i, j, points, boxes, active, nearby, pairs, counts)
    for p in range(points.shape[1]):
        lanes.store(points, LISTED_X, p, lanes.load(points, X, p))
        lanes.store(points, LISTED_Y, p, lanes.load(points, Y, p))
    return _list_crowded(layout.objects[0, 3], layout.grid_cells, boxes, active, crowded)


@kernel
def collapsed(
    corners: np.ndarray, n_cells: int, points: np.ndarray, boxes: np.ndarray, crowded: np.ndarray, n_crowded: int
) -> int:
    """Returns the mask of lanes whose robot, of `n_cells` surface voxels, overlaps itself in more ordered pairs."""
    if n_crowded == 0:
        return 0
    bound(corners, points, boxes)
    count = lanes.spread(0.0)
    for n in range(n_crowded):
        mask = overlap(boxes, crowded[n, 0], crowded[n, 1], 0.0)
        if mask:
            count = count + lanes.select(mask, 2.0, 0.0)
    return lanes.less(float(n_cells), count)
