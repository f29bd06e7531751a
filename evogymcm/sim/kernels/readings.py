"""What can be read off the worlds: centres, velocities, orientations, outlines, terrain, and what voxels sense.

Kernels read worlds and write rows of arrays indexed by world. EvoGym returns coordinates in voxels; what is formed of
them, and in which order sums run, is followed to the last bit.
"""

import math
from collections.abc import Iterator

import numpy as np

from evogymcm.sim.constants import VOXEL
from evogymcm.sim.kernels._jit import inlined, inner, kernel
from evogymcm.sim.kernels.advance import Storage
from evogymcm.sim.kernels.candidates import position
from evogymcm.sim.tables import Layout, Terrain, in_two, layout_of, part, terrain_of

_TWO_PI = 2.0 * 3.1415926  # EvoGym's value, seven digits of pi
_ALMOST_ONE = 0.99999  # what a cosine beyond 1 counts as
_SHORT = 1e-7  # square metres: products of lengths below it have no angle
WINDOW_REACH = 5.0  # voxels: as far as an elevation window sees
# First columns of `Readings.numbers`; the centre is the COM in voxels.
COM, VELOCITY, LOW, HIGH, CENTRE, ORIENTATION, HULL_AREA, PLAIN_VELOCITY, N_NUMBERS = 0, 2, 4, 6, 8, 10, 11, 12, 14
N_SCRATCH = 8  # numbers a point that `read_object` needs

# Features of a voxel: x of TL, TR, BL, BR relative to the COM, then y; the same of velocities; stiffness and actuation
# in force; its row and column in its own body array, from -1 to 1.
POSITIONS, VELOCITIES, STIFFNESS, ACTUATION, PLACE, N_FEATURES = 0, 8, 16, 17, 18, 20


class Readings:
    """Readings of one object in N worlds; n points at most.

    Args:
        numbers: (N, N_NUMBERS), of which most attributes are views: they are made once, and follow what kernels write.
        relative: (N, 2, n) points minus COM; 0 beyond an object's own points.

    Attributes:
        com: (N, 2) mean of the points, metres.
        x: (N,) of the COM, across.
        y: (N,) of the COM, up.
        velocity: (N, 2) mean of the integrated velocities, formed in voxels.
        plain_velocity: (N, 2) the same mean, formed in metres, as some of EvoGym's tasks do: last digits differ.
        low: (N, 2) smallest coordinates.
        high: (N, 2) largest coordinates.
        orientation: (N,) radians in [0, 2 pi), counter-clockwise from reset.
        hull_area: (N,) square metres.
    """

    def __init__(self, numbers: np.ndarray, relative: np.ndarray) -> None:
        self.numbers, self.relative = numbers, relative
        self.com = numbers[:, COM : COM + 2]
        self.x, self.y = self.com[:, 0], self.com[:, 1]
        self.velocity = numbers[:, VELOCITY : VELOCITY + 2]
        self.plain_velocity = numbers[:, PLAIN_VELOCITY : PLAIN_VELOCITY + 2]
        self.low, self.high = numbers[:, LOW : LOW + 2], numbers[:, HIGH : HIGH + 2]
        self.orientation, self.hull_area = numbers[:, ORIENTATION], numbers[:, HULL_AREA]

    def __iter__(self) -> Iterator[np.ndarray]:
        """Gives `numbers` and `relative`, which kernels write."""
        return iter((self.numbers, self.relative))

    def __reduce__(self) -> tuple[type, tuple[np.ndarray, np.ndarray]]:
        return Readings, (self.numbers, self.relative)  # so that a copy's views are of its own numbers


def new_readings(n_worlds: int, n_points: int) -> Readings:
    """Returns readings of zeros."""
    return Readings(np.zeros((n_worlds, N_NUMBERS)), np.zeros((n_worlds, 2, n_points)))


