"""The springs of one object: edges, then diagonals."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import FIXED, MISSING, RIGID, VOXEL
from evogymcm.sim.kernels._jit import kernel
from evogymcm.sim.topology import CACHED, Topology


class ObjectSprings(NamedTuple):
    """S springs of an object; points and voxels are the object's own. All arrays are read-only."""

    ends: np.ndarray  # (S, 2) int32, the points of each spring
    rest: np.ndarray  # (S,) initial length, metres
    constants: np.ndarray  # (S,) spring constants at stiffness 1
    owners: np.ndarray  # (S, 2) int32, voxels that have the spring, MISSING for none
    owner_constants: np.ndarray  # (S, 2) the share of the constant that each owner scales; 0: both scale the whole
    drivers: np.ndarray  # (S, 2) int32, voxels whose actuation sets the length, MISSING for none
    rigid: np.ndarray  # (R,) int32, edges of rigid voxels, in the order in which they are corrected


@kernel
def _count(codes: np.ndarray, edge_owners: np.ndarray, with_fixed: bool) -> tuple[int, int]:
    """Returns the numbers of springs and of rigid voxels."""
    n_springs = n_rigid = 0
    for i in range(codes.shape[0]):
        n_springs += 2 * (with_fixed or codes[i] != FIXED)
        n_rigid += codes[i] == RIGID
    for e in range(edge_owners.shape[0]):
        a, b = edge_owners[e, 0], edge_owners[e, 1]
        n_springs += with_fixed or codes[a] != FIXED or (b != MISSING and codes[b] != FIXED)
    return n_springs, n_rigid


@kernel
def _fill(
    codes: np.ndarray,
    sides: np.ndarray,
    edges: np.ndarray,
    edge_owners: np.ndarray,
    edge_constants: np.ndarray,
    edge_drivers: np.ndarray,
    diagonals: np.ndarray,
    diagonal_constants: np.ndarray,
    shares: np.ndarray,
    with_fixed: bool,
    rests: tuple[float, float],
    numbers: np.ndarray,
    ends: np.ndarray,
    rest: np.ndarray,
    constants: np.ndarray,
    owners: np.ndarray,
    owner_constants: np.ndarray,
    drivers: np.ndarray,
    rigid: np.ndarray,
) -> None:
    """Fills in `ObjectSprings` from what `Topology` holds.

    `shares` are the (e, 2) edge constants of the owners' own types, or (0, 2) where all owners scale the whole one;
    `rests` are the lengths of edges and of diagonals; `numbers` (e,) is filled in with the spring that each edge is.
    """
    has_shares = shares.shape[0] > 0
    s = 0
    for e in range(edges.shape[0]):
        a, b = edge_owners[e, 0], edge_owners[e, 1]
        if not with_fixed and codes[a] == FIXED and (b == MISSING or codes[b] == FIXED):
            continue
        numbers[e] = s
        rest[s], constants[s] = rests[0], edge_constants[e]
        owner_constants[s, 0] = owner_constants[s, 1] = 0.0
        if has_shares:
            n_owners = 1 if b == MISSING else 2
            owner_constants[s, 0], owner_constants[s, 1] = shares[e, 0] / n_owners, shares[e, 1] / n_owners
            constants[s] = owner_constants[s, 0] + owner_constants[s, 1]
        for j in range(2):
            ends[s, j] = edges[e, j]
            owners[s, j] = edge_owners[e, j]
            drivers[s, j] = edge_drivers[e, j]
        s += 1
    r = 0
    for i in range(codes.shape[0]):
        if not with_fixed and codes[i] == FIXED:
            continue
        for d in range(2 * i, 2 * i + 2):
            rest[s], constants[s] = rests[1], diagonal_constants[d]
            ends[s, 0], ends[s, 1] = diagonals[d, 0], diagonals[d, 1]
            owners[s, 0], owners[s, 1] = i, MISSING
            owner_constants[s, 0], owner_constants[s, 1] = diagonal_constants[d] if has_shares else 0.0, 0.0
            drivers[s, 0] = drivers[s, 1] = MISSING
            s += 1
        if codes[i] == RIGID:
            for side in range(4):
                rigid[r] = numbers[sides[i, side]]
                r += 1


@lru_cache(maxsize=CACHED)
def object_springs(t: Topology, edge_rule: str = "mean_factor", with_fixed: bool = False) -> ObjectSprings:
    """Returns an object's springs; the same ones for the same topology.

    Args:
        t: The object's topology.
        edge_rule: "mean_factor" or "mean_stiffness", see `Scenery`.
        with_fixed: Whether to return those too that only fixed voxels have.
    """
    n_springs, n_rigid = _count(t.codes, t.edge_owners, with_fixed)
    result = ObjectSprings(
        ends=np.empty((n_springs, 2), np.int32),
        rest=np.empty(n_springs),
        constants=np.empty(n_springs),
        owners=np.empty((n_springs, 2), np.int32),
        owner_constants=np.empty((n_springs, 2)),
        drivers=np.empty((n_springs, 2), np.int32),
        rigid=np.empty(4 * n_rigid, np.int32),
    )
    _fill(
        t.codes,
        t.sides,
        t.edges,
        t.edge_owners,
        t.edge_constants,
        t.edge_drivers,
        t.diagonals,
        t.diagonal_constants(),
        t.owner_constants() if edge_rule == "mean_stiffness" else np.empty((0, 2)),
        with_fixed,
        (VOXEL, float(np.sqrt(2 * VOXEL**2))),
        np.empty(len(t.edges), np.int32),
        *result,
    )
    for array in result:
        array.flags.writeable = False
    return result
