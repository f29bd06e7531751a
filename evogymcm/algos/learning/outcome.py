"""What a training run tells while it goes on, and what comes of it."""

from dataclasses import dataclass
from typing import Any

from evogymcm.algos.learning.actor import Actor
from evogymcm.algos.learning.critic import Critic
from evogymcm.algos.learning.evaluation import Evaluation


@dataclass(frozen=True)
class Progress:
    """State of a run, given to the caller after every update.

    Attributes:
        env_steps: env-steps done so far, in all worlds together.
        total_steps: env-steps of the whole run.
        seconds: wall time so far, earlier sittings of a resumed run included.
        row: newest row of the table: losses, mean reward, and scores where there was an evaluation.
    """

    env_steps: int
    total_steps: int
    seconds: float
    row: dict[str, float]


@dataclass(frozen=True)
class TrainResult:
    """Outcome of a run.

    Attributes:
        actor: the last policy.
        critic: the last value function.
        rows: the table, one row per update and one, with `env_steps` 0, for the untrained policy.
        final: evaluation of the last policy; None if the run was stopped.
        env_steps: env-steps of training, in all worlds together.
        eval_steps: env-steps simulated in evaluations, which `env_steps` leaves out.
        seconds: wall time of training and evaluations.
        finished: False if the run was stopped before its end.
        best: the policy of the best evaluation, as it is saved, with its `score` in each world of that evaluation; of
            independent policies each one's best.
        policy: the last policy, as it is saved.
    """

    actor: Actor
    critic: Critic
    rows: list[dict[str, Any]]
    final: Evaluation | None
    env_steps: int
    eval_steps: int
    seconds: float
    finished: bool
    best: dict[str, Any]
    policy: dict[str, Any]

    @property
    def best_score(self) -> float:
        """Largest score among all evaluations of the run, as the EvoGymCM paper's fitness."""
        return max(row["score"] for row in self.rows if "score" in row)
