"""What an environment needs so that policies can be trained in it."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from torchrl.envs import EnvBase


@runtime_checkable
class TrainingEnv(Protocol):
    """A TorchRL environment of batch size (N,), such as `SoftRobotEnv`, that `Trainer` and `evaluate` can use.

    Its action holds ("action", "actuation") [N, V] and, where policies set stiffness, ("action", "stiffness") [N, V].
    Its observation holds "task" [N, G], "occupancy" and "actuators" [N, V], "voxels" [N, V, F] and "types" [N, V, 5]
    (for the network "voxel") or "observation" [N, D] (for "mlp"); and for evaluation "score" and "return" (sums of the
    episode's rewards, without and with the last), "unstable" and "reached", all [N, 1]. Evaluations mark the worlds to
    advance with TorchRL's "_step"; an environment that ignores it runs on with worlds that have ended, without effect.
    A resumed run continues in the middle of its episodes if the environment can save its state (`get_extra_state`,
    `set_extra_state`).

    Attributes:
        task: The task; a policy is judged by several episodes if the task's class overrides `Task.draw`.
        num_designs: Number of different bodies D; world w holds body w % D.
        grid_shape: Rows and columns of the padded grid, V = rows * columns.
    """

    task: Any
    num_designs: int
    grid_shape: tuple[int, int]

    @property
    def score_ceiling(self) -> np.ndarray:
        """(N,) largest possible score of each world, NaN where there is none."""

    def reset(self) -> Any:
        """Resets all worlds."""

    def step_and_maybe_reset(self, tensordict: Any) -> Any:
        """Advances all worlds by an env-step, and resets those whose episode has ended."""


class EnvFactory(Protocol):
    """Makes environments, e.g. `functools.partial(SoftRobotEnv, "Walker-v0", bodies=body)`."""

    def __call__(self, *, num_worlds: int, seed: int) -> EnvBase:
        """Returns a fresh `TrainingEnv`, batch size (num_worlds,)."""
