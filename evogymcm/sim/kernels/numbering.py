"""The kernels behind `topology`: a grid of voxels and its links, walked row by row, as EvoGym makes objects.

Links are a byte for each cell, with a bit for each side on which its voxel has a connected neighbour. Voxels, points
and edges get their numbers in the order in which the walk comes to them.
"""

import numpy as np

from evogymcm.sim.constants import EMPTY, FIXED, H_ACT, MISSING, N_CODES, RIGID, SOFT, V_ACT
from evogymcm.sim.kernels._jit import inlined, kernel

TL, TR, BL, BR = range(4)  # corners of a voxel, in the order in which points are made
TOP, RIGHT, BOTTOM, LEFT = range(4)  # sides of a voxel, in the order in which contacts and rigid limits visit them


@kernel
def place(made_at: np.ndarray, left: float, top: float, voxel: float, points: np.ndarray) -> None:
    """Sets the coordinates of points from the grid's left and top."""
    for p in range(made_at.shape[0]):
        corner = made_at[p, 2]
        right = made_at[p, 1] + (corner in (TR, BR))
        down = made_at[p, 0] + (corner in (BL, BR))
        points[p, 0] = left + right * voxel
        points[p, 1] = top - down * voxel


@kernel
def link(grid: np.ndarray, joins_all: bool, pairs: np.ndarray, links: np.ndarray) -> None:
    """Sets in `links` (rows, columns), for each cell, a bit for each side on which it has a connected neighbour.

    Pairs of cells that are not side-adjacent voxels join nothing.
    """
    rows, columns = grid.shape
    for row in range(rows):
        for column in range(columns):
            links[row, column] = 0
    for k in range(2 * rows * columns if joins_all else pairs.shape[1]):
        if joins_all:  # each cell with the one on its right, and with the one below
            first = k >> 1
            second = first + (columns if k & 1 else 1)
        else:
            first, second = min(pairs[0, k], pairs[1, k]), max(pairs[0, k], pairs[1, k])
        if first < 0 or second >= rows * columns:
            continue
        row, column = first // columns, first % columns
        if second == first + 1 and column + 1 < columns:
            there, here, back = (row, column + 1), RIGHT, LEFT
        elif second == first + columns:
            there, here, back = (row + 1, column), BOTTOM, TOP
        else:
            continue
        if grid[row, column] != EMPTY and grid[there] != EMPTY:
            links[row, column] |= 1 << here
            links[there] |= 1 << back


@inlined
def _is_linked(links: np.ndarray, row: int, column: int, side: int) -> bool:
    return (links[row, column] >> side) & 1 != 0


@inlined
def _first_owner(links: np.ndarray, row: int, column: int, corner: int) -> tuple[int, int, int]:
    """Returns the earlier voxel whose point a voxel's corner is, and the corner that it is there; itself if it is new.

    Where unjoined voxels let the earlier ones have different points there, EvoGym takes the first in this order.
    """
    above, left = _is_linked(links, row, column, TOP), _is_linked(links, row, column, LEFT)
    if corner == TL:
        if above and _is_linked(links, row - 1, column, LEFT):
            return row - 1, column - 1, BR
        if left and _is_linked(links, row, column - 1, TOP):
            return row - 1, column - 1, BR
        if left:
            return row, column - 1, TR
        if above:
            return row - 1, column, BL
    elif corner == TR:
        if above and _is_linked(links, row - 1, column, RIGHT):
            return row - 1, column + 1, BL
        if _is_linked(links, row, column, RIGHT) and _is_linked(links, row, column + 1, TOP):
            return row - 1, column + 1, BL
        if above:
            return row - 1, column, BR
    elif corner == BL and left:
        return row, column - 1, BR
    return row, column, corner


