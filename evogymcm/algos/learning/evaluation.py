"""One deterministic episode per world, scored as in the EvoGymCM paper."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evogymcm.algos.learning.playing import Gait, play
from evogymcm.envs.task import Task

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase

__all__ = ["Evaluation", "evaluate", "starts_of"]

_RANDOM_STARTS = 8


@dataclass(frozen=True)
class Evaluation:
    """First episode of every world; all arrays are (N,).

    Attributes:
        score: sum of the rewards without that of the last env-step, as in the EvoGymCM paper.
        returns: sum of all rewards, with goal bonuses and penalties.
        length: env-steps of the episode.
        goal: whether it ended at a goal of the task.
        unstable: whether the simulation became unstable.
        env_steps: env-steps simulated in all, the sum of `length`; worlds that wait for others are not simulated.
        ceiling: largest possible score, NaN for tasks without one.
    """

    score: NDArray[np.float64]
    returns: NDArray[np.float64]
    length: NDArray[np.int64]
    goal: NDArray[np.bool_]
    unstable: NDArray[np.bool_]
    ceiling: NDArray[np.float64]
    env_steps: int

    @property
    def fraction(self) -> NDArray[np.float64]:
        """Score as a fraction of the ceiling (NaN where there is none)."""
        return self.score / self.ceiling

    def summary(self) -> dict[str, float]:
        """Returns the means over worlds, ready for a table; goal and ceiling only if there are any."""
        row = {
            "score": float(self.score.mean()),
            "return": float(self.returns.mean()),
            "episode_length": float(self.length.mean()),
            "goal_rate": float(self.goal.mean()),
            "unstable": float(self.unstable.mean()),
        }
        if self.goal.any():
            row["steps_to_goal"] = float(self.length[self.goal].mean())
        if np.isfinite(self.ceiling).all():
            row["fraction_of_ceiling"] = float(self.fraction.mean())
        return row

    def as_dict(self) -> dict[str, list[Any]]:
        """Returns all arrays as lists, ready for JSON."""
        return {name: np.asarray(values).tolist() for name, values in asdict(self).items()}


def starts_of(task: object) -> int:
    """Returns how many episodes tell what a policy is worth: one, or several where they differ by random draws."""
    return 1 if getattr(type(task), "draw", Task.draw) is Task.draw else _RANDOM_STARTS


def evaluate(policy: "TensorDictModuleBase | Gait", env: object) -> Evaluation:
    """Plays one episode in every world with deterministic actions and returns the outcome, see `play`.

    Use a freshly made environment: a reset restores the initial state, but the random generators of the worlds continue
    where they were.

    Args:
        policy: The actor, any TensorDict module that writes the action of `SoftRobotEnv`, or a gait, see `play`.
        env: An environment of this library or its engine, see `play`; its task must have a time limit.

    Raises:
        ValueError: As `play`.
    """
    *_, last = play(policy, env)
    steps = int(last.length.sum())
    return Evaluation(last.score, last.returns, last.length, last.goal, last.unstable, last.ceiling, steps)
