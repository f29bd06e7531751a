"""A scene: one robot in one world, as the arrays that the kernels read.

All worlds of a block share a scene. Only what can move has lanes: the corners of the voxels that are not fixed. Fixed
voxels, whether a whole terrain or the posts of a soft bridge, are geometry: their corners are numbered after the moving
points (point P + i is `static_points[i]`), and they are found through a grid of world cells. Their own springs are left
out: a fixed corner's path through the integration stages depends on them only through forces that are zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import FIXED, MISSING, RIGID, VOXEL
from evogymcm.sim.topology import Topology, topology
from evogymcm.sim.world import WorldObject

EDGE_RULES = ("mean_factor", "mean_stiffness")


class Layout(NamedTuple):
    """What never changes in a scene. P moving points, S springs, C moving and D fixed surface voxels."""

    ends: np.ndarray  # (S, 2) the points of each spring
    rest: np.ndarray  # (S,) initial length
    constants: np.ndarray  # (S,) spring constants at stiffness 1
    owners: np.ndarray  # (S, 2) robot voxels whose stiffness scales the spring, MISSING: the factor 1
    owner_constants: np.ndarray  # (S, 2) the share of the constant that each owner scales; 0: both scale the whole
    drivers: np.ndarray  # (S, 2) robot voxels whose actuation sets the length, MISSING for none
    rigid: np.ndarray  # (R,) edges of rigid voxels, in the order in which they are corrected
    is_free: np.ndarray  # (P,) whether integration moves the point
    pulls_start: np.ndarray  # (P + 1,) where a point's rows in `pulls` begin
    pulls: np.ndarray  # (2 S,) the springs at each point: those that begin there in order, then those that end there
    pulls_turn: np.ndarray  # (P,) where in `pulls` those that end at the point begin
    objects: np.ndarray  # (K, 4) objects: first and end moving point, first and end moving surface voxel
    is_anchored: np.ndarray  # (K,) whether some of the object's points are fixed, and others move
    initial: np.ndarray  # (P, 2) coordinates at reset
    static_points: np.ndarray  # (Q, 2) corners of fixed voxels that no moving voxel has
    corners: np.ndarray  # (C + D, 4) points at TL, TR, BL, BR of the surface voxels
    sides: (
        np.ndarray
    )  # (C + D, 4, 2) ends of their top, right, bottom, left; where voxels are unjoined, not their corners
    is_surface: np.ndarray  # (C + D, 4) whether top, right, bottom, left is surface
    cell_object: np.ndarray  # (C + D,) the object of each surface voxel
    grid_cells: np.ndarray  # (C, 2) row and column in the object's grid
    uses_start: np.ndarray  # (P + Q + 1,) where a point's rows in `uses` begin
    uses: np.ndarray  # (U, 2) surface voxels and the corner that the point is there
    cell_at: np.ndarray  # (height, width) fixed surface voxel at a world cell, MISSING for none
    near: np.ndarray  # (M, 2) point and voxel, one of them an anchored object's, nearest first
    near_gap: np.ndarray  # (M,) metres between them at reset
    near_start: np.ndarray  # (K + 1,) where an object's rows in `near` begin


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """An object of the scene: its topology, and the scene's numbers of its points."""

    name: str
    origin: tuple[int, int]  # world cell of the lower-left cell
    topology: Topology
    points: np.ndarray  # (n,) moving points, or P + i for the fixed ones


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene's arrays and its objects, robot first."""

    layout: Layout
    objects: tuple[PlacedObject, ...]

    @property
    def n_points(self) -> int:
        """Points that have lanes."""
        return len(self.layout.initial)

    def object(self, name: str) -> PlacedObject:
        """Returns the object called `name`; ValueError where there is none."""
        for placed in self.objects:
            if placed.name == name:
                return placed
        raise ValueError(f"object: got {name!r}, this world has {[o.name for o in self.objects]}")


def _springs(t: Topology, is_robot: bool, edge_rule: str) -> dict[str, np.ndarray]:
    """Returns the object's springs (edges, then diagonals), without those of fixed voxels only."""
    owners = t.edge_owners
    diagonal_constants = t.diagonal_constants()
    if edge_rule == "mean_factor":
        constants = np.concatenate([t.edge_constants, diagonal_constants])
        shares = np.zeros((len(constants), 2))
    else:
        edge_shares = t.owner_constants() / (owners != MISSING).sum(1, keepdims=True)
        shares = np.concatenate([edge_shares, np.stack([diagonal_constants, np.zeros(2 * t.n_cells)], axis=1)])
        constants = shares.sum(1)
    own = np.stack([np.repeat(np.arange(t.n_cells), 2), np.full(2 * t.n_cells, MISSING)], axis=1)
    none = np.full((2 * t.n_cells, 2), MISSING)
    owners = np.concatenate([owners, own])
    soft = (t.codes[owners] != FIXED) & (owners != MISSING)
    result = {
        "ends": np.concatenate([t.edges, t.diagonals]),
        "rest": np.concatenate([np.full(len(t.edges), VOXEL), np.full(len(t.diagonals), np.sqrt(2 * VOXEL**2))]),
        "owners": owners if is_robot else np.full_like(owners, MISSING),
        "constants": constants,
        "owner_constants": shares,
        "drivers": np.concatenate([t.edge_drivers if is_robot else np.full_like(t.edge_drivers, MISSING), none]),
    }
    keep = soft.any(1)
    numbers = np.cumsum(keep) - 1  # old spring number -> new one
    rigid = t.sides[t.codes == RIGID].reshape(-1)
    return {key: value[keep] for key, value in result.items()} | {"rigid": numbers[rigid]}


