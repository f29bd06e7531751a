"""What can be read off the worlds: centres, velocities, orientations, outlines, and the terrain around a robot.

Kernels read a block's lanes and write rows of arrays indexed by world. Sums run in the order of the points.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from evogymcm.sim import lanes
from evogymcm.sim._jit import inlined, kernel
from evogymcm.sim.constants import MISSING, VOXEL
from evogymcm.sim.springs import VX, VY, X, Y

_TWO_PI = 2.0 * 3.1415926  # EvoGym's value, seven digits of pi
_ALMOST_ONE = 0.99999  # what a cosine beyond 1 counts as
WINDOW_REACH = 5.0  # voxels: as far as an elevation window sees
COM, VELOCITY, LOW, HIGH, ORIENTATION, HULL_AREA = 0, 2, 4, 6, 8, 9  # first columns of `Readings.numbers`
N_SUMS = 9  # numbers of `read_object` that are formed for all lanes at once, the first columns
N_NUMBERS = 10
# Best polynomial (Chebyshev) for (arcsin(t) / t - 1) / t^2 in t^2, on [0, 1/4]; highest power first, off by 1.5e-17.
_ARCSIN = (
    0.028757851367421566,
    -0.014851887071247204,
    0.01740087944269402,
    0.005457506718640358,
    0.01032281435018578,
    0.011479177415184906,
    0.013971212973552933,
    0.017352392720869973,
    0.02237217294214989,
    0.030381944138531247,
    0.04464285714635543,
    0.07499999999998433,
    0.16666666666666669,
)


class Readings(NamedTuple):
    """Readings of one object in N worlds; n points at most."""

    numbers: np.ndarray  # (N, N_NUMBERS) what the properties below are views of
    relative: np.ndarray  # (N, 2, n) points minus COM; 0 beyond an object's own points

    @property
    def com(self) -> np.ndarray:
        """(N, 2) mean of the points, metres."""
        return self.numbers[:, COM : COM + 2]

    @property
    def velocity(self) -> np.ndarray:
        """(N, 2) mean of the integrated velocities."""
        return self.numbers[:, VELOCITY : VELOCITY + 2]

    @property
    def low(self) -> np.ndarray:
        """(N, 2) smallest coordinates."""
        return self.numbers[:, LOW : LOW + 2]

    @property
    def high(self) -> np.ndarray:
        """(N, 2) largest coordinates."""
        return self.numbers[:, HIGH : HIGH + 2]

    @property
    def orientation(self) -> np.ndarray:
        """(N,) radians in [0, 2 pi), counter-clockwise from reset."""
        return self.numbers[:, ORIENTATION]

    @property
    def hull_area(self) -> np.ndarray:
        """(N,) square metres."""
        return self.numbers[:, HULL_AREA]


def new_readings(n_worlds: int, n_points: int) -> Readings:
    """Returns readings of zeros."""
    return Readings(np.zeros((n_worlds, N_NUMBERS)), np.zeros((n_worlds, 2, n_points)))


@kernel
def read_object(
    points: np.ndarray,
    worlds: np.ndarray,
    rows: np.ndarray,
    initial: np.ndarray,
    with_hull: bool,
    hull: np.ndarray,
    sums: np.ndarray,
    numbers: np.ndarray,
    relative: np.ndarray,
) -> None:
    """Reads an object of n points, in their order, in the lanes that have a world.

    It takes arrays, and no tuple of them: numba spent more on taking the tuple apart than on all readings.

    Args:
        points: (N_POINT_ROWS, P, 8) state.
        worlds: (8,) world of each lane, MISSING for none.
        rows: (n,) the object's points among the P, MISSING for those that are fixed.
        initial: (n, 2) where they are at reset, from which orientation counts, and where the fixed ones stay.
        with_hull: Whether to read the hull's area.
        hull: (2, points + 1) int scratch.
        sums: (N_SUMS, 1, 8) scratch.
        numbers: Receives the readings, as `relative`.
        relative: See `Readings`.
    """
    n = rows.shape[0]
    cx, cy, vx, vy = lanes.spread(0.0), lanes.spread(0.0), lanes.spread(0.0), lanes.spread(0.0)
    low_x, low_y = lanes.spread(math.inf), lanes.spread(math.inf)
    high_x, high_y = lanes.spread(-math.inf), lanes.spread(-math.inf)
    for k in range(n):
        p = rows[k]
        if p == MISSING:
            px, py = lanes.spread(initial[k, 0]), lanes.spread(initial[k, 1])
        else:
            px, py = lanes.load(points, X, p), lanes.load(points, Y, p)
            vx, vy = vx + lanes.load(points, VX, p), vy + lanes.load(points, VY, p)
        cx, cy = cx + px, cy + py
        low_x, low_y = lanes.minimum(px, low_x), lanes.minimum(py, low_y)
        high_x, high_y = lanes.maximum(px, high_x), lanes.maximum(py, high_y)
    cx, cy = cx / n, cy / n
    lanes.store(sums, COM, 0, cx)
    lanes.store(sums, COM + 1, 0, cy)
    lanes.store(sums, VELOCITY, 0, vx / n)
    lanes.store(sums, VELOCITY + 1, 0, vy / n)
    lanes.store(sums, LOW, 0, low_x)
    lanes.store(sums, LOW + 1, 0, low_y)
    lanes.store(sums, HIGH, 0, high_x)
    lanes.store(sums, HIGH + 1, 0, high_y)
    lanes.store(sums, ORIENTATION, 0, _orientation(points, rows, initial, cx, cy))
    for lane in range(lanes.N_LANES):
        world = worlds[lane]
        if world == MISSING:
            continue
        for k in range(N_SUMS):
            numbers[world, k] = sums[k, 0, lane]
        for k in range(n):
            p = rows[k]
            x = initial[k, 0] if p == MISSING else points[X, p, lane]
            y = initial[k, 1] if p == MISSING else points[Y, p, lane]
            relative[world, 0, k] = x - sums[COM, 0, lane]
            relative[world, 1, k] = y - sums[COM + 1, 0, lane]
        if with_hull:
            numbers[world, HULL_AREA] = _hull_area(relative, world, n, hull)


@inlined
def _orientation(points: np.ndarray, rows: np.ndarray, initial: np.ndarray, cx: Any, cy: Any) -> Any:
    """Returns the mean unsigned angle from the points at reset, weighted by distance, with the sign of their turning.

    Args:
        points: (N_POINT_ROWS, P, 8) state.
        rows: (n,) the object's points among the P, MISSING for those that are fixed.
        initial: (n, 2) the object's points at reset.
        cx: COM, lanes.
        cy: COM, lanes.
    """
    ax, ay = 0.0, 0.0
    n = rows.shape[0]
    for k in range(n):
        ax += initial[k, 0]
        ay += initial[k, 1]
    ax, ay = ax / n, ay / n
    total, turning, weights = lanes.spread(0.0), lanes.spread(0.0), 0.0
    for k in range(n):
        p = rows[k]
        ox, oy = initial[k, 0] - ax, initial[k, 1] - ay
        if p == MISSING:
            nx, ny = initial[k, 0] - cx, initial[k, 1] - cy
        else:
            nx, ny = lanes.load(points, X, p) - cx, lanes.load(points, Y, p) - cy
        was, now = math.sqrt(ox * ox + oy * oy), lanes.sqrt(nx * nx + ny * ny)
        if was == 0.0:
            continue  # no direction, and no weight
        cosine = (nx * ox + ny * oy) / (now * was)
        cosine = lanes.select(lanes.less(now * was, 1e-7), _ALMOST_ONE, cosine)
        cosine = lanes.select(lanes.less(1.0, cosine), _ALMOST_ONE, cosine)
        cosine = lanes.select(lanes.less(cosine, -1.0), -_ALMOST_ONE, cosine)
        total = total + _arccos(cosine) * was
        weights += was
        turn = (nx / now) * (oy / was) - (ny / now) * (ox / was)
        turning = turning + lanes.select(lanes.less(0.0, now), turn, 0.0)
    angle = total / weights
    return lanes.select(lanes.less(0.0, turning), _TWO_PI - angle, angle)


@inlined
def _arccos(x: Any) -> Any:
    """Returns arc cosines of lanes in [-1, 1], to two units in the last place.

    By arccos(x) = pi/2 - arcsin(x) where |x| < 1/2, else 2 arcsin(sqrt((1 - |x|) / 2)), and a polynomial for
    (arcsin(t) / t - 1) / t^2 on [0, 1/4].
    """
    size = lanes.absolute(x)
    is_middle = lanes.less(size, 0.5)
    square = lanes.select(is_middle, size * size, (1.0 - size) * 0.5)
    t = lanes.select(is_middle, size, lanes.sqrt(square))
    tail = lanes.spread(_ARCSIN[0])
    for k in range(1, len(_ARCSIN)):
        tail = tail * square + _ARCSIN[k]
    arcsin = t + t * (square * tail)
    angle = lanes.select(is_middle, math.pi / 2 - arcsin, 2.0 * arcsin)  # of |x|
    return lanes.select(lanes.less(x, 0.0), math.pi - angle, angle)


@inlined
def _turn(relative: np.ndarray, world: int, a: int, b: int, c: int) -> float:
    """Returns twice the signed area of the triangle of points a, b, c."""
    x, y = relative[world, 0, a], relative[world, 1, a]
    return (relative[world, 0, b] - x) * (relative[world, 1, c] - y) - (relative[world, 1, b] - y) * (
        relative[world, 0, c] - x
    )


@kernel
def _hull_area(relative: np.ndarray, world: int, n: int, hull: np.ndarray) -> float:
    """Returns the area of the convex hull of the points, by Andrew's monotone chain."""
    order, chain = hull[0], hull[1]
    for i in range(n):  # insertion sort by x, then y
        x, y, j = relative[world, 0, i], relative[world, 1, i], i
        while j > 0:
            before = order[j - 1]
            bx = relative[world, 0, before]
            if bx < x or (bx == x and relative[world, 1, before] <= y):
                break
            order[j] = before
            j -= 1
        order[j] = i
    area = 0.0
    for direction in range(2):
        size = 0
        for i in range(n):
            p = order[i] if direction == 0 else order[n - 1 - i]
            while size >= 2 and _turn(relative, world, chain[size - 2], chain[size - 1], p) <= 0.0:
                size -= 1
            chain[size] = p
            size += 1
        for i in range(size - 1):
            a, b = chain[i], chain[i + 1]
            area += relative[world, 0, a] * relative[world, 1, b] - relative[world, 0, b] * relative[world, 1, a]
    return area / 2.0


