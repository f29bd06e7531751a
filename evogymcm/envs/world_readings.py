"""What EvoGym's environments can be asked of one world, by EvoGym's names, in metres."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from evogymcm.envs.core import TaskEngine
from evogymcm.sim.constants import VOXEL
from evogymcm.sim.readings import WINDOW_REACH, Readings
from evogymcm.sim.scene import Scene
from evogymcm.sim.world import ROBOT

_TWO_PI = 2.0 * 3.1415926  # EvoGym's value, as in the observations
_INSTEAD = {
    "sim": "use `engine.simulator`",
    "world": "use `engine.task.world`",
    "default_viewer": "use `render_mode` and `render_options`",
    "DATA_PATH": "`evogymcm.sim.world.World.load(name)` gives the worlds",
}


class WorldReadings:
    """Readings of one world of an engine.

    Times are env-steps of the episode, and only the present one, `get_time()`, can be asked for: what is needed of an
    earlier one is read then.

    Args:
        engine: The task engine.
        world: Which of its worlds.
    """

    VOXEL_SIZE = VOXEL

    def __init__(self, engine: TaskEngine, world: int = 0) -> None:
        self.engine, self._world = engine, world

    def __getattr__(self, name: str) -> Any:
        instead = _INSTEAD.get(name)
        hint = f"; {instead}" if instead else ""
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}{hint}")

    def points(self, name: str = ROBOT) -> np.ndarray:
        """Returns (2, n) positions in metres of an object's points."""
        return self.engine.simulator.positions(name, self._world)

    def velocities(self, name: str = ROBOT) -> np.ndarray:
        """Returns (2, n) velocities of an object's points."""
        return self.engine.simulator.velocities(name, self._world)

    def get_time(self) -> int:
        """Returns the env-steps since the episode began."""
        return int(self.engine.length[self._world])

    def object_pos_at_time(self, time: int, object_name: str) -> np.ndarray:
        """Returns (2, n) positions of an object's points; ValueError for another time than the present."""
        self._check_time(time)
        return self.points(object_name)

    def object_vel_at_time(self, time: int, object_name: str) -> np.ndarray:
        """Returns (2, n) velocities of an object's points; ValueError for another time than the present."""
        self._check_time(time)
        return self.velocities(object_name)

    def object_orientation_at_time(self, time: int, object_name: str) -> float:
        """Returns an object's orientation, radians counter-clockwise since reset, in [0, 2 pi)."""
        self._check_time(time)
        readings = self._read(object_name)
        if readings is not None:
            return float(readings.orientation[self._world])
        placed = self._scene.object(object_name)
        return _orientation(placed.topology.points(*placed.origin).T, self.points(object_name))

    def pos_at_time(self, time: int) -> np.ndarray:
        """Returns (2, n) positions of all points, the robot's first."""
        self._check_time(time)
        return np.concatenate([self.points(placed.name) for placed in self._scene.objects], axis=1)

    def vel_at_time(self, time: int) -> np.ndarray:
        """Returns (2, n) velocities of all points, the robot's first."""
        self._check_time(time)
        return np.concatenate([self.velocities(placed.name) for placed in self._scene.objects], axis=1)

    def get_pos_com_obs(self, object_name: str) -> np.ndarray:
        """Returns (2,) an object's centre of mass."""
        readings = self._read(object_name)
        return self.points(object_name).mean(1) if readings is None else readings.com[self._world].copy()

    def get_vel_com_obs(self, object_name: str) -> np.ndarray:
        """Returns (2,) an object's mean velocity."""
        readings = self._read(object_name)
        return self.velocities(object_name).mean(1) if readings is None else readings.velocity[self._world].copy()

    def get_ort_obs(self, object_name: str) -> np.ndarray:
        """Returns (1,) an object's orientation, see `object_orientation_at_time`."""
        return np.array([self.object_orientation_at_time(self.get_time(), object_name)])

    def get_relative_pos_obs(self, object_name: str) -> np.ndarray:
        """Returns (2n,) an object's points minus its centre of mass, all x first."""
        return (self.points(object_name) - self.get_pos_com_obs(object_name)[:, None]).ravel()

    def get_floor_obs(
        self, object_name: str, terrain_list: Sequence[str], sight_dist: int, sight_range: float = WINDOW_REACH
    ) -> np.ndarray:
        """Returns (2 sight_dist + 1,) how far terrain is below an object's centre of mass, in columns one voxel wide.

        Args:
            object_name: The object in the middle.
            terrain_list: The objects that count as terrain.
            sight_dist: Columns to each side.
            sight_range: Voxels that it sees down: a column without terrain reads this far.
        """
        return self._look(object_name, terrain_list, sight_dist, sight_range, -1.0)

    def get_ceil_obs(
        self, object_name: str, terrain_list: Sequence[str], sight_dist: int, sight_range: float = WINDOW_REACH
    ) -> np.ndarray:
        """Returns (2 sight_dist + 1,) how far terrain is above an object's centre of mass, as `get_floor_obs`."""
        return self._look(object_name, terrain_list, sight_dist, sight_range, 1.0)

    def get_actuator_indices(self, robot_name: str = ROBOT) -> np.ndarray:
        """Returns the flat indices of the robot's actuators in its body, in the order of the actions."""
        if robot_name != ROBOT:
            raise ValueError(f"robot_name: got {robot_name!r}, the only robot is {ROBOT!r}")
        return self.engine.bodies[self._world].actuators

    def get_dim_action_space(self, robot_name: str = ROBOT) -> int:
        """Returns the number of the robot's actuators."""
        return len(self.get_actuator_indices(robot_name))

    @property
    def _scene(self) -> Scene:
        simulator = self.engine.simulator
        return simulator.blocks[simulator.lane_of[self._world, 0]].scene

    def _read(self, name: str) -> Readings | None:
        """Returns what the task reads of an object, None where it does not, so that observations and this agree."""
        snapshot = self.engine.snapshot
        return snapshot.robot if name == ROBOT else snapshot.objects.get(name)

    def _check_time(self, time: int) -> None:
        if time != self.get_time():
            raise ValueError(f"time: got {time}, only the present env-step is kept, {self.get_time()}")

    def _look(self, name: str, terrain: Sequence[str], radius: int, reach: float, direction: float) -> np.ndarray:
        com = self.get_pos_com_obs(name) / VOXEL
        x, y = np.concatenate([self.points(each) for each in terrain], axis=1) / VOXEL
        distance = direction * (y - com[1])
        seen = np.full(2 * radius + 1, float(reach))
        for i in range(-radius, radius + 1):
            column = (x > com[0] + (i - 0.5)) & (x < com[0] + (i + 0.5)) & (distance > 0.0)
            seen[i + radius] = min(reach, distance[column].min(initial=np.inf))
        return VOXEL * seen


def _orientation(was: np.ndarray, now: np.ndarray) -> float:
    """Returns the orientation of (2, n) points against those at reset, by the rule of `evogymcm.sim.readings`."""
    a, b = was - was.mean(1, keepdims=True), now - now.mean(1, keepdims=True)
    sizes, product = np.hypot(*a), np.hypot(*a) * np.hypot(*b)
    cosine = np.where(product < 1e-7, 0.99999, (a * b).sum(0) / np.maximum(product, 1e-7))
    cosine = np.where(cosine > 1.0, 0.99999, np.where(cosine < -1.0, -0.99999, cosine))
    angle = float(sizes @ np.arccos(cosine) / sizes.sum())
    turning = ((b[0] * a[1] - b[1] * a[0]) / np.maximum(product, 1e-7)).sum()
    return _TWO_PI - angle if turning > 0.0 else angle


__all__ = ["WorldReadings"]