@kernel
def read_object(
    storage: Storage,
    worlds: np.ndarray,
    k: int,
    with_hull: bool,
    scratch: np.ndarray,
    numbers: np.ndarray,
    relative: np.ndarray,
) -> None:
    """Reads object `k`, the robot for 0, of some worlds.

    Args:
        storage: The worlds.
        worlds: (m,) which of them.
        k: The object's number in simulation order.
        with_hull: Whether to read the hull's area.
        scratch: N_SCRATCH numbers for each point, and as many more.
        numbers: Receives the readings, as `relative`.
        relative: See `Readings`.
    """
    for w in worlds:
        design, scenery = storage.design_of[w, 0], storage.design_of[w, 1]
        layout = layout_of(storage.ints[design], storage.floats[design])
        terrain = terrain_of(storage.terrain_ints[scenery], storage.terrain_floats[scenery])
        m = layout.initial.shape[0]
        xy, v = part(storage.state[w], 0, m), part(storage.state[w], m, m)
        start, end = terrain.points_start[k], terrain.points_start[k + 1]
        places = layout.points if k == 0 else part(terrain.points, start, end - start)
        n = places.shape[0]
        if n > relative.shape[2]:
            continue  # never: the caller makes room
        rows = in_two(scratch, scratch.shape[0] // N_SCRATCH)
        x = y = sum_x = sum_y = sum_vx = sum_vy = plain_vx = plain_vy = 0.0
        low_x = low_y = math.inf
        high_x = high_y = -math.inf
        for i in range(n):
            px, py = position(xy, terrain.static, places[i])
            px, py = px / VOXEL, py / VOXEL
            x, y = x + px, y + py
            relative[w, 0, i], relative[w, 1, i] = px, py
            px, py = px * VOXEL, py * VOXEL
            sum_x, sum_y = sum_x + px, sum_y + py
            rows[0, i], rows[1, i] = px, py
            low_x, low_y, high_x, high_y = min(low_x, px), min(low_y, py), max(high_x, px), max(high_y, py)
            if places[i] >= 0:
                vx, vy = v[places[i]] / VOXEL, v[places[i] + 1] / VOXEL
                sum_vx, sum_vy = sum_vx + vx, sum_vy + vy
                plain_vx, plain_vy = plain_vx + vx * VOXEL, plain_vy + vy * VOXEL
        x, y = x / n, y / n
        for i in range(n):
            relative[w, 0, i] = (relative[w, 0, i] - x) * VOXEL
            relative[w, 1, i] = (relative[w, 1, i] - y) * VOXEL
        row = numbers[w]
        row[COM], row[COM + 1] = sum_x / n, sum_y / n
        row[VELOCITY], row[VELOCITY + 1] = sum_vx / n * VOXEL, sum_vy / n * VOXEL
        row[PLAIN_VELOCITY], row[PLAIN_VELOCITY + 1] = plain_vx / n, plain_vy / n
        row[LOW], row[LOW + 1], row[HIGH], row[HIGH + 1] = low_x, low_y, high_x, high_y
        row[CENTRE], row[CENTRE + 1] = x, y
        if with_hull:
            row[HULL_AREA] = _hull_area(rows[0], rows[1], n)
        row[ORIENTATION] = _orientation(layout, terrain, xy, places, rows)


@inlined
def _mean(numbers: np.ndarray, n: int) -> float:
    """Returns the mean of the first `n` numbers as EvoGym adds them up: the first, then four by four, then the rest."""
    total, i = numbers[0], 1
    while i + 3 < n:
        total += (numbers[i] + numbers[i + 1]) + (numbers[i + 2] + numbers[i + 3])
        i += 4
    while i < n:
        total += numbers[i]
        i += 1
    return total / n


@inlined
def _sum(numbers: np.ndarray, n: int) -> float:
    """Returns the sum of the first `n` numbers, four at least, as EvoGym adds them up: in two pairs of partial sums."""
    a, b, c, d = numbers[0], numbers[1], numbers[2], numbers[3]
    for i in range(4, n - n % 4, 4):
        a, b, c, d = a + numbers[i], b + numbers[i + 1], c + numbers[i + 2], d + numbers[i + 3]
    a, b = a + c, b + d
    if n % 4 >= 2:
        a, b = a + numbers[n - n % 4], b + numbers[n - n % 4 + 1]
    total = a + b
    return total + numbers[n - 1] if n % 2 else total


@inner
def _orientation(layout: Layout, terrain: Terrain, xy: np.ndarray, places: np.ndarray, scratch: np.ndarray) -> float:
    """Returns the mean unsigned angle from the points at reset, weighted by distance, with the sign of their turning.

    `scratch` is (N_SCRATCH, n at least).
    """
    n = places.shape[0]
    ax, ay, bx, by = scratch[0], scratch[1], scratch[2], scratch[3]
    for i in range(n):
        ax[i], ay[i] = position(layout.initial, terrain.static, places[i])
        bx[i], by[i] = position(xy, terrain.static, places[i])
    centre = _mean(ax, n), _mean(ay, n), _mean(bx, n), _mean(by, n)
    angles, weights, turns = scratch[4], scratch[5], scratch[6]
    for i in range(n):
        ox, oy, nx, ny = ax[i] - centre[0], ay[i] - centre[1], bx[i] - centre[2], by[i] - centre[3]
        was, now = math.sqrt(ox * ox + oy * oy), math.sqrt(nx * nx + ny * ny)
        if was > 0.0:
            ox, oy = ox / was, oy / was
        if now > 0.0:
            nx, ny = nx / now, ny / now
        cosine = nx * ox + ny * oy
        if was * now < _SHORT or cosine > 1.0:
            cosine = _ALMOST_ONE
        elif cosine < -1.0:
            cosine = -_ALMOST_ONE
        angles[i], weights[i], turns[i] = math.acos(cosine) * was, was, nx * oy - ny * ox
    angle = _sum(angles, n) / _sum(weights, n)
    return _TWO_PI - angle if _sum(turns, n) > 0.0 else angle


@inner
def _hull_area(x: np.ndarray, y: np.ndarray, n: int) -> float:
    """Returns the area of the convex hull of the first `n` points, found side by side from the leftmost on.

    Which of several points on one side it stops at, and the order of the sum, are EvoGym's.
    """
    first = 0
    for i in range(1, n):
        if x[i] < x[first]:
            first = i
    area, at = 0.0, first
    for _ in range(n):  # rounding could lead it past the first point
        to = at + 1 if at + 1 < n else 0
        for i in range(n):
            if (y[i] - y[at]) * (x[to] - x[i]) < (x[i] - x[at]) * (y[to] - y[i]):
                to = i
        area += x[at] * y[to] - y[at] * x[to]
        at = to
        if at == first:
            break
    return area / 2.0


@kernel
def read_window(
    storage: Storage,
    worlds: np.ndarray,
    fixed: np.ndarray,
    moving: np.ndarray,
    numbers: np.ndarray,
    radius: int,
    is_ceiling: bool,
    out: np.ndarray,
) -> None:
    """Reads how far the terrain is below (or above) the robots' COM, in columns one voxel wide.

    A column's reading is the distance to its nearest terrain point on that side, WINDOW_REACH where there is none or
    it is farther. All borders are strict, as in EvoGym: a point exactly on one is in no column.

    Args:
        storage: The worlds.
        worlds: (m,) which of them.
        fixed: (Q, 2) fixed points to look at, in voxels, by ascending x.
        moving: Places of those that can move.
        numbers: (N, N_NUMBERS) the robots' readings.
        radius: Columns to each side of the COM's.
        is_ceiling: Whether to look up.
        out: (N, 2 radius + 1) receives metres, left to right.
    """
    for w in worlds:
        cx, cy = numbers[w, CENTRE], numbers[w, CENTRE + 1]
        for column in range(2 * radius + 1):
            out[w, column] = math.inf
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
            _look(fixed[q, 0], fixed[q, 1], cx, cy, radius, is_ceiling, out, w)
        for q in range(moving.shape[0]):
            x = storage.state[w, moving[q]] / VOXEL
            if left <= x <= right:
                _look(x, storage.state[w, moving[q] + 1] / VOXEL, cx, cy, radius, is_ceiling, out, w)
        # EvoGym takes a column without a ceiling for one at the reach, and rounds; without a floor that is exact.
        nothing = (cy + WINDOW_REACH) - cy if is_ceiling else WINDOW_REACH
        for column in range(2 * radius + 1):
            distance = out[w, column]
            out[w, column] = VOXEL * min(nothing if distance == math.inf else distance, WINDOW_REACH)


@inlined
def _look(x: float, y: float, cx: float, cy: float, radius: int, is_ceiling: bool, out: np.ndarray, world: int) -> None:
    """Enters one terrain point, in voxels, into the columns that it is in."""
    distance = y - cy if is_ceiling else cy - y
    if not distance > 0.0:
        return
    nearest = math.floor(x - cx + 0.5)
    for i in range(nearest - 1, nearest + 2):
        if -radius <= i <= radius and cx + (i - 0.5) < x < cx + (i + 0.5):
            out[world, i + radius] = min(out[world, i + radius], distance)


@kernel
def read_voxels(
    storage: Storage,
    worlds: np.ndarray,
    numbers: np.ndarray,
    stiffness: np.ndarray,
    actuation: np.ndarray,
    template: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fills in all features of some worlds' voxels.

    Args:
        storage: The worlds.
        worlds: (m,) which of them.
        numbers: (N, N_NUMBERS) the robots' readings.
        stiffness: (N, V) present stiffness.
        actuation: (N, V) last actuation.
        template: (N, V * N_FEATURES) float32 features that never change.
        out: (N, V * N_FEATURES) float32.
    """
    for w in worlds:
        design = storage.design_of[w, 0]
        layout = layout_of(storage.ints[design], storage.floats[design])
        m = layout.initial.shape[0]
        xy, v = part(storage.state[w], 0, m), part(storage.state[w], m, m)
        cx, cy = numbers[w, COM], numbers[w, COM + 1]
        ux, uy = numbers[w, VELOCITY], numbers[w, VELOCITY + 1]
        for k in range(out.shape[1]):
            out[w, k] = template[w, k]
        for i in range(0, layout.voxels.shape[0], 5):
            column = layout.voxels[i]
            at = column * N_FEATURES
            for k in range(4):
                p = layout.voxels[i + 1 + k]
                out[w, at + POSITIONS + k] = xy[p] - cx
                out[w, at + POSITIONS + 4 + k] = xy[p + 1] - cy
                out[w, at + VELOCITIES + k] = v[p] - ux
                out[w, at + VELOCITIES + 4 + k] = v[p + 1] - uy
            out[w, at + STIFFNESS] = stiffness[w, column]
            out[w, at + ACTUATION] = actuation[w, column]
