"""From a voxel grid to points, springs and surfaces.

The order of points and springs is EvoGym's: it is the order of the point observations, and the order in which rigid
voxels are corrected. Everything here is computed once per object and does not depend on where the object stands.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from evogymcm.sim.constants import DIAGONAL_CONSTANT, EDGE_CONSTANT, FIXED, H_ACT, MISSING, RIGID, V_ACT, VOXEL

TL, TR, BL, BR = range(4)  # corners of a voxel, in the order in which points are made
TOP, RIGHT, BOTTOM, LEFT = range(4)  # sides of a voxel, in the order in which contacts and rigid limits visit them
_STEP = {TOP: (-1, 0), RIGHT: (0, 1), BOTTOM: (1, 0), LEFT: (0, -1)}  # (row, column) to the neighbour on a side
_SIDE_CORNERS = {TOP: (TL, TR), RIGHT: (TR, BR), BOTTOM: (BL, BR), LEFT: (TL, BL)}
_EDGE_ORDER = (TOP, BOTTOM, LEFT, RIGHT)  # the order in which a voxel makes the edges that it does not share
# A corner's earlier owners: the steps (sides) to a neighbour, and the corner that it is there. Where unjoined voxels
# let them have different points, EvoGym takes the first of these.
_EARLIER_OWNERS = {
    TL: (((TOP, LEFT), BR), ((LEFT,), TR), ((TOP,), BL)),
    TR: (((TOP, RIGHT), BL), ((TOP,), BR)),
    BL: (((LEFT,), BR),),
    BR: (),
}


@dataclass(frozen=True, eq=False)
class Topology:
    """Points, springs and surfaces of one object; n points, c voxels, e edges; indices are the object's own.

    Attributes:
        cells: (c, 2) row and column of the occupied cells, row-major.
        codes: (c,) voxel codes.
        corner_points: (c, 4) points at TL, TR, BL, BR.
        sides: (c, 4) edges on the top, right, bottom, left.
        is_surface_side: (c, 4) whether the voxel has no neighbour on that side.
        made_at: (n, 3) row, column and corner of the voxel that made each point.
        is_fixed: (n,) whether the point belongs to a fixed voxel.
        edges: (e, 2) points of the edges. Those of surface sides have the outside on their left.
        edge_owners: (e, 2) voxels that have the edge, MISSING for none.
        edge_constants: (e,) base constants of the edges: the last soft or actuator owner's, else the rigid one.
        edge_drivers: (e, 2) actuators (voxels) that set the edge's length, MISSING for none.
        diagonals: (2c, 2) points of the diagonal springs; voxel i has 2i and 2i + 1.
    """

    rows: int
    columns: int
    cells: np.ndarray
    codes: np.ndarray
    corner_points: np.ndarray
    sides: np.ndarray
    is_surface_side: np.ndarray
    made_at: np.ndarray
    is_fixed: np.ndarray
    edges: np.ndarray
    edge_owners: np.ndarray
    edge_constants: np.ndarray
    edge_drivers: np.ndarray
    diagonals: np.ndarray

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.made_at)

    @property
    def n_cells(self) -> int:
        """Number of voxels."""
        return len(self.cells)

    def points(self, x: int, y: int) -> np.ndarray:
        """Returns (n, 2) initial coordinates in metres, with the lower-left cell of the grid at world cell (x, y).

        The operations and their order are EvoGym's: robots start corner on corner with the terrain, so the last bit
        decides which contacts exist in the first substep.
        """
        row, column, corner = self.made_at.T
        right = column + ((corner == TR) | (corner == BR))
        down = row + ((corner == BL) | (corner == BR))
        px = x * VOXEL + right * VOXEL
        py = (y * VOXEL + self.rows * VOXEL) - down * VOXEL
        return np.stack([px, py], axis=1)

    def owner_constants(self) -> np.ndarray:
        """Returns (e, 2) the edge constant of each owner's own type, 0 where there is no owner."""
        constants = EDGE_CONSTANT[self.codes[self.edge_owners]]
        return np.where(self.edge_owners == MISSING, 0.0, constants)

    def diagonal_constants(self) -> np.ndarray:
        """Returns (2c,) constants of the diagonal springs."""
        return np.repeat(DIAGONAL_CONSTANT[self.codes], 2)


def _neighbours(grid: np.ndarray, connections: np.ndarray | None) -> dict[tuple[int, int], dict[int, tuple[int, int]]]:
    """Returns for each occupied cell its connected neighbours by side; all side-adjacent ones without connections."""
    rows, columns = grid.shape
    joined = None
    if connections is not None:
        pairs = np.asarray(connections).reshape(2, -1).T
        joined = {frozenset((int(a), int(b))) for a, b in pairs}
    result: dict[tuple[int, int], dict[int, tuple[int, int]]] = {}
    for row, column in np.argwhere(grid != 0).tolist():
        found = result.setdefault((row, column), {})
        for side, (down, right) in _STEP.items():
            r, c = row + down, column + right
            if not (0 <= r < rows and 0 <= c < columns) or grid[r, c] == 0:
                continue
            if joined is None or frozenset((row * columns + column, r * columns + c)) in joined:
                found[side] = (r, c)
    return result


