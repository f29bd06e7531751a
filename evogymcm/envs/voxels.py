"""Per-voxel observations: what each voxel of each body is and senses, on the padded grid.

Types of a voxel: the type codes (those of a body's grid) of itself and of its connected neighbours above, right, below
and left; 0 for none. They never change.

Features, in order: the positions of its corners relative to the COM (8: x of TL, TR, BL, BR, then y; metres), their
velocities relative to the COM's (8), its present stiffness, its last actuation, and its place in its own body array (2:
row and column, from -1 to 1). Cells without a voxel hold zeros.
"""

import numpy as np

from evogymcm.body import EMPTY, Body
from evogymcm.sim import lanes
from evogymcm.sim._jit import kernel
from evogymcm.sim.constants import MISSING
from evogymcm.sim.readings import COM, VELOCITY
from evogymcm.sim.springs import VX, VY, X, Y
from evogymcm.sim.topology import Topology

N_TYPES = 5  # codes of a body's grid, empty included
POSITIONS = 0
VELOCITIES = POSITIONS + 8
STIFFNESS = VELOCITIES + 8
ACTUATION = STIFFNESS + 1
PLACE = ACTUATION + 1
N_FEATURES = PLACE + 2
# Rows and columns from a voxel's place in a grid with a margin of one cell: itself, above, right, below, left.
_STEPS = 1 + np.array([[0, -1, 0, 1, 0], [0, 0, 1, 0, -1]])
N_SIDES = _STEPS.shape[1]


def voxel_types(body: Body, topology: Topology, grid_shape: tuple[int, int]) -> np.ndarray:
    """Returns (V, N_SIDES) uint8: the type codes of a body's voxels and of their connected neighbours."""
    types = np.zeros((*grid_shape, N_SIDES), np.uint8)
    padded = np.zeros((body.rows + 2, body.cols + 2), np.uint8)
    padded[1:-1, 1:-1] = body.grid
    rows, columns = topology.cells[:, :1], topology.cells[:, 1:]
    near = padded[rows + _STEPS[0], columns + _STEPS[1]]
    near[:, 1:][topology.is_surface_side] = EMPTY  # those sides are in the same order: top, right, bottom, left
    types[rows[:, 0], columns[:, 0]] = near
    return types.reshape(-1, N_SIDES)


def voxel_template(body: Body, topology: Topology, grid_shape: tuple[int, int]) -> np.ndarray:
    """Returns (V, N_FEATURES) float32: a body's features that never change, zero elsewhere."""
    features = np.zeros((*grid_shape, N_FEATURES), np.float32)
    last = np.array(body.shape) - 1
    places = 2 * topology.cells / np.maximum(last, 1) - (last > 0)
    features[topology.cells[:, 0], topology.cells[:, 1], PLACE:] = places
    return features.reshape(-1, N_FEATURES)


@kernel
def fill_voxels(
    points: np.ndarray,
    worlds: np.ndarray,
    cells: np.ndarray,
    corner_points: np.ndarray,
    columns: int,
    numbers: np.ndarray,
    stiffness: np.ndarray,
    actuation: np.ndarray,
    template: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fills in all features of one block's worlds.

    Args:
        points: (N_POINT_ROWS, P, 8) state.
        worlds: (8,) world of each lane, MISSING for none.
        cells: (c, 2) row and column of the robot's voxels.
        corner_points: (c, 4) their points.
        columns: Of the padded grid.
        numbers: (N, N_NUMBERS) the robots' readings.
        stiffness: (N, V) present stiffness.
        actuation: (N, V) last actuation.
        template: (N, V * N_FEATURES) float32 features that never change.
        out: (N, V * N_FEATURES) float32.
    """
    for lane in range(lanes.N_LANES):
        world = worlds[lane]
        if world == MISSING:
            continue
        cx, cy = numbers[world, COM], numbers[world, COM + 1]
        ux, uy = numbers[world, VELOCITY], numbers[world, VELOCITY + 1]
        for k in range(out.shape[1]):
            out[world, k] = template[world, k]
        for i in range(cells.shape[0]):
            v = cells[i, 0] * columns + cells[i, 1]
            at = v * N_FEATURES
            for k in range(4):
                p = corner_points[i, k]
                out[world, at + POSITIONS + k] = points[X, p, lane] - cx
                out[world, at + POSITIONS + 4 + k] = points[Y, p, lane] - cy
                out[world, at + VELOCITIES + k] = points[VX, p, lane] - ux
                out[world, at + VELOCITIES + 4 + k] = points[VY, p, lane] - uy
            out[world, at + STIFFNESS] = stiffness[world, v]
            out[world, at + ACTUATION] = actuation[world, v]