class Terrain(NamedTuple):
    """The points that an elevation window sees."""

    fixed: np.ndarray  # (Q, 2) in voxels, by ascending x
    moving: np.ndarray  # (m,) points of objects that can move


@kernel
def read_window(
    points: np.ndarray,
    worlds: np.ndarray,
    fixed: np.ndarray,
    moving: np.ndarray,
    com: np.ndarray,
    radius: int,
    is_ceiling: bool,
    out: np.ndarray,
) -> None:
    """Reads how far the terrain is below (or above) the COM, in columns one voxel wide.

    A column's reading is the distance to its nearest terrain point on that side, WINDOW_REACH where there is none.
    All borders are strict, as in EvoGym: a point exactly on one is in no column.

    Args:
        points: (N_POINT_ROWS, P, 8) state.
        worlds: (8,) world of each lane, MISSING for none.
        fixed: What to look at, with `moving`: see `Terrain`.
        moving: See `Terrain`.
        com: (N, 2) centres, metres.
        radius: Columns to each side of the COM's.
        is_ceiling: Whether to look up.
        out: (N, 2 radius + 1) receives metres, left to right.
    """
    for lane in range(lanes.N_LANES):
        world = worlds[lane]
        if world == MISSING:
            continue
        cx, cy = com[world, 0] / VOXEL, com[world, 1] / VOXEL
        for column in range(2 * radius + 1):
            out[world, column] = WINDOW_REACH * VOXEL
        left, right = cx - radius - 1.0, cx + radius + 1.0
        low, high = 0, fixed.shape[0]
        while low < high:
            middle = (low + high) // 2
            if fixed[middle, 0] < left:
                low = middle + 1
            else:
                high = middle
        for q in range(low, fixed.shape[0]):
            if not fixed[q, 0] <= right:
                break
            _look(fixed[q, 0], fixed[q, 1], cx, cy, radius, is_ceiling, out, world)
        for q in range(moving.shape[0]):
            p = moving[q]
            x = points[X, p, lane] / VOXEL
            if left <= x <= right:
                _look(x, points[Y, p, lane] / VOXEL, cx, cy, radius, is_ceiling, out, world)


@inlined
def _look(x: float, y: float, cx: float, cy: float, radius: int, is_ceiling: bool, out: np.ndarray, world: int) -> None:
    """Enters one terrain point, in voxels, into the columns that it is in."""
    distance = y - cy if is_ceiling else cy - y
    if not distance > 0.0:
        return
    nearest = math.floor(x - cx + 0.5)
    for i in range(nearest - 1, nearest + 2):
        if -radius <= i <= radius and cx + (i - 0.5) < x < cx + (i + 0.5):
            out[world, i + radius] = min(out[world, i + radius], VOXEL * distance)
