"""What is drawn of a world, and from where: voxels as squares and quadrilaterals; a camera that follows the robot."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from evogymcm.envs.core import TaskEngine
from evogymcm.sim.constants import FIXED, H_ACT, V_ACT, VOXEL
from evogymcm.sim.topology import BL, BR, TL, TR

_AROUND = [TL, TR, BR, BL]  # corners of a voxel in the order of a walk around it; its sides are then:
_ZOOM = 1.2  # the camera sees this times the padded box, as EvoGym's
_BELOW = 0.25  # metres below the implicit floor that it shows at most
_FOLLOWS = 0.15  # of the way to its target that the camera goes in an env-step


@dataclass(frozen=True, eq=False)
class Parts:
    """What of a world is drawn. Sides are top, right, bottom, left.

    Attributes:
        squares: (f, 2) lower-left world cells of the voxels that never move.
        square_sides: (f, 4) which of their sides are surface.
        corners: (m, 4) numbers of the other voxels' corners, around each; the robot's come last.
        codes: (m,) voxel codes.
        sides: (m, 4) which of their sides are surface.
        first_robot: The robot's first row.
        cells: (m - first_robot,) the robot's voxels in the padded grid.
        followed: Numbers of the points that the camera follows.
    """

    squares: np.ndarray
    square_sides: np.ndarray
    corners: np.ndarray
    codes: np.ndarray
    sides: np.ndarray
    first_robot: int
    cells: np.ndarray
    followed: np.ndarray


def make_parts(engine: TaskEngine, world: int) -> Parts:
    """Returns what is drawn of a world. Points are numbered as in `Simulator.points`."""
    squares, square_sides, corners, codes, sides = [], [], [], [], []
    objects = engine.simulator.objects(world)
    starts = np.cumsum([0, *(len(placed.places) for placed in objects)])
    robot = objects[0]
    for start, placed in [*zip(starts[1:], objects[1:], strict=False), (0, robot)]:
        t = placed.topology
        is_square = (t.codes == FIXED) & (placed.name not in engine.task.moves_at_reset)
        rows, columns = t.cells[is_square].T
        squares.append(np.stack([columns, t.rows - 1 - rows], axis=1) + placed.origin)
        square_sides.append(t.is_surface_side[is_square])
        corners.append(start + t.corner_points[~is_square][:, _AROUND])
        codes.append(t.codes[~is_square])
        sides.append(t.is_surface_side[~is_square])
    cells = robot.topology.cells
    followed = [k for k, placed in enumerate(objects) if k == 0 or placed.name in engine.task.watches]
    return Parts(
        np.concatenate(squares),
        np.concatenate(square_sides),
        np.concatenate(corners),
        np.concatenate(codes),
        np.concatenate(sides),
        sum(len(c) for c in codes) - len(cells),
        cells[:, 0] * engine.grid_shape[1] + cells[:, 1],
        np.concatenate([np.arange(starts[k], starts[k + 1]) for k in followed]),
    )


def stretches(quads: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Returns (m,) mean lengths of the sides that actuators drive, relative to rest; 1 for other voxels.

    Args:
        quads: (m, 4, 2) corners in metres, around each voxel.
        codes: (m,) voxel codes.
    """
    lengths = np.hypot(*(np.roll(quads, -1, axis=1) - quads).transpose(2, 0, 1)) / VOXEL  # top, right, bottom, left
    across, up = (lengths[:, 0] + lengths[:, 2]) / 2, (lengths[:, 1] + lengths[:, 3]) / 2
    return np.where(codes == H_ACT, across, np.where(codes == V_ACT, up, 1.0))


class View(NamedTuple):
    """The part of the world in the picture, metres."""

    x: float  # of its middle
    y: float
    height: float


class Camera:
    """Follows points, env-step by env-step, with some delay.

    Args:
        padding: Voxels of surroundings at each side, and above and below.
    """

    def __init__(self, padding: tuple[int, int]) -> None:
        self._padding = VOXEL * np.array(padding)
        self._step = -1
        self._view = View(0.0, 0.0, 1.0)

    def follow(self, points: np.ndarray, step: int, aspect: float) -> View:
        """Returns the view of (2, n) points at an env-step of the episode; an earlier step than the last starts anew.

        Args:
            points: Metres.
            step: The env-step.
            aspect: Width of the picture over its height.
        """
        low, high = points.min(1), points.max(1)
        width, height = (_ZOOM * (high - low + 2 * self._padding)).tolist()
        x, y = ((low + high) / 2).tolist()
        height = max(height, width / aspect)
        target = View(x, max(y, height / 2 - _BELOW), height)
        part = 1.0 if self._step < 0 or step < self._step else 1.0 - (1.0 - _FOLLOWS) ** (step - self._step)
        self._view = View(*(was + part * (to - was) for was, to in zip(self._view, target, strict=True)))
        self._step = step
        return self._view
