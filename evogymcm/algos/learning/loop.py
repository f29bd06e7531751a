"""The loop of a training run: updates with their table, evaluations and checkpoints."""

from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

from torchrl.record.loggers import Logger

from evogymcm.algos.learning.config import PPOConfig
from evogymcm.algos.learning.evaluation import Evaluation
from evogymcm.algos.learning.outcome import Progress, TrainResult
from evogymcm.algos.runs.folder import RunFolder, stop_on_interrupt

if TYPE_CHECKING:
    from evogymcm.algos.learning.trainer import Trainer

CHECKPOINT, BEST, FINAL = "checkpoint", "best", "final"


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
    with stop_on_interrupt() if should_stop is None else nullcontext(should_stop) as is_stopped:
        return _loop(trainer, rows, run, progress, is_stopped, logger)


def _loop(
    trainer: "Trainer",
    rows: list[dict[str, Any]],
    run: RunFolder | None,
    progress: Callable[[Progress], None] | None,
    is_stopped: Callable[[], bool],
    logger: Logger | None,
) -> TrainResult:
    """Updates until the end, with evaluations and checkpoints on the way."""
    config = trainer.config

    def record(row: dict[str, Any], evaluation: Evaluation | None) -> None:
        is_best = evaluation is not None and trainer.take_best(evaluation)
        if evaluation is not None:
            row |= {**evaluation.summary(), "seconds": trainer.seconds}
        rows.append(row)
        if run:
            run.append(row)
        if run and evaluation is not None:
            _save(trainer, is_best, row, len(rows), run)
        if logger:
            for name, value in row.items():
                logger.log_scalar(name, value, step=trainer.env_steps)
        if progress:
            progress(Progress(trainer.env_steps, config.total_steps, trainer.seconds, row))

    if not rows:
        record({"env_steps": 0}, trainer.evaluate())
    final = None
    while not (trainer.is_finished or is_stopped()):
        is_due = _is_due(trainer.env_steps, config)
        row = trainer.update()
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


def _save(trainer: "Trainer", is_best: bool, row: dict[str, Any], n_rows: int, run: RunFolder) -> None:
    """Keeps the policy where it is the best or the last one, and the state to go on from."""
    if is_best:
        run.save(BEST, {**(trainer.best or {}), "row": row})
    if trainer.is_finished:
        run.save(FINAL, trainer.policy_state() | {"row": row})
    run.save(CHECKPOINT, {"trainer": trainer.state_dict(), "rows": n_rows})


def _is_due(env_steps: int, config: PPOConfig) -> bool:
    """Whether the next update passes a multiple of the evaluation interval."""
    if not config.eval_interval:
        return False
    return (env_steps + config.frames_per_update) // config.eval_interval > env_steps // config.eval_interval
