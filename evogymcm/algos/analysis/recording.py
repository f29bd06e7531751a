"""One deterministic episode, voxel by voxel: actuation, stiffness and contact with the ground in every env-step."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evogymcm.algos.learning.playing import Gait, play
from evogymcm.envs.engines import engine_of

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase

CONTACT_TOLERANCE = 0.002  # metres above a surface that still count as touching it; at rest it is less than 0.001
CONTACT_DEPTH = 0.02  # metres below it that do: deeper points came in through another side, such as a wall


@dataclass(frozen=True, eq=False)
class Recording:
    """Time series of T env-steps and C voxels, row-major.

    Attributes:
        task: id of the task.
        cells: (C, 2) row and column of each voxel in the body's array.
        is_actuator: (C,) bool.
        actuation: (T, C) target lengths as applied in each env-step, NaN for voxels that are not actuators.
        stiffness: (T, C) stiffness as applied in each env-step.
        contact: (T, C) bool, whether the voxel touched the ground at the end of the env-step, see `GroundContact`.
        score: score of the episode, as `evaluate` counts it.

    Raises:
        ValueError: For arrays whose shapes do not fit together.
    """

    task: str
    cells: NDArray[np.int64]
    is_actuator: NDArray[np.bool_]
    actuation: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    contact: NDArray[np.bool_]
    score: float

    def __post_init__(self) -> None:
        steps, voxels = self.stiffness.shape
        expected = {"cells": (voxels, 2), "is_actuator": (voxels,)}
        expected |= dict.fromkeys(("actuation", "contact"), (steps, voxels))
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name}: got shape {getattr(self, name).shape}, expected {shape}")


class GroundContact:
    """Tells which voxels of a world's robot touch the ground.

    The ground is the floor y = 0 and the upper sides of all objects but those that the task watches (packages). A voxel
    touches it when one of its corners is at most CONTACT_TOLERANCE above such a side or CONTACT_DEPTH below it,
    vertically, or when a corner of the ground is as near to the voxel's underside. Walls and ceilings do not count.
    If the world gets another robot, it reads that robot's voxels.

    Args:
        env: The environment of the world, or its engine.
        world: Number of the world.

    Raises:
        ValueError: There is no engine in `env`.
    """

    def __init__(self, env: object, world: int = 0) -> None:
        engine = engine_of(env)
        self._simulator, self._world, self._watches = engine.simulator, world, engine.task.watches
        self._number()

    def _number(self) -> None:
        """Sets the numbers of the points and sides that are compared."""
        objects = self._objects = self._simulator.objects(self._world)
        ground_sides, start = [np.zeros((0, 2), np.int64)], 0
        for number, placed in enumerate(objects):
            t = placed.topology
            if number > 0 and placed.name not in self._watches:
                ground_sides.append(start + t.edges[t.sides[t.is_surface_side]])
            start += len(placed.places)
        robot = objects[0].topology
        self.cells = robot.cells
        self._ground_sides = np.concatenate(ground_sides)  # (m, 2), outside on their left
        self._corners = robot.corner_points  # the robot's points come first: (C, 4) numbers of both
        self._robot_sides = robot.edges[robot.sides[robot.is_surface_side]]
        self._owners = np.nonzero(robot.is_surface_side)[0]  # voxel of each of the robot's sides

    def now(self) -> NDArray[np.bool_]:
        """Returns (C,) which voxels touch the ground at this moment."""
        if self._objects is not self._simulator.objects(self._world):
            self._number()
        xy = self._simulator.points(self._world).T
        ends = xy[self._ground_sides]
        faces_up = ends[:, 0, 0] < ends[:, 1, 0]
        n = self._corners.max() + 1
        touches = (_is_near(xy[:n], ends[faces_up]).any(1) | (xy[:n, 1] <= CONTACT_TOLERANCE))[self._corners].any(1)
        below = xy[self._robot_sides]
        faces_down = below[:, 0, 0] > below[:, 1, 0]
        tips = xy[np.unique(self._ground_sides[faces_up])]
        meets = _is_near(tips, below[faces_down][:, ::-1], sign=-1.0).any(0)
        touches[self._owners[faces_down][meets]] = True
        return touches


def _is_near(points: np.ndarray, sides: np.ndarray, sign: float = 1.0) -> NDArray[np.bool_]:
    """Returns (n, m) whether points are close enough to sides: above them, or, with sign -1, below.

    Args:
        points: (n, 2) metres.
        sides: (m, 2, 2) their left and right ends, metres.
        sign: 1 or -1.
    """
    x, y = points[:, :1], points[:, 1:]
    (left, left_y), (right, right_y) = sides[:, 0].T, sides[:, 1].T
    height = left_y + (x - left) / (right - left) * (right_y - left_y)
    gap = sign * (y - height)
    return (left <= x) & (x <= right) & (gap >= -CONTACT_DEPTH) & (gap <= CONTACT_TOLERANCE)


def record_episode(policy: "TensorDictModuleBase | Gait", env: object) -> Recording:
    """Plays one episode with deterministic actions and returns its time series.

    Args:
        policy: The actor, any TensorDict module that writes the action of `SoftRobotEnv`, or a gait, see `play`.
        env: The environment or its engine, of one world, in the reactive setting; it is reset first.

    Raises:
        ValueError: There are several worlds, they do not take stiffness, or as `play`.
    """
    engine = engine_of(env)
    if engine.num_worlds != 1:
        raise ValueError(f"env: got {engine.num_worlds} worlds, expected 1")
    if engine.material != "reactive":
        raise ValueError(
            f"env: got the {engine.material} setting, expected 'reactive': stiffness does not vary in others"
        )
    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for now in play(policy, env):
        if now.step == 0:
            ground = GroundContact(engine)
            voxels = ground.cells[:, 0] * engine.grid_shape[1] + ground.cells[:, 1]
        else:
            rows.append((engine.actuation[0, voxels], engine.stiffness[0, voxels], ground.now()))
    actuation, stiffness, contact = (np.stack(series) for series in zip(*rows, strict=True))
    is_actuator = engine.actuators[0, voxels]
    return Recording(
        task=engine.task.id,
        cells=ground.cells.copy(),
        is_actuator=is_actuator,
        actuation=np.where(is_actuator, actuation, np.nan),
        stiffness=stiffness,
        contact=contact,
        score=float(now.score[0]),
    )