def _walk(near: dict, cell: tuple[int, int], sides: tuple[int, ...]) -> tuple[int, int] | None:
    """Returns the cell reached over connected `sides` (a diagonal in either order of its two steps), or None."""
    for order in {sides, sides[::-1]}:
        at: tuple[int, int] | None = cell
        for side in order:
            at = near[at].get(side) if at is not None else None
        if at is not None:
            return at
    return None


@lru_cache(maxsize=4096)
def _build(grid_bytes: bytes, shape: tuple[int, int], connection_bytes: bytes | None) -> Topology:
    grid = np.frombuffer(grid_bytes, np.int8).reshape(shape)
    connections = None if connection_bytes is None else np.frombuffer(connection_bytes, np.int64)
    near = _neighbours(grid, connections)
    index = {cell: i for i, cell in enumerate(near)}
    codes = np.array([grid[cell] for cell in near], np.int64)
    n = len(index)
    corner_points = np.full((n, 4), MISSING, np.int64)
    sides = np.full((n, 4), MISSING, np.int64)
    made_at: list[tuple[int, int, int]] = []
    edges: list[tuple[int, int]] = []
    owners: list[list[int]] = []
    for cell, i in index.items():
        for corner, earlier in _EARLIER_OWNERS.items():
            for steps, theirs in earlier:
                other = _walk(near, cell, steps)
                if other is not None and corner_points[i, corner] == MISSING:
                    corner_points[i, corner] = corner_points[index[other], theirs]
            if corner_points[i, corner] == MISSING:
                corner_points[i, corner] = len(made_at)
                made_at.append((*cell, corner))
        for side in _EDGE_ORDER:
            shared = {TOP: BOTTOM, LEFT: RIGHT}.get(side)
            if shared is not None and side in near[cell]:
                edge = int(sides[index[near[cell][side]], shared])
                owners[edge].append(i)
            else:
                edge = len(edges)
                a, b = _SIDE_CORNERS[side]
                edges.append((int(corner_points[i, a]), int(corner_points[i, b])))
                owners.append([i])
            sides[i, side] = edge

    for cell, i in index.items():
        for side in (BOTTOM, LEFT):
            if side not in near[cell]:
                a, b = edges[sides[i, side]]
                edges[sides[i, side]] = (b, a)
    constants = np.full(len(edges), EDGE_CONSTANT[RIGID])
    is_fixed = np.zeros(len(made_at), bool)
    for i, code in enumerate(codes):
        if code not in (RIGID, FIXED):
            constants[sides[i]] = EDGE_CONSTANT[code]
        if code == FIXED:
            is_fixed[corner_points[i]] = True
    drives = {H_ACT: (TOP, BOTTOM), V_ACT: (LEFT, RIGHT)}
    drivers = np.full((len(edges), 2), MISSING, np.int64)
    for i, code in enumerate(codes):
        for side in drives.get(int(code), ()):
            edge = sides[i, side]
            drivers[edge, int(drivers[edge, 0] != MISSING)] = i
    topology = Topology(
        rows=shape[0],
        columns=shape[1],
        cells=np.array(list(near), np.int64).reshape(-1, 2),
        codes=codes,
        corner_points=corner_points,
        sides=sides,
        is_surface_side=np.array([[s not in near[cell] for s in _STEP] for cell in near], bool).reshape(-1, 4),
        made_at=np.array(made_at, np.int64).reshape(-1, 3),
        is_fixed=is_fixed,
        edges=np.array(edges, np.int64).reshape(-1, 2),
        edge_owners=np.array([[*o, MISSING][:2] for o in owners], np.int64).reshape(-1, 2),
        edge_constants=constants,
        edge_drivers=drivers,
        diagonals=corner_points[:, [TR, BL, TL, BR]].reshape(-1, 2),
    )
    for value in vars(topology).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return topology


def topology(grid: np.ndarray, connections: np.ndarray | None = None) -> Topology:
    """Returns the topology of a (rows, columns) grid of voxel codes; equal grids share one object.

    Args:
        grid: Voxel codes 0 to 5, row 0 on top.
        connections: (2, k) flat indices of joined cells; None joins all side-adjacent occupied cells.
    """
    grid = np.ascontiguousarray(grid, np.int8)
    joined = None if connections is None else np.ascontiguousarray(connections, np.int64).tobytes()
    return _build(grid.tobytes(), (grid.shape[0], grid.shape[1]), joined)
