"""One deterministic episode per world, scored as in the EvoGymCM paper."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from evogymcm.algos.learning.threads import exploration
from evogymcm.envs.task import Task

__all__ = ["Evaluation", "evaluate", "starts_of"]

_RANDOM_STARTS = 8


@dataclass(frozen=True)
class Evaluation:
    """First episode of every world; all arrays are (N,).

    Attributes:
        score: sum of the rewards of all env-steps but the episode's last one, as the EvoGymCM paper counts.
        returns: sum of all rewards, with goal bonuses and penalties.
        length: env-steps of the episode.
        goal: whether it ended at a goal of the task.
        unstable: whether the simulation became unstable.
        env_steps: simulated in all, those of worlds that waited for the last one included.
        ceiling: largest possible score where the task has one, NaN where it has none.
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
        """Returns the means over worlds, ready for a table; those of goal and ceiling only where there is one."""
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


@torch.no_grad()
def evaluate(policy: TensorDictModuleBase, env: EnvBase) -> Evaluation:
    """Plays one episode in every world of `env` with deterministic actions and returns the outcome.

    The policy is not changed, and no random numbers are drawn from torch. Give it a freshly made env: a reset restores
    the initial state, but the env's own random generator goes on from where it was. Modules other than this library's
    actors follow TorchRL's exploration type, which is one for all threads: evaluate them in one thread at a time.

    Args:
        policy: the actor, or any TensorDict module that writes the env's action.
        env: a SoftRobotEnv, batch size (N,), on the policy's device; its task must have a time limit.
    """
    n = env.batch_size.numel()
    score, returns = np.zeros(n), np.zeros(n)
    length, unstable, goal = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    running = np.ones(n, dtype=bool)
    with exploration(False):
        state = env.reset()
        ceiling = np.array(env.score_ceiling, dtype=np.float64)  # worlds of a stream hold other bodies later
        while running.any():
            step, state = env.step_and_maybe_reset(policy(state))  # finished worlds start anew and are ignored
            following = step["next"]
            length += running
            ended = running & following["done"].squeeze(-1).cpu().numpy()
            for record, key in ((score, "score"), (returns, "return"), (unstable, "unstable"), (goal, "reached")):
                record[ended] = following[key].squeeze(-1).cpu().numpy()[ended]
            running &= ~ended
    return Evaluation(score, returns, length, goal, unstable, ceiling, n * int(length.max()))
