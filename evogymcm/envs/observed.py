"""Observations of an engine's worlds: of their bodies, of each voxel, and of the robot as a whole."""

from collections.abc import Iterable, Sequence

import numpy as np

from evogymcm.body import Body
from evogymcm.envs.reader import Reader, Sensed
from evogymcm.envs.streams import BodyStream
from evogymcm.envs.task import Snapshot, Task
from evogymcm.envs.voxels import N_FEATURES, N_SIDES, describe
from evogymcm.sim.simulator import Simulator

MOST_POINTS = 4  # that a voxel can have of its own
N_COMMON = 4  # features that all tasks have, in front of their own


class Observed:
    """The observations of N worlds on the padded grid of V cells; the base of `TaskEngine`, which has the docstring.

    Args:
        task: The task.
        simulator: The simulator of the worlds.
        bodies: The body of each world.
        grid_shape: (rows, columns) of the padded grid.
        with_voxels: Whether to observe voxels.
        with_flat: Whether to form the flat observation.
    """

    stiffness: np.ndarray
    actuation: np.ndarray
    _stream: BodyStream | None

    def __init__(
        self,
        task: Task,
        simulator: Simulator,
        bodies: Sequence[Body],
        grid_shape: tuple[int, int],
        *,
        with_voxels: bool,
        with_flat: bool,
    ) -> None:
        self.task, self.simulator, self.bodies, self.grid_shape = task, simulator, tuple(bodies), grid_shape
        n, v = len(self.bodies), simulator.n_cells
        self.occupancy, self.actuators = np.zeros((n, v), bool), np.zeros((n, v), bool)
        self.with_voxels = with_voxels
        self.types = np.zeros((n, v, N_SIDES), np.uint8)
        self._template = np.zeros((n, v, N_FEATURES), np.float32)
        self._describe(range(n))
        self.voxels = self._template.copy()
        self._reader = Reader(task, simulator, MOST_POINTS * v if self.changes_bodies else 0)
        self.is_uniform = with_flat and not self.changes_bodies and len(set(self.bodies)) == 1

    @property
    def changes_bodies(self) -> bool:
        """Whether bodies come from a stream, so that worlds get a new one at each reset."""
        return self._stream is not None

    def _describe(self, worlds: Iterable[int]) -> None:
        """Sets what observations say of the bodies of some worlds."""
        arrays = self.occupancy, self.actuators, self.types, self._template
        for world in worlds:
            grid, topology = self.bodies[world].grid, self.simulator.objects(world)[0].topology
            filled = (values[world] for values in arrays)
            describe(grid, topology.cells, topology.is_surface_side, self.grid_shape[1], *filled)

    def _show_bodies(self, worlds: Sequence[int], bodies: Sequence[Body]) -> None:
        """Has all that is said of some worlds be of other bodies."""
        changed = list(self.bodies)
        for world, body in zip(worlds, bodies, strict=True):
            self._reader.clear(world)
            changed[world] = body
        self.bodies = tuple(changed)
        for name in ("occupancy", "actuators", "types"):  # those that were shown stay as they were
            setattr(self, name, getattr(self, name).copy())
        self._describe(worlds)

    def _renew_voxels(self, mask: np.ndarray | None) -> None:
        """Gives `voxels` fresh memory, since observations are kept; with the old values, unless all are to be read."""
        if self.with_voxels:
            self.voxels = np.empty_like(self._template) if mask is None else self.voxels.copy()
            self._reader.sense(Sensed(self.stiffness, self.actuation, self._template, self.voxels))

    @property
    def snapshot(self) -> Snapshot:
        """The current readings. They are overwritten by the next reset, and by the step after the next."""
        return self._reader.now

    @property
    def com(self) -> np.ndarray:
        """(N, 2) the robots' centres of mass, metres."""
        return self._reader.now.robot.com.copy()

    @property
    def flat(self) -> np.ndarray | None:
        """(N, D) the task's own flat observation (fresh memory), None where bodies differ."""
        return self._reader.flat() if self.is_uniform else None

    @property
    def features(self) -> np.ndarray:
        """(N, G) global features (fresh memory): COM velocity, sine and cosine of the orientation, the task's parts.

        The first `N_COMMON` are those of all tasks.
        """
        angle = self._reader.now.robot.orientation.copy()  # numpy's sine of a view may round otherwise
        parts = [self._reader.now.robot.velocity, np.sin(angle)[:, None], np.cos(angle)[:, None]]
        own = self.task.observation(self._reader.now)
        parts += [part for name, part in own.items() if name not in ("velocity", "orientation", "relative")]
        return np.concatenate(parts, axis=1)

    def observations(self) -> dict[str, np.ndarray]:
        """Returns what a policy sees of each world, in memory that no later step writes, by the keys of `SoftRobotEnv`.

        `voxels`, `types`, `occupancy`, `actuators`, `task` (the features, float32), and `observation` (the flat one)
        where there is one.
        """
        seen: dict[str, np.ndarray] = {
            "voxels": self.voxels,  # every step makes new ones
            "types": self.types.copy(),
            "occupancy": self.occupancy.copy(),
            "actuators": self.actuators.copy(),
            "task": self.features.astype(np.float32),
        }
        flat = self.flat
        return seen if flat is None else seen | {"observation": flat}

    def vectors(self) -> np.ndarray:
        """Returns (N, D) float32: `observations` without the flat one, as one vector a world, the parts by name."""
        parts = self.observations()
        names = sorted(parts.keys() - {"observation"})
        return np.concatenate([parts[name].reshape(len(self.bodies), -1).astype(np.float32) for name in names], axis=1)
