"""What one object adds to a scene's tables: points, springs and surface voxels, with their numbers there."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import FIXED, MISSING, RIGID
from evogymcm.sim.kernels._jit import kernel
from evogymcm.sim.kernels.springs import FIRST_FORCE, NO_FORCE, slot_of
from evogymcm.sim.kernels.trees import Tree, build_tree
from evogymcm.sim.kernels.vectors import LANE_SLOTS
from evogymcm.sim.object_springs import ObjectSprings, object_springs
from evogymcm.sim.tables import Layout
from evogymcm.sim.topology import Topology, topology
from evogymcm.sim.world import WorldObject

_SLOTS = np.argsort(LANE_SLOTS)  # which spring is in each slot
_NEIGHBOURS = 12  # points, see `object_tables`
_IDLE_Y = 1.0  # metres: points that only fill up are above the floor


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """An object of a scene: its topology, and the places of its points in the scene's tables."""

    name: str
    origin: tuple[int, int]  # world cell of the lower-left cell
    topology: Topology
    places: np.ndarray  # (n,) int32
    tree: Tree
    voxels: np.ndarray  # (c,) surface voxel c or ~d that each voxel is, arbitrary for those inside


class Fixed(NamedTuple):
    """The fixed surface voxels of one object."""

    static: np.ndarray
    corners: np.ndarray
    sides: np.ndarray
    surface: np.ndarray
    cells: np.ndarray  # (d, 2) world row and column


def _strained(xy: np.ndarray, springs: ObjectSprings, convergence: float) -> np.ndarray:
    """Returns which springs pull although nothing has moved: far from the origin, coordinates are rounded."""
    apart = xy[springs.ends[:, 0]] - xy[springs.ends[:, 1]]
    length = np.sqrt(apart[:, 0] * apart[:, 0] + apart[:, 1] * apart[:, 1])
    return length + convergence * (springs.rest - length) != length


def _padded(values: np.ndarray, length: int, fill: float, dtype: type) -> np.ndarray:
    out = np.full((length, *values.shape[1:]), fill, dtype)
    out[: len(values)] = values
    return out


