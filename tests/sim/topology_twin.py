"""A slow twin of the topology and of an object's springs: dictionaries and lists in place of kernels."""

import numpy as np

from evogymcm.sim.constants import EDGE_CONSTANT, FIXED, H_ACT, MISSING, RIGID, V_ACT, VOXEL
from evogymcm.sim.topology import BL, BOTTOM, BR, LEFT, RIGHT, TL, TOP, TR, Topology

STEP = {TOP: (-1, 0), RIGHT: (0, 1), BOTTOM: (1, 0), LEFT: (0, -1)}  # (row, column) to the neighbour on a side
SIDE_CORNERS = {TOP: (TL, TR), RIGHT: (TR, BR), BOTTOM: (BL, BR), LEFT: (TL, BL)}
EDGE_ORDER = (TOP, BOTTOM, LEFT, RIGHT)  # the order in which a voxel makes the edges that it does not share
# A corner's earlier owners: the steps (sides) to a neighbour, and the corner that it is there. Where unjoined voxels
# let them have different points, EvoGym takes the first of these.
EARLIER_OWNERS = {
    TL: (((TOP, LEFT), BR), ((LEFT,), TR), ((TOP,), BL)),
    TR: (((TOP, RIGHT), BL), ((TOP,), BR)),
    BL: (((LEFT,), BR),),
    BR: (),
}


def neighbours_of(grid, connections):
    """Returns for each occupied cell its connected neighbours by side; all side-adjacent ones without connections."""
    rows, columns = grid.shape
    joined = None
    if connections is not None:
        pairs = np.asarray(connections).reshape(2, -1).T
        joined = {frozenset((int(a), int(b))) for a, b in pairs}
    result = {}
    for row, column in np.argwhere(grid != 0).tolist():
        found = result.setdefault((row, column), {})
        for side, (down, right) in STEP.items():
            r, c = row + down, column + right
            if not (0 <= r < rows and 0 <= c < columns) or grid[r, c] == 0:
                continue
            if joined is None or frozenset((row * columns + column, r * columns + c)) in joined:
                found[side] = (r, c)
    return result


def walk(near, cell, sides):
    """Returns the cell reached over connected `sides` (a diagonal in either order of its two steps), or None."""
    for order in {sides, sides[::-1]}:
        at = cell
        for side in order:
            at = near[at].get(side) if at is not None else None
        if at is not None:
            return at
    return None


def slow_topology(grid, connections=None):
    """`topology`, in arrays that may be written to."""
    near = neighbours_of(grid, connections)
    index = {cell: i for i, cell in enumerate(near)}
    codes = np.array([grid[cell] for cell in near], np.int64)
    n = len(index)
    corner_points = np.full((n, 4), MISSING, np.int64)
    sides = np.full((n, 4), MISSING, np.int64)
    made_at, edges, owners = [], [], []
    for cell, i in index.items():
        for corner, earlier in EARLIER_OWNERS.items():
            for steps, theirs in earlier:
                other = walk(near, cell, steps)
                if other is not None and corner_points[i, corner] == MISSING:
                    corner_points[i, corner] = corner_points[index[other], theirs]
            if corner_points[i, corner] == MISSING:
                corner_points[i, corner] = len(made_at)
                made_at.append((*cell, corner))
        for side in EDGE_ORDER:
            shared = {TOP: BOTTOM, LEFT: RIGHT}.get(side)
            if shared is not None and side in near[cell]:
                edge = int(sides[index[near[cell][side]], shared])
                owners[edge].append(i)
            else:
                edge = len(edges)
                a, b = SIDE_CORNERS[side]
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
    return Topology(
        rows=grid.shape[0],
        columns=grid.shape[1],
        cells=np.array(list(near), np.int64).reshape(-1, 2),
        codes=codes,
        corner_points=corner_points,
        sides=sides,
        is_surface_side=np.array([[s not in near[cell] for s in STEP] for cell in near], bool).reshape(-1, 4),
        made_at=np.array(made_at, np.int64).reshape(-1, 3),
        is_fixed=is_fixed,
        edges=np.array(edges, np.int64).reshape(-1, 2),
        edge_owners=np.array([[*o, MISSING][:2] for o in owners], np.int64).reshape(-1, 2),
        edge_constants=constants,
        edge_drivers=drivers,
        diagonals=corner_points[:, [TR, BL, TL, BR]].reshape(-1, 2),
    )


def slow_points(t, x, y):
    """`Topology.points`, its operations in EvoGym's order."""
    row, column, corner = t.made_at.T
    right = column + ((corner == TR) | (corner == BR))
    down = row + ((corner == BL) | (corner == BR))
    px = x * VOXEL + right * VOXEL
    py = (y * VOXEL + t.rows * VOXEL) - down * VOXEL
    return np.stack([px, py], axis=1)


def slow_springs(t, edge_rule, with_fixed):
    """Returns the object's springs (edges, then diagonals), without those of fixed voxels only unless asked for."""
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
        "owners": owners,
        "constants": constants,
        "owner_constants": shares,
        "drivers": np.concatenate([t.edge_drivers, none]),
    }
    keep = soft.any(1) | with_fixed
    numbers = np.cumsum(keep) - 1  # old spring number -> new one
    rigid = t.sides[t.codes == RIGID].reshape(-1)
    return {key: value[keep] for key, value in result.items()} | {"rigid": numbers[rigid]}