@kernel
def count(grid: np.ndarray, links: np.ndarray) -> tuple[int, int, int]:
    """Returns the numbers of voxels, points and edges; MISSING voxels where a code is none."""
    n_cells = n_points = n_edges = 0
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            if grid[row, column] < 0 or grid[row, column] >= N_CODES:
                return MISSING, 0, 0
            if grid[row, column] == EMPTY:
                continue
            n_cells += 1
            for corner in range(4):
                n_points += _first_owner(links, row, column, corner) == (row, column, corner)
            n_edges += 4 - _is_linked(links, row, column, TOP) - _is_linked(links, row, column, LEFT)
    return n_cells, n_points, n_edges


@kernel
def number(
    grid: np.ndarray,
    links: np.ndarray,
    numbers: np.ndarray,
    cells: np.ndarray,
    codes: np.ndarray,
    corner_points: np.ndarray,
    is_surface_side: np.ndarray,
    made_at: np.ndarray,
    is_fixed: np.ndarray,
    diagonals: np.ndarray,
) -> None:
    """Fills in what `Topology` holds of voxels and points, and in `numbers` the voxel at each occupied cell."""
    i = n = 0
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            code = grid[row, column]
            if code == EMPTY:
                continue
            numbers[row, column] = i
            cells[i, 0], cells[i, 1], codes[i] = row, column, code
            for corner in range(4):
                r, c, theirs = _first_owner(links, row, column, corner)
                if (r, c, theirs) == (row, column, corner):
                    corner_points[i, corner] = n
                    made_at[n, 0], made_at[n, 1], made_at[n, 2] = row, column, corner
                    is_fixed[n] = False
                    n += 1
                else:
                    corner_points[i, corner] = corner_points[numbers[r, c], theirs]
                if code == FIXED:
                    is_fixed[corner_points[i, corner]] = True
            for side in range(4):
                is_surface_side[i, side] = not _is_linked(links, row, column, side)
            diagonals[2 * i, 0], diagonals[2 * i, 1] = corner_points[i, TR], corner_points[i, BL]
            diagonals[2 * i + 1, 0], diagonals[2 * i + 1, 1] = corner_points[i, TL], corner_points[i, BR]
            i += 1


@inlined
def _ends(side: int, is_surface: bool) -> tuple[int, int]:
    """Returns the corners at which an edge begins and ends; those of surface sides have the outside on their left."""
    if side == TOP:
        return TL, TR
    if side == RIGHT:
        return TR, BR
    if side == BOTTOM:
        return (BR, BL) if is_surface else (BL, BR)
    return (BL, TL) if is_surface else (TL, BL)


@kernel
def join(
    numbers: np.ndarray,
    cells: np.ndarray,
    codes: np.ndarray,
    corner_points: np.ndarray,
    is_surface_side: np.ndarray,
    constant_of: np.ndarray,
    sides: np.ndarray,
    edges: np.ndarray,
    owners: np.ndarray,
    constants: np.ndarray,
    drivers: np.ndarray,
) -> None:
    """Fills in what `Topology` holds of edges; `constant_of` (N_CODES,) are their constants by voxel code."""
    e = 0
    for i in range(cells.shape[0]):
        for side in (TOP, BOTTOM, LEFT, RIGHT):  # the order in which a voxel makes the edges that it does not share
            is_surface = is_surface_side[i, side]
            if side == TOP and not is_surface:
                edge = sides[numbers[cells[i, 0] - 1, cells[i, 1]], BOTTOM]
                owners[edge, 1] = i
            elif side == LEFT and not is_surface:
                edge = sides[i - 1, RIGHT]
                owners[edge, 1] = i
            else:
                edge = e
                e += 1
                a, b = _ends(side, is_surface)
                edges[edge, 0], edges[edge, 1] = corner_points[i, a], corner_points[i, b]
                owners[edge, 0], owners[edge, 1] = i, MISSING
                drivers[edge, 0] = drivers[edge, 1] = MISSING
                constants[edge] = constant_of[RIGID]
            sides[i, side] = edge
            if SOFT <= codes[i] <= V_ACT:
                constants[edge] = constant_of[codes[i]]
            if codes[i] == (H_ACT if side in (TOP, BOTTOM) else V_ACT):
                drivers[edge, 0 if drivers[edge, 0] == MISSING else 1] = i
