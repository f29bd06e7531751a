"""The voxels of each material as a closed mesh in millimetres, extruded out of the plane. Needs `evogymcm[export]`."""

from typing import TYPE_CHECKING, Any

import numpy as np

from evogymcm._extras import load_extra
from evogymcm.fabrication.sheet import Sheet

if TYPE_CHECKING:
    import trimesh

_TL, _TR, _BL, _BR = range(4)
_CORNERS = np.array([(0, 1), (1, 1), (0, 0), (1, 0)])  # x and y of each, in voxels
_SIDES = {(0, 1): (_BR, _TR), (0, -1): (_TL, _BL), (-1, 0): (_TR, _TL), (1, 0): (_BL, _BR)}  # counter-clockwise
_SHARED = {(0, 1): ((_TR, _TL), (_BR, _BL)), (1, 0): ((_BL, _TL), (_BR, _TR))}  # corners of two joined voxels


def load_trimesh() -> Any:
    """Returns trimesh; an ImportError where it is missing."""
    return load_extra("trimesh", "meshes need trimesh, which cannot be imported", "export")


def material_meshes(sheet: Sheet) -> "dict[str, trimesh.Trimesh]":
    """Returns the mesh of each material by its name; joined voxels of one material are one solid.

    Voxels that only touch, at a corner or where they are not joined, have points of their own, so that every mesh is
    closed.

    Raises:
        ImportError: trimesh is missing.
    """
    trimesh = load_trimesh()
    return {
        material.name: trimesh.Trimesh(*_solid(sheet, cells), process=False) for material, cells in sheet.cells.items()
    }


def _solid(sheet: Sheet, cells: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Returns (n, 3) vertices in millimetres and (m, 3) triangles, seen counter-clockwise from outside."""
    number = {cell: i for i, cell in enumerate(cells)}
    joined = {tuple(pair) for pair in sheet.body.connections.T.tolist()}
    parent = list(range(4 * len(cells)))

    def root(corner: int) -> int:
        while parent[corner] != corner:
            corner = parent[corner]
        return corner

    open_sides = []
    for (row, column), i in number.items():
        for (down, right), side in _SIDES.items():
            other = number.get((row + down, column + right))
            pair = tuple(sorted((row * sheet.body.cols + column, (row + down) * sheet.body.cols + column + right)))
            if other is None or pair not in joined:
                open_sides.append([4 * i + corner for corner in side])
            elif (down, right) in _SHARED:
                for own, its in _SHARED[down, right]:
                    parent[root(4 * other + its)] = root(4 * i + own)
    roots = np.array([root(corner) for corner in range(4 * len(cells))])
    used, point = np.unique(roots, return_inverse=True)  # of each corner
    places = [sheet.corner(row, column) for row, column in cells]
    xy = np.repeat(places, 4, axis=0) + sheet.size * np.tile(_CORNERS, (len(cells), 1))
    flat, n = xy[used], len(used)
    vertices = np.concatenate([np.c_[flat, np.zeros(n)], np.c_[flat, np.full(n, sheet.depth)]])
    corners = point.reshape(-1, 4)
    below = corners[:, [_BL, _TL, _TR, _BR]]
    above = corners[:, [_BL, _BR, _TR, _TL]] + n
    ends = point[np.array(open_sides).reshape(-1, 2)]
    walls = np.c_[ends, ends[:, ::-1] + n]
    quads = np.concatenate([below, above, walls])
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