def _near_pairs(layout: dict[str, np.ndarray], k: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the (point, voxel) pairs of anchored object `k` with itself and with all fixed voxels, nearest first.

    Its corners against its own moving voxels and all fixed ones, and all fixed corners against its moving voxels.
    """
    xy = np.concatenate([layout["initial"], layout["static_points"]])
    corners, (first, end, first_cell, end_cell) = layout["corners"], layout["objects"][k]
    moving = np.arange(first_cell, end_cell)
    fixed = np.arange(len(layout["grid_cells"]), len(corners))
    own = np.intersect1d(np.arange(first, end), corners)
    static = np.intersect1d(np.arange(len(layout["initial"]), len(xy)), corners)
    pairs, gaps = [], []
    for points, cells in ((own, moving), (own, fixed), (static, moving)):
        low, high, at = xy[corners[cells]].min(1), xy[corners[cells]].max(1), xy[points][:, None]
        gap = np.maximum(np.maximum(low - at, at - high), 0.0).max(-1)
        i, j = np.nonzero(~(corners[cells][None] == points[:, None, None]).any(-1))
        pairs.append(np.stack([points[i], cells[j]], axis=1))
        gaps.append(gap[i, j])
    gap = np.concatenate(gaps)
    order = np.argsort(gap, kind="stable")
    return np.concatenate(pairs)[order], gap[order]


def build_scene(
    objects: Sequence[WorldObject], edge_rule: str = "mean_factor", placed_at_reset: Sequence[str] = ()
) -> Scene:
    """Returns the scene of placed objects, the robot (the first) at S = 1 scaling no other object's springs.

    Args:
        objects: Robot first, then the others in simulation order.
        edge_rule: "mean_factor" (k = mean of the owners' S times the edge's constant; the EvoGymCM paper's equation) or
            "mean_stiffness" (k = mean over owners of S times the owner's own type's constant, in every object; the
            reference code of the invariant setting).
        placed_at_reset: Objects whose place each reset may choose, for each world apart: their points have lanes, also
            where they are fixed.

    Raises:
        ValueError: For an unknown edge rule.
    """
    if edge_rule not in EDGE_RULES:
        raise ValueError(f"edge_rule: got {edge_rule!r}, allowed are {EDGE_RULES}")
    topologies = [topology(o.grid, o.connections) for o in objects]
    moves = []  # per object: which of its points have lanes
    for source, t in zip(objects, topologies, strict=True):
        is_moving = np.full(t.n_points, source.name in placed_at_reset)
        is_moving[t.corner_points[t.codes != FIXED].reshape(-1)] = True
        moves.append(is_moving)
    n_moving = sum(int(m.sum()) for m in moves)

    placed: list[PlacedObject] = []
    springs: list[dict[str, np.ndarray]] = []
    coordinates, static_points, is_free = [], [], []
    ranges: list[list[int]] = []
    moving_cells: list[tuple[np.ndarray, ...]] = []
    fixed_cells: list[tuple[np.ndarray, ...]] = []
    is_anchored = []
    first, n_static, n_springs, n_cells = 0, 0, 0, 0
    for k, (source, t, is_moving) in enumerate(zip(objects, topologies, moves, strict=True)):
        xy = t.points(*source.origin)
        count = int(is_moving.sum())
        numbers = np.empty(t.n_points, np.int64)
        numbers[is_moving] = first + np.arange(count)
        numbers[~is_moving] = n_moving + n_static + np.arange(t.n_points - count)
        placed.append(PlacedObject(source.name, source.origin, t, numbers))
        own = _springs(t, k == 0, edge_rule)
        own["ends"] = numbers[own["ends"]]
        own["rigid"] = own["rigid"] + n_springs
        springs.append(own)
        n_springs += len(own["rest"])
        coordinates.append(xy[is_moving])
        static_points.append(xy[~is_moving])
        is_free.append(~t.is_fixed[is_moving])
        surface = t.is_surface_side.any(1)
        is_terrain = (t.codes == FIXED) & (source.name not in placed_at_reset)
        for into, chosen in ((moving_cells, ~is_terrain), (fixed_cells, is_terrain)):
            rows = np.flatnonzero(surface & chosen)
            world_cells = np.stack(
                [source.origin[1] + t.rows - 1 - t.cells[rows, 0], source.origin[0] + t.cells[rows, 1]], axis=1
            )
            kept = t.corner_points[rows]
            sides = numbers[t.edges[t.sides[rows]]]
            object_number = np.full(len(rows), k)
            into.append((numbers[kept], t.is_surface_side[rows], object_number, t.cells[rows], world_cells, sides))
        own_corners = moving_cells[-1][0]
        ranges.append([first, first + count, n_cells, n_cells + len(own_corners)])
        is_anchored.append(count > 0 and bool(t.is_fixed.any()) and source.name not in placed_at_reset)
        first += count
        n_static += t.n_points - count
        n_cells += len(own_corners)

    both = [np.concatenate([np.concatenate([o[i] for o in group]) for group in (moving_cells, fixed_cells)])
            for i in (0, 1, 2, 5)]  # fmt: skip
    uses_start, uses = _uses(both[0], n_moving + n_static)
    ends = np.concatenate([s["ends"] for s in springs]).astype(np.int32)
    pulls_start, pulls, pulls_turn = _pulls(ends, n_moving)
    arrays = {
        "ends": ends,
        "rest": np.concatenate([s["rest"] for s in springs]),
        "constants": np.concatenate([s["constants"] for s in springs]),
        "owners": np.concatenate([s["owners"] for s in springs]).astype(np.int32),
        "owner_constants": np.concatenate([s["owner_constants"] for s in springs]),
        "drivers": np.concatenate([s["drivers"] for s in springs]).astype(np.int32),
        "rigid": np.concatenate([s["rigid"] for s in springs]).astype(np.int32),
        "is_free": np.concatenate(is_free),
        "pulls_start": pulls_start,
        "pulls": pulls,
        "pulls_turn": pulls_turn,
        "objects": np.array(ranges, np.int32),
        "is_anchored": np.array(is_anchored),
        "initial": np.concatenate(coordinates),
        "static_points": np.concatenate(static_points).reshape(-1, 2),
        "corners": both[0].astype(np.int32),
        "sides": both[3].astype(np.int32),
        "is_surface": both[1],
        "cell_object": both[2].astype(np.int32),
        "grid_cells": np.concatenate([o[3] for o in moving_cells]).astype(np.int32),
        "uses_start": uses_start,
        "uses": uses,
        "cell_at": _cell_grid(np.concatenate([o[4] for o in fixed_cells]), n_cells),
    }
    near = [_near_pairs(arrays, k) if anchored else None for k, anchored in enumerate(is_anchored)]
    found = [pairs for pairs in near if pairs is not None]
    arrays["near"] = np.concatenate([np.zeros((0, 2), np.int32), *(p.astype(np.int32) for p, _ in found)])
    arrays["near_gap"] = np.concatenate([np.zeros(0), *(gap for _, gap in found)])
    arrays["near_start"] = np.cumsum([0, *(0 if pairs is None else len(pairs[1]) for pairs in near)]).astype(np.int32)
    layout = Layout(**{name: np.ascontiguousarray(array) for name, array in arrays.items()})
    return Scene(layout, tuple(placed))


def _pulls(ends: np.ndarray, n_points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns for each moving point the springs that begin there in order, then those that end there.

    Forces add up in this order, as in EvoGym.

    Returns:
        Where a point's springs begin, the springs, and where those that end there begin.
    """
    points, springs = ends.T.ravel(), np.tile(np.arange(len(ends)), 2)
    order = np.argsort(points, kind="stable")
    start = np.searchsorted(points[order], np.arange(n_points + 1))
    turn = start[:-1] + np.bincount(ends[:, 0], minlength=n_points)
    return start.astype(np.int32), springs[order].astype(np.int32), turn.astype(np.int32)


def _uses(corners: np.ndarray, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns for each point the surface voxels that have it as a corner, in the order of the voxels."""
    rows = [(int(p), i, corner) for i, four in enumerate(corners) for corner, p in enumerate(four)]
    rows.sort(key=lambda row: row[0])
    start = np.searchsorted([row[0] for row in rows], np.arange(n_points + 1))
    uses = np.array([row[1:] for row in rows], np.int32).reshape(-1, 2)
    return start.astype(np.int32), uses


def _cell_grid(cells: np.ndarray, first: int) -> np.ndarray:
    """Returns the (height, width) grid of fixed surface voxels, numbered from `first`, with a margin of one cell."""
    height, width = (cells.max(0) + 2) if len(cells) else (1, 1)
    grid = np.full((height, width), MISSING, np.int32)
    grid[cells[:, 0], cells[:, 1]] = first + np.arange(len(cells))
    return grid
