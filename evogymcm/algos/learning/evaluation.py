"""One deterministic episode per world, scored as in the EvoGymCM paper."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evogymcm._settings import WORK, check_count
from evogymcm.algos.learning.playing import Gait, play
from evogymcm.envs.engines import engine_of
from evogymcm.envs.task import Task

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase

_RANDOM_DRAWS = 8


@dataclass(frozen=True)
class Evaluation:
    """First episode of every world, from the exact start; all arrays but `starts` are (N,).

    Attributes:
        score: sum of the rewards without that of the last env-step, as in the EvoGymCM paper.
        returns: sum of all rewards, with goal bonuses and penalties.
        length: env-steps of the episode.
        goal: whether it ended at a goal of the task.
        unstable: whether the simulation became unstable.
        ceiling: largest possible score, NaN for tasks without one.
        env_steps: env-steps simulated in all, from all starts; worlds that wait for others are not simulated.
        starts: (K, N) scores from K starts, 1e-6 metres apart, see `evaluate`; the first row is `score`.
        work: (N, 4) work of the episode: what actuation and what stiffness supplied, then the net work of both; NaN
            where it was not measured, see `EngineOptions`.
    """

    score: NDArray[np.float64]
    returns: NDArray[np.float64]
    length: NDArray[np.int64]
    goal: NDArray[np.bool_]
    unstable: NDArray[np.bool_]
    ceiling: NDArray[np.float64]
    env_steps: int
    starts: NDArray[np.float64]
    work: NDArray[np.float64]

    @property
    def robust(self) -> NDArray[np.float64]:
        """The robust score, (N,): the mean over the starts."""
        return mean_of_rows(self.starts)

    @property
    def spread(self) -> NDArray[np.float64]:
        """Standard deviation of the score over the starts, (N,); NaN where there is one start only."""
        n = len(self.starts)
        if n == 1:
            return np.full(len(self.score), np.nan)
        return np.sqrt(mean_of_rows((self.starts - self.robust) ** 2) * (n / (n - 1)))

    @property
    def fraction(self) -> NDArray[np.float64]:
        """Score as a fraction of the ceiling (NaN where there is none)."""
        return self.score / self.ceiling

    def summary(self) -> dict[str, float]:
        """Returns the means over worlds, ready for a table; goal, ceiling, starts and work only if there are any."""
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
        if len(self.starts) > 1:
            row |= {"robust_score": float(self.robust.mean()), "spread": float(self.spread.mean())}
        return row | mean_work(self.work)

    def as_dict(self) -> dict[str, list[Any]]:
        """Returns all arrays as lists, ready for JSON."""
        return {name: np.asarray(values).tolist() for name, values in asdict(self).items()}


def draws_of(task: object) -> int:
    """Returns how many episodes tell what a policy is worth: one, or several where they differ by random draws."""
    return 1 if getattr(type(task), "draw", Task.draw) is Task.draw else _RANDOM_DRAWS


def mean_work(work: NDArray[np.float64]) -> dict[str, float]:
    """Returns the mean row of (N, 4) work by the names in infos; nothing where it was not measured."""
    return dict(zip(WORK, work.mean(0).tolist(), strict=True)) if np.isfinite(work).all() else {}


def mean_of_rows(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the mean row, summed row by row: NumPy's order of summation depends on how many columns there are."""
    total = rows[0].copy()
    for row in rows[1:]:
        total += row
    return total / len(rows)


def evaluate(policy: "TensorDictModuleBase | Gait", env: object, starts: int = 1, *, start_seed: int = 0) -> Evaluation:
    """Plays one episode in every world with deterministic actions and returns the outcome, see `play`.

    Use a freshly made environment: a reset restores the initial state, but the random generators of the worlds continue
    where they were.

    An episode is one trajectory, and contact amplifies small differences. With K `starts`, the environment's worlds are
    N worlds K times over, from starts that differ by 1e-6 metres (`TaskEngine.set_starts`). `score` and all else but
    `starts`, `robust` and `spread` are of the exact one, the same to the last bit as without the others.

    Args:
        policy: The actor, any TensorDict module that writes the action of `SoftRobotEnv`, or a gait, see `play`.
        env: An environment of this library or its engine, see `play`; its task must have a time limit.
        starts: K; more than 1 need an environment of K * N worlds, of this library.
        start_seed: Where the differences come from; each start's are the same whatever K is.

    Raises:
        ValueError: As `play`, or the environment's worlds are not N worlds K times over.
    """
    if check_count("starts", starts) == 1:
        return _outcome(policy, env, 1)
    engine = engine_of(env)
    engine.set_starts(starts, start_seed)
    if hasattr(policy, "in_keys"):
        from evogymcm.algos.learning.grouping import InGroups

        policy = InGroups([policy], engine.num_worlds // starts)
    try:
        return _outcome(policy, env, starts)
    finally:
        engine.set_starts(1)


def _outcome(policy: "TensorDictModuleBase | Gait", env: object, starts: int) -> Evaluation:
    """Plays the episodes and returns what came of those from the exact start, and the scores of all."""
    *_, last = play(policy, env)
    n = len(last.score) // starts
    return Evaluation(
        last.score[:n],
        last.returns[:n],
        last.length[:n],
        last.goal[:n],
        last.unstable[:n],
        last.ceiling[:n],
        int(last.length.sum()),
        last.score.reshape(starts, n),
        last.work[:n],
    )
