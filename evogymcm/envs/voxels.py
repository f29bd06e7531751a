"""Per-voxel observations: what each voxel of each body is and senses, on the padded grid.

Types of a voxel: the type codes (those of a body's grid) of itself and of its connected neighbours above, right, below
and left; 0 for none. They stay the same in an episode.

Features, in order: the positions of its corners relative to the COM (8: x of TL, TR, BL, BR, then y; metres), their
velocities relative to the COM's (8), its current stiffness, its last actuation, and its place in its own body array (2:
row and column, from -1 to 1). Cells without a voxel contain zeros.
"""

import numpy as np

from evogymcm.body import H_ACT, V_ACT
from evogymcm.sim.kernels._jit import kernel
from evogymcm.sim.kernels.readings import ACTUATION as ACTUATION
from evogymcm.sim.kernels.readings import N_FEATURES as N_FEATURES
from evogymcm.sim.kernels.readings import PLACE as PLACE
from evogymcm.sim.kernels.readings import POSITIONS as POSITIONS
from evogymcm.sim.kernels.readings import STIFFNESS as STIFFNESS
from evogymcm.sim.kernels.readings import VELOCITIES as VELOCITIES

N_TYPES = 5  # codes of a body's grid, empty included
# Rows and columns to the neighbours above, right, below, left, in the order of a voxel's sides.
_STEPS = ((-1, 0), (0, 1), (1, 0), (0, -1))
N_SIDES = 1 + len(_STEPS)


@kernel
def describe(
    grid: np.ndarray,
    cells: np.ndarray,
    is_surface_side: np.ndarray,
    columns: int,
    occupancy: np.ndarray,
    actuators: np.ndarray,
    types: np.ndarray,
    template: np.ndarray,
) -> None:
    """Sets what is known of a body beforehand; cells without a voxel get zeros.

    Args:
        grid: (rows, columns) the codes of the body, in the upper left corner of the padded grid.
        cells: (voxels, 2) row and column of each voxel, see `Topology`.
        is_surface_side: (voxels, 4) bool, which sides touch no other voxel, see `Topology`.
        columns: Of the padded grid, V cells.
        occupancy: (V,) bool.
        actuators: (V,) bool.
        types: (V, N_SIDES) uint8, the type codes of voxels and of their connected neighbours.
        template: (V, N_FEATURES) float32, the features that stay the same.
    """
    occupancy[:], actuators[:], types[:], template[:] = False, False, 0, 0.0
    rows, own_columns = grid.shape
    for voxel in range(cells.shape[0]):
        row, column = cells[voxel, 0], cells[voxel, 1]
        code, at = grid[row, column], row * columns + column
        occupancy[at], actuators[at] = True, code in (H_ACT, V_ACT)
        types[at, 0] = code
        for side in range(N_SIDES - 1):
            if not is_surface_side[voxel, side]:
                types[at, 1 + side] = grid[row + _STEPS[side][0], column + _STEPS[side][1]]
        template[at, PLACE] = 2 * row / max(rows - 1, 1) - (rows > 1)
        template[at, PLACE + 1] = 2 * column / max(own_columns - 1, 1) - (own_columns > 1)
