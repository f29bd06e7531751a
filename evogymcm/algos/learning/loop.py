"""The loop of a training run: updates with their table, evaluations and checkpoints, and what comes of it."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from torchrl.record.loggers import Logger

from evogymcm.algos.learning.actor import Actor
from evogymcm.algos.learning.critic import Critic
from evogymcm.algos.learning.evaluation import Evaluation
from evogymcm.algos.runs.folder import RunFolder, stop_on_interrupt

if TYPE_CHECKING:
    from evogymcm.algos.learning.trainer import Trainer

CHECKPOINT, BEST, FINAL = "checkpoint", "best", "final"


@dataclass(frozen=True)
class Progress:
    """State of a run, given to the caller after every update.

    Attributes:
        env_steps: env-steps done so far, in all worlds together.
        total_steps: env-steps of the whole run.
        seconds: wall time so far, including the time before a run was resumed.
        row: latest row of the table: losses, mean reward, and scores if there was an evaluation.
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
        best: the policy of the best evaluation, as it is saved, with its `score` in each world of that evaluation, and
            its `robust` score where that was the selection; with independent policies the best of each.
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


def train_to_the_end(
    trainer: "Trainer",
    *,
    run: RunFolder | None,
    progress: Callable[[Progress], None] | None,
    should_stop: Callable[[], bool] | None,
    logger: Logger | None,
) -> TrainResult:
    """Trains from where the folder's checkpoint is, see `train`; the caller has locked the folder."""
    rows: list[dict[str, Any]] = []
    saved = run.load(CHECKPOINT) if run else None
    if run and saved:
        trainer.load_state_dict(saved["trainer"])
        run.keep_rows(saved["rows"])
        rows = run.rows()
        if progress:
            progress(Progress(trainer.env_steps, trainer.config.total_steps, trainer.seconds, rows[-1]))
    elif run:
        run.keep_rows(0)  # of a run that was killed before its first checkpoint

    def record(row: dict[str, Any], evaluation: Evaluation | None) -> None:
        is_best = evaluation is not None and trainer.take_best(evaluation)
        if evaluation is not None:
            row |= {**evaluation.summary(), "seconds": trainer.seconds}
        rows.append(row)
        if run:
            run.append(row)
        if run and is_best:
            run.save(BEST, {**(trainer.best or {}), "row": row})
        if run and evaluation is not None:
            if trainer.is_finished:
                run.save(FINAL, trainer.policy_state() | {"row": row})
            run.save(CHECKPOINT, {"trainer": trainer.state_dict(), "rows": len(rows)})
        if logger:
            for name, value in row.items():
                logger.log_scalar(name, value, step=trainer.env_steps)
        if progress:
            progress(Progress(trainer.env_steps, trainer.config.total_steps, trainer.seconds, row))

    final = None
    with stop_on_interrupt() if should_stop is None else nullcontext(should_stop) as is_stopped:
        if not rows:
            record({"env_steps": 0}, trainer.evaluate())
        while not (trainer.is_finished or is_stopped()):
            interval, before = trainer.config.eval_interval, trainer.env_steps
            row = trainer.update()
            is_due = interval and trainer.env_steps // interval > before // interval
            final = trainer.evaluate() if is_due or trainer.is_finished else None
            record(row, final)
        if not trainer.is_finished:
            final = None
            if run:
                run.save(CHECKPOINT, {"trainer": trainer.state_dict(), "rows": len(rows)})
        elif final is None:  # a run that had been finished before: the same evaluation again, which counts once
            counted = trainer.eval_steps
            final = trainer.evaluate()
            trainer.eval_steps = counted
    return TrainResult(
        trainer.actor,
        trainer.critic,
        rows,
        final,
        trainer.env_steps,
        trainer.eval_steps,
        trainer.seconds,
        trainer.is_finished,
        trainer.best or {},
        trainer.policy_state(),
    )