@kernel
def _fill_sums(
    ends: np.ndarray, first_point: int, first_spring: int, counts: np.ndarray, groups: np.ndarray, pulls: np.ndarray
) -> int:
    """Sets `groups` (with the end) and `pulls` of one object; returns how many of `pulls` there are.

    Args:
        ends: (S, 2) places of the springs' ends.
        first_point: The object's first point in the scene's tables, a multiple of four.
        first_spring: Its first spring, a multiple of eight.
        counts: (2, points) zeros.
        groups: (points / 2 + 1,).
        pulls: At least 8 S of NO_FORCE.
    """
    n_springs, n_points = ends.shape[0], counts.shape[1]
    for j in range(2):
        for s in range(n_springs):
            counts[j, (ends[s, j] >> 1) - first_point] += 1
    end = 0
    for i in range(groups.shape[0] - 1):
        groups[i] = end
        longest = 0
        for p in range(4 * (i // 2), 4 * (i // 2) + 4):
            longest = max(longest, counts[i % 2, p])
        end += 4 * longest
    groups[groups.shape[0] - 1] = end
    for j in range(2):
        for p in range(n_points):
            counts[j, p] = 0
        for s in range(n_springs):
            p = (ends[s, j] >> 1) - first_point
            pulls[groups[2 * (p // 4) + j] + 4 * counts[j, p] + p % 4] = FIRST_FORCE + 2 * slot_of(first_spring + s)
            counts[j, p] += 1
    return end


@kernel
def _fill_uses(points: np.ndarray, cells: np.ndarray, start: np.ndarray, uses: np.ndarray) -> int:
    """Sets `uses_start` and `uses`, in the order of the cells; returns how many rows there are.

    Args:
        points: (m, 4) corners of surface voxels, as points; negative ones are left out.
        cells: (m,) the voxels' numbers.
        start: (points + 1,) zeros.
        uses: (4 m, 2).
    """
    n = start.shape[0] - 1
    for i in range(points.shape[0]):
        for k in range(4):
            if points[i, k] >= 0:
                start[points[i, k] + 1] += 1
    for p in range(n):
        start[p + 1] += start[p]
    for i in range(points.shape[0] - 1, -1, -1):
        for k in range(3, -1, -1):
            p = points[i, k]
            if p >= 0:
                start[p + 1] -= 1
                uses[start[p + 1], 0], uses[start[p + 1], 1] = cells[i], k
    # Each end has become the beginning of its own rows: all are one place too far on.
    total = 0
    for i in range(points.shape[0]):
        for k in range(4):
            total += points[i, k] >= 0
    for p in range(n):
        start[p] = start[p + 1]
    start[n] = total
    return total


@kernel
def _fill_apart(cells: np.ndarray, masks: np.ndarray) -> int:
    """Sets `Layout.apart` of surface voxels at (n, 2) cells; returns how many masks there are."""
    row = 0
    for a in range(cells.shape[0]):
        for first in range(0, a, 8):
            mask = 0
            for b in range(first, min(first + 8, a)):
                if abs(cells[a, 0] - cells[b, 0]) > 1 or abs(cells[a, 1] - cells[b, 1]) > 1:
                    mask |= 1 << (b - first)
            masks[row] = mask
            row += 1
    return row


class Sizes(NamedTuple):
    """How much there is before an object in a scene's tables."""

    points: int = 0
    springs: int = 0
    cells: int = 0
    statics: int = 0
    fixed: int = 0


def object_tables(
    source: WorldObject,
    number: int,
    before: Sizes,
    edge_rule: str,
    convergence: float,
    is_placed: bool,
    columns: int | None,
) -> tuple[Layout, Fixed, PlacedObject]:
    """Returns what one object adds to a scene's tables, with the numbers that it has there.

    Args:
        source: The object.
        number: Its number, 0 for the robot.
        before: What stands before it.
        edge_rule: See `Scenery`.
        convergence: Of the physics.
        is_placed: Whether a reset may move it: it is then state, also where it is fixed.
        columns: Columns of the padded grid, None for an object that is not the robot.
    """
    t = topology(source.grid, source.connections)
    xy = t.points(*source.origin)
    is_soft = t.codes != FIXED
    is_terrain = ~is_soft & (not is_placed)
    springs = object_springs(t, edge_rule, with_fixed=not is_soft.all())
    is_moving = np.ones(t.n_points, bool)
    if is_terrain.any():
        is_moving[:] = is_placed
        is_moving[t.corner_points[is_soft].reshape(-1)] = True
    if not is_soft.all():
        # Between fixed corners a spring is at rest, unless their coordinates are rounded: then it pulls at corners that
        # soft voxels share, and those at their neighbours.
        is_kept = (is_soft[springs.owners] & (springs.owners != MISSING)).any(1)
        is_moving[springs.ends[is_kept]] = True  # also corners of fixed voxels, where the soft one is joined in part
        if not is_placed:
            pulls_at_shared = is_moving[springs.ends].any(1) & _strained(xy, springs, convergence)
            is_kept |= pulls_at_shared
            is_moving[springs.ends[pulls_at_shared]] = True
        springs = springs._replace(**{name: getattr(springs, name)[is_kept] for name in springs._fields[:-1]})
    n_moving, n_springs = int(is_moving.sum()), len(springs.rest)
    points_end, springs_end = -4 * (-n_moving // 4), -8 * (-n_springs // 8)
    # Points with equally many springs stand together, of some neighbours: a group takes as long as the one with most,
    # and finds near each other what it gathers.
    degrees = np.bincount(springs.ends[:, 0], minlength=t.n_points) * 16 + np.bincount(
        springs.ends[:, 1], minlength=t.n_points
    )
    order = np.flatnonzero(is_moving)
    order = order[np.lexsort((degrees[order], np.arange(n_moving) // _NEIGHBOURS))]
    places = np.empty(t.n_points, np.int32)
    places[order] = 2 * (before.points + np.arange(n_moving))
    if n_moving < t.n_points:
        places[~is_moving] = ~(2 * (before.statics + np.arange(t.n_points - n_moving)))

    end_places = places[springs.ends]
    ends = np.empty((springs_end, 2), np.int32)
    ends[:n_springs] = end_places
    ends[n_springs:] = 2 * (before.points + np.arange(2))
    ends = ends.reshape(-1, 8, 2)[:, _SLOTS].transpose(0, 2, 1)
    groups, pulls = np.empty(points_end // 2 + 1, np.int32), np.full(8 * n_springs, NO_FORCE, np.int32)
    counts = np.zeros((2, points_end), np.int32)
    pulls = pulls[: _fill_sums(end_places, before.points, before.springs, counts, groups, pulls)]
    free = np.zeros((points_end, 2), bool)
    free[:n_moving] = ~t.is_fixed[order, None]
    initial = np.full((points_end, 2), [0.0, _IDLE_Y])
    initial[:n_moving] = xy[order]

    surface = t.is_surface_side.any(1)
    moving_rows, fixed_rows = np.flatnonzero(surface & ~is_terrain), np.flatnonzero(surface & is_terrain)
    side_places = places[t.edges[t.sides]].reshape(-1, 8)
    side_mask = np.packbits(t.is_surface_side, axis=1, bitorder="little")[:, 0]
    corner_places = places[t.corner_points]

    none = np.zeros(0, np.int32)
    driven = owned = voxels = apart = none
    if columns is not None:
        column = np.full(t.n_cells + 1, MISSING)  # the last entry keeps MISSING
        column[:-1] = t.cells[:, 0] * columns + t.cells[:, 1]
        own = before.springs + np.arange(n_springs)
        is_driven = springs.drivers[:, 0] != MISSING
        driven = _rows(own[is_driven], column[springs.drivers[is_driven]])
        owned = _rows(own, column[springs.owners])
        voxels = _rows(column[:-1], corner_places)
        apart = _apart(t.cells[moving_rows])
    has_shares = columns is not None and edge_rule == "mean_stiffness"
    ranges = 2 * before.points, 2 * (before.points + points_end), before.cells, before.cells + len(moving_rows)
    layout = Layout(
        ends=ends.ravel(),
        groups=groups,
        pulls=pulls,
        free=np.packbits(free, bitorder="little").astype(np.int32),
        rigid=places[t.edges[t.sides[t.codes == RIGID].reshape(-1)]].ravel(),
        driven=driven,
        owned=owned,
        objects=np.array(ranges, np.int32),
        corners=corner_places[moving_rows].ravel(),
        sides=side_places[moving_rows].ravel(),
        surface=side_mask[moving_rows],
        cell_object=np.full(len(moving_rows), number, np.int32),
        node_start=none,
        children=none,
        node_place=none,
        node_voxel=none,
        leaf=none,
        apart=apart,
        uses_start=none,  # what concerns several objects comes with the scene
        uses=none,
        points=places if columns is not None else none,
        voxels=voxels,
        rest=_padded(springs.rest, springs_end, np.nan, np.float64),
        constants=_padded(springs.constants, springs_end, 0.0, np.float64),
        shares=springs.owner_constants.ravel() if has_shares else np.zeros(0),
        initial=initial.ravel(),
    )
    cells = t.cells[fixed_rows]
    world_cells = np.empty((len(cells), 2), np.int64)
    world_cells[:, 0], world_cells[:, 1] = source.origin[1] + t.rows - 1 - cells[:, 0], source.origin[0] + cells[:, 1]
    fixed = Fixed(
        xy[~is_moving], corner_places[fixed_rows], side_places[fixed_rows], side_mask[fixed_rows], world_cells
    )
    numbers = np.zeros(t.n_cells, np.int64)
    numbers[moving_rows] = before.cells + np.arange(len(moving_rows))
    numbers[fixed_rows] = ~(before.fixed + np.arange(len(fixed_rows)))
    placed = PlacedObject(source.name, source.origin, t, places, build_tree(t, source.origin), numbers)
    return layout, fixed, placed


def _rows(first: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Returns a table whose rows are a number and a row of others, one after another."""
    rows = np.empty((len(first), 1 + others.shape[1]), np.int32)
    rows[:, 0], rows[:, 1:] = first, others
    return rows.ravel()


def _apart(cells: np.ndarray) -> np.ndarray:
    n = len(cells)
    masks = np.empty(n * (n // 8 + 1), np.int32)
    return masks[: _fill_apart(cells, masks)]


def uses_of(points: np.ndarray, cells: np.ndarray, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns `uses_start` and rows of `uses` of `n_points` points, see `_fill_uses`."""
    start, uses = np.zeros(n_points + 1, np.int32), np.empty((4 * len(points), 2), np.int32)
    return start, uses[: _fill_uses(points.astype(np.int32), cells.astype(np.int32), start, uses)]
