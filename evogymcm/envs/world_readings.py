"""The methods of EvoGym's environments for one world, by EvoGym's names, in metres."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from evogymcm.envs.core import TaskEngine
from evogymcm.sim.constants import VOXEL
from evogymcm.sim.kernels.readings import (
    CENTRE,
    N_SCRATCH,
    ORIENTATION,
    VELOCITY,
    WINDOW_REACH,
    new_readings,
    read_object,
)
from evogymcm.sim.world import ROBOT

_INSTEAD = {
    "sim": "use `engine.simulator`",
    "world": "use `engine.task.world`",
    "default_viewer": "use `render_mode` and `render_options`",
    "DATA_PATH": "`evogymcm.sim.world.World.load(name)` gives the worlds",
}


class WorldReadings:
    """Readings of one world of an engine.

    Times are env-steps of the episode, and only the current one, `get_time()`, is available: read earlier ones when
    they are current. Methods with EvoGym's names round as EvoGym does; `points` and `velocities` are the simulator's
    numbers.

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
        """Returns (2, n) positions of an object's points; ValueError unless `time` is the current one."""
        self._check_time(time)
        return self.points(object_name) / VOXEL * VOXEL

    def object_vel_at_time(self, time: int, object_name: str) -> np.ndarray:
        """Returns (2, n) velocities of an object's points; ValueError unless `time` is the current one."""
        self._check_time(time)
        return self.velocities(object_name) / VOXEL * VOXEL

    def object_orientation_at_time(self, time: int, object_name: str) -> float:
        """Returns an object's orientation, radians counter-clockwise since reset, in [0, 2 pi)."""
        self._check_time(time)
        return float(self._read(object_name)[0][ORIENTATION])

    def pos_at_time(self, time: int) -> np.ndarray:
        """Returns (2, n) positions of all points, the robot's first."""
        self._check_time(time)
        return self.engine.simulator.points(self._world) / VOXEL * VOXEL

    def vel_at_time(self, time: int) -> np.ndarray:
        """Returns (2, n) velocities of all points, the robot's first."""
        self._check_time(time)
        objects = self.engine.simulator.objects(self._world)
        return np.concatenate([self.velocities(placed.name) for placed in objects], axis=1) / VOXEL * VOXEL

    def get_pos_com_obs(self, object_name: str) -> np.ndarray:
        """Returns (2,) an object's centre of mass."""
        return self._read(object_name)[0][CENTRE : CENTRE + 2] * VOXEL

    def get_vel_com_obs(self, object_name: str) -> np.ndarray:
        """Returns (2,) an object's mean velocity."""
        return self._read(object_name)[0][VELOCITY : VELOCITY + 2].copy()

    def get_ort_obs(self, object_name: str) -> np.ndarray:
        """Returns (1,) an object's orientation, see `object_orientation_at_time`."""
        return np.array([self.object_orientation_at_time(self.get_time(), object_name)])

    def get_relative_pos_obs(self, object_name: str) -> np.ndarray:
        """Returns (2n,) an object's points minus its centre of mass, all x first."""
        return self._read(object_name)[1].flatten()

    def get_floor_obs(
        self, object_name: str, terrain_list: Sequence[str], sight_dist: int, sight_range: float = WINDOW_REACH
    ) -> np.ndarray:
        """Returns (2 sight_dist + 1,) how far terrain is below an object's centre of mass, in columns one voxel wide.

        Args:
            object_name: The object in the middle.
            terrain_list: The objects that count as terrain.
            sight_dist: Columns to each side.
            sight_range: How many voxels down it sees; this is the value of a column without terrain.
        """
        return self._look(object_name, terrain_list, sight_dist, sight_range, is_ceiling=False)

    def get_ceil_obs(
        self, object_name: str, terrain_list: Sequence[str], sight_dist: int, sight_range: float = WINDOW_REACH
    ) -> np.ndarray:
        """Returns (2 sight_dist + 1,) how far terrain is above an object's centre of mass, as `get_floor_obs`."""
        return self._look(object_name, terrain_list, sight_dist, sight_range, is_ceiling=True)

    def get_actuator_indices(self, robot_name: str = ROBOT) -> np.ndarray:
        """Returns the flat indices of the robot's actuators in its body, in the order of the actions."""
        if robot_name != ROBOT:
            raise ValueError(f"robot_name: got {robot_name!r}, the only robot is {ROBOT!r}")
        return self.engine.bodies[self._world].actuators

    def get_dim_action_space(self, robot_name: str = ROBOT) -> int:
        """Returns the number of the robot's actuators."""
        return len(self.get_actuator_indices(robot_name))

    def _read(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Returns an object's numbers, by the columns of `Readings.numbers`, and its (2, n) points minus its COM.

        They are the task's own where it reads the object, so that observations and this agree.
        """
        simulator, world, snapshot = self.engine.simulator, self._world, self.engine.snapshot
        n = len(simulator.object(name, world).places)
        readings = snapshot.robot if name == ROBOT else snapshot.objects.get(name)
        if readings is None:
            readings = new_readings(world + 1, n)
            number = [placed.name for placed in simulator.objects(world)].index(name)
            read_object(simulator.storage, np.array([world]), number, False, np.zeros(N_SCRATCH * (n + 2)), *readings)
        return readings.numbers[world], readings.relative[world, :, :n]

    def _check_time(self, time: int) -> None:
        if time != self.get_time():
            raise ValueError(f"time: got {time}, only the present env-step is kept, {self.get_time()}")

    def _look(self, name: str, terrain: Sequence[str], radius: int, reach: float, *, is_ceiling: bool) -> np.ndarray:
        cx, cy = self._read(name)[0][CENTRE : CENTRE + 2]
        x, y = np.concatenate([self.points(each) for each in terrain], axis=1) / VOXEL
        distance, nothing = (y - cy, cy + reach - cy) if is_ceiling else (cy - y, cy - (cy - reach))
        seen = np.empty(2 * radius + 1)
        for i in range(-radius, radius + 1):
            near = distance[(x > cx + (i - 0.5)) & (x < cx + (i + 0.5)) & (distance > 0.0)]
            seen[i + radius] = min(reach, near.min() if near.size else nothing)
        return VOXEL * seen
