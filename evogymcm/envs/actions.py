"""Actions as they are given: checked, clipped, and put on the padded grid."""

from typing import TYPE_CHECKING, Any

import numpy as np

from evogymcm._settings import check_array
from evogymcm.sim.constants import ACTUATION_HIGH, ACTUATION_LOW, MISSING, STIFFNESS_HIGH, STIFFNESS_LOW
from evogymcm.sim.kernels._jit import kernel

if TYPE_CHECKING:
    from evogymcm.envs.core import TaskEngine

RANGES = {"actuation": (ACTUATION_LOW, ACTUATION_HIGH), "stiffness": (STIFFNESS_LOW, STIFFNESS_HIGH)}


@kernel
def _clip(values: np.ndarray, is_used: np.ndarray, low: float, high: float) -> int:
    """Clips (N, V) values to their range, and sets those not used to 1; returns the first world that has NaN."""
    for w in range(values.shape[0]):
        for k in range(values.shape[1]):
            value = values[w, k] if is_used[w, k] else 1.0
            if value != value:
                return w
            values[w, k] = min(max(value, low), high)
    return MISSING


def checked_action(name: str, values: Any, is_used: np.ndarray, low: float, high: float) -> np.ndarray:
    """Returns a fresh (N, V) array of the action, clipped to its range, and 1 where it is not used.

    Raises:
        ValueError: For another shape, and for NaN where the number is used.
    """
    values = check_array(name, values)
    if values.shape != is_used.shape:
        raise ValueError(f"{name}: got shape {values.shape}, expected (worlds, cells) = {is_used.shape}")
    world = _clip(values, is_used, low, high)
    if world != MISSING:
        raise ValueError(f"{name}: got NaN in world {world}")
    return values


class ActionGrid:
    """Puts flat actions, one number for each actuator and in the reactive setting for each voxel, on the padded grid.

    Args:
        engine: The engine of N worlds, of equal bodies.
        shape: Of actions: (N, numbers), or (numbers,) of a single world.
    """

    def __init__(self, engine: "TaskEngine", shape: tuple[int, ...]) -> None:
        self._shape = shape
        self._actuators, self._voxels = np.flatnonzero(engine.actuators), np.flatnonzero(engine.occupancy)
        self._n_actuators = len(self._actuators) // engine.num_worlds
        self._actuation, self._stiffness = np.ones(engine.occupancy.shape), np.ones(engine.occupancy.shape)
        self._is_reactive = engine.material == "reactive"

    def spread(self, actions: Any) -> tuple[np.ndarray, np.ndarray | None]:
        """Returns (N, V) actuation and stiffness, which the next call overwrites.

        Raises:
            ValueError: For another number of values.
        """
        if not isinstance(actions, np.ndarray) or actions.dtype != np.float64:
            actions = check_array("action", actions)
        if actions.shape != self._shape:
            # Of a vector of a single world the action's own shape.
            one = 1 if len(self._shape) == 2 and actions.shape[:1] == self._shape[:1] == (1,) else 0
            raise ValueError(f"action: got shape {actions.shape[one:]}, expected {self._shape[one:]}")
        if not self._is_reactive:
            self._actuation.put(self._actuators, actions)
            return self._actuation, None
        self._actuation.put(self._actuators, actions[..., : self._n_actuators])
        self._stiffness.put(self._voxels, actions[..., self._n_actuators :])
        return self._actuation, self._stiffness
