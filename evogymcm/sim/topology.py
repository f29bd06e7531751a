"""From a voxel grid to points, springs and surfaces.

The order of points and springs is EvoGym's: it is the order of the point observations, and the order in which rigid
voxels are corrected. Everything here is computed once per object and does not depend on where the object stands.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from evogymcm.sim.constants import DIAGONAL_CONSTANT, EDGE_CONSTANT, MISSING, N_CODES, VOXEL
from evogymcm.sim.kernels.numbering import BL as BL
from evogymcm.sim.kernels.numbering import BOTTOM as BOTTOM
from evogymcm.sim.kernels.numbering import BR as BR
from evogymcm.sim.kernels.numbering import LEFT as LEFT
from evogymcm.sim.kernels.numbering import RIGHT as RIGHT
from evogymcm.sim.kernels.numbering import TL as TL
from evogymcm.sim.kernels.numbering import TOP as TOP
from evogymcm.sim.kernels.numbering import TR as TR
from evogymcm.sim.kernels.numbering import count, join, link, number, place

CACHED = 512  # topologies kept: those of the worlds and of a population, but not of all bodies that a search makes


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
        points = np.empty((self.n_points, 2))
        place(self.made_at, x * VOXEL, y * VOXEL + self.rows * VOXEL, VOXEL, points)
        return points

    def owner_constants(self) -> np.ndarray:
        """Returns (e, 2) the edge constant of each owner's own type, 0 where there is no owner."""
        constants = EDGE_CONSTANT[self.codes[self.edge_owners]]
        return np.where(self.edge_owners == MISSING, 0.0, constants)

    def diagonal_constants(self) -> np.ndarray:
        """Returns (2c,) constants of the diagonal springs."""
        return np.repeat(DIAGONAL_CONSTANT[self.codes], 2)


@lru_cache(maxsize=CACHED)
def _build(grid_bytes: bytes, shape: tuple[int, int], connection_bytes: bytes | None) -> Topology:
    grid = np.frombuffer(grid_bytes, np.int8).reshape(shape)
    pairs = np.frombuffer(connection_bytes or b"", np.int64).reshape(2, -1)
    links, numbers = np.empty(shape, np.uint8), np.empty(shape, np.int32)
    link(grid, connection_bytes is None, pairs, links)
    n_cells, n_points, n_edges = count(grid, links)
    if n_cells == MISSING:
        raise ValueError(f"grid: got cell codes {np.unique(grid).tolist()}, allowed are 0 to {N_CODES - 1}")
    voxels = {
        "cells": np.empty((n_cells, 2), np.int64),
        "codes": np.empty(n_cells, np.int64),
        "corner_points": np.empty((n_cells, 4), np.int64),
        "is_surface_side": np.empty((n_cells, 4), np.bool_),
    }
    points = {
        "made_at": np.empty((n_points, 3), np.int64),
        "is_fixed": np.empty(n_points, np.bool_),
        "diagonals": np.empty((2 * n_cells, 2), np.int64),
    }
    edges = {
        "sides": np.empty((n_cells, 4), np.int64),
        "edges": np.empty((n_edges, 2), np.int64),
        "edge_owners": np.empty((n_edges, 2), np.int64),
        "edge_constants": np.empty(n_edges),
        "edge_drivers": np.empty((n_edges, 2), np.int64),
    }
    number(grid, links, numbers, *voxels.values(), *points.values())
    join(numbers, *voxels.values(), EDGE_CONSTANT, *edges.values())
    arrays = voxels | points | edges
    for array in arrays.values():
        array.flags.writeable = False
    return Topology(rows=shape[0], columns=shape[1], **arrays)


def topology(grid: np.ndarray, connections: np.ndarray | None = None) -> Topology:
    """Returns the topology of a (rows, columns) grid of voxel codes; equal grids share one object.

    Args:
        grid: Voxel codes 0 to 5, row 0 on top.
        connections: (2, k) flat indices of joined cells; None joins all side-adjacent occupied cells.
    """
    grid = np.ascontiguousarray(grid, np.int8)
    joined = None if connections is None else np.ascontiguousarray(connections, np.int64).tobytes()
    return _build(grid.tobytes(), (grid.shape[0], grid.shape[1]), joined)
