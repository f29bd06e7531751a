"""What can be read off the worlds: centres, velocities, orientations, outlines, and the terrain around a robot.

Kernels read a block's lanes and write rows of arrays indexed by world. Sums run in the order of the points.
"""

import math
from typing import NamedTuple

import numpy as np

from evogymcm.sim import lanes
from evogymcm.sim._jit import inlined, kernel
from evogymcm.sim.constants import MISSING, VOXEL
from evogymcm.sim.springs import VX, VY, X, Y

_TWO_PI = 2.0 * 3.1415926  # EvoGym's value, seven digits of pi
_ALMOST_ONE = 0.99999  # what a cosine beyond 1 counts as
WINDOW_REACH = 5.0  # voxels: as far as an elevation window sees


class Readings(NamedTuple):
    """Readings of one object in N worlds; n points at most."""

    com: np.ndarray  # (N, 2) mean of the points, metres
    velocity: np.ndarray  # (N, 2) mean of the integrated velocities
    low: np.ndarray  # (N, 2) smallest coordinates
    high: np.ndarray  # (N, 2) largest coordinates
    relative: np.ndarray  # (N, 2, n) points minus COM; 0 beyond an object's own points
    orientation: np.ndarray  # (N,) radians in [0, 2 pi), counter-clockwise from reset
    hull_area: np.ndarray  # (N,) square metres


def new_readings(n_worlds: int, n_points: int) -> Readings:
    """Returns readings of zeros."""
    shapes = ((2,), (2,), (2,), (2,), (2, n_points), (), ())
    return Readings(*(np.zeros((n_worlds, *shape)) for shape in shapes))


@kernel
def read_object(
    points: np.ndarray,
    initial: np.ndarray,
    first: int,
    end: int,
    worlds: np.ndarray,
    with_orientation: bool,
    with_hull: bool,
    hull: np.ndarray,
    out: Readings,
) -> None:
    """Reads the object whose points are `first` to `end`, in the lanes that have a world.

    Args:
        points: (N_POINT_ROWS, P, 8) state.
        initial: (P, 2) coordinates at reset, from which orientation counts.
        first: First point.
        end: End of the points.
        worlds: (8,) world of each lane, MISSING for none.
        with_orientation: Whether to read it.
        with_hull: Whether to read the hull's area.
        hull: (2, points + 1) int scratch.
        out: Receives the readings.
    """
    n = end - first
    ax, ay = 0.0, 0.0
    for p in range(first, end):
        ax += initial[p, 0]
        ay += initial[p, 1]
    ax, ay = ax / n, ay / n
    for lane in range(lanes.N_LANES):
        world = worlds[lane]
        if world == MISSING:
            continue
        cx, cy, vx, vy = 0.0, 0.0, 0.0, 0.0
        low_x, low_y, high_x, high_y = math.inf, math.inf, -math.inf, -math.inf
        for p in range(first, end):
            px, py = points[X, p, lane], points[Y, p, lane]
            cx, cy, vx, vy = cx + px, cy + py, vx + points[VX, p, lane], vy + points[VY, p, lane]
            low_x, low_y, high_x, high_y = min(low_x, px), min(low_y, py), max(high_x, px), max(high_y, py)
        cx, cy = cx / n, cy / n
        out.com[world, 0], out.com[world, 1] = cx, cy
        out.velocity[world, 0], out.velocity[world, 1] = vx / n, vy / n
        out.low[world, 0], out.low[world, 1] = low_x, low_y
        out.high[world, 0], out.high[world, 1] = high_x, high_y
        for p in range(first, end):
            out.relative[world, 0, p - first] = points[X, p, lane] - cx
            out.relative[world, 1, p - first] = points[Y, p, lane] - cy
        if with_orientation:
            out.orientation[world] = _orientation(out.relative, world, initial, first, end, ax, ay)
        if with_hull:
            out.hull_area[world] = _hull_area(out.relative, world, n, hull)


@kernel
def _orientation(
    relative: np.ndarray, world: int, initial: np.ndarray, first: int, end: int, ax: float, ay: float
) -> float:
    """Returns the mean unsigned angle from the points at reset, weighted by distance, with the sign of their turning.

    Args:
        relative: (N, 2, n) points minus COM.
        world: Its row.
        initial: (P, 2) points at reset.
        first: First point.
        end: End of the points.
        ax: COM at reset.
        ay: COM at reset.
    """
    total, weights, turning = 0.0, 0.0, 0.0
    for p in range(first, end):
        ox, oy = initial[p, 0] - ax, initial[p, 1] - ay
        nx, ny = relative[world, 0, p - first], relative[world, 1, p - first]
        was, now = math.sqrt(ox * ox + oy * oy), math.sqrt(nx * nx + ny * ny)
        cosine = _ALMOST_ONE
        if was * now >= 1e-7:
            cosine = (ox * nx + oy * ny) / (was * now)
        if cosine > 1.0:
            cosine = _ALMOST_ONE
        elif cosine < -1.0:
            cosine = -_ALMOST_ONE
        total += was * math.acos(cosine)
        weights += was
        if was > 0.0 and now > 0.0:
            turning += (nx / now) * (oy / was) - (ny / now) * (ox / was)
    angle = total / weights
    return _TWO_PI - angle if turning > 0.0 else angle


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
    terrain: Terrain,
    points: np.ndarray,
    com: np.ndarray,
    worlds: np.ndarray,
    radius: int,
    is_ceiling: bool,
    out: np.ndarray,
) -> None:
    """Reads how far the terrain is below (or above) the COM, in columns one voxel wide.

    A column's reading is the distance to its nearest terrain point on that side, WINDOW_REACH where there is none.
    All borders are strict, as in EvoGym: a point exactly on one is in no column.

    Args:
        terrain: What to look at.
        points: (N_POINT_ROWS, P, 8) state.
        com: (N, 2) centres, metres.
        worlds: (8,) world of each lane, MISSING for none.
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
        low, high = 0, terrain.fixed.shape[0]
        while low < high:
            middle = (low + high) // 2
            if terrain.fixed[middle, 0] < left:
                low = middle + 1
            else:
                high = middle
        for q in range(low, terrain.fixed.shape[0]):
            if not terrain.fixed[q, 0] <= right:
                break
            _look(terrain.fixed[q, 0], terrain.fixed[q, 1], cx, cy, radius, is_ceiling, out, world)
        for q in range(terrain.moving.shape[0]):
            p = terrain.moving[q]
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
