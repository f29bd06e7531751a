"""Whole training runs: a trainer's updates with their table, evaluations and checkpoints."""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

from torchrl.record.loggers import Logger

from evogymcm.algos.learning.actor import Actor
from evogymcm.algos.learning.config import PPOConfig
from evogymcm.algos.learning.critic import Critic
from evogymcm.algos.learning.evaluation import Evaluation
from evogymcm.algos.learning.trainer import EnvFactory, Trainer
from evogymcm.algos.runs.folder import RunFolder, stop_on_interrupt

__all__ = ["Progress", "TrainResult", "train"]

CHECKPOINT, BEST, FINAL = "checkpoint", "best", "final"


@dataclass(frozen=True)
class Progress:
    """State of a run, given to the caller after every update.

    Attributes:
        env_steps: done so far, in all worlds together.
        total_steps: of the whole run.
        seconds: spent so far, earlier sittings of a resumed run included.
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
        env_steps: done in all worlds together.
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


def train(
    make_env: EnvFactory,
    config: PPOConfig,
    *,
    run: RunFolder | None = None,
    progress: Callable[[Progress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    start_from: Mapping[str, Any] | None = None,
    logger: Logger | None = None,
) -> TrainResult:
    """Trains a policy with PPO and returns it with its learning curve.

    The same settings and seed give the same policy, whether or not the run was stopped and resumed in between.

    Args:
        make_env: makes environments, e.g. `functools.partial(SoftRobotEnv, "Walker-v0", bodies=body)`.
        config: settings of the run.
        run: where to keep the table and checkpoints: `checkpoint` (to go on from), `best` and `final` (policies, the
            actor's weights with their row of the table). A folder opened to resume is gone on with. None keeps
            everything in memory.
        progress: called at the start (with the untrained policy's row, or the last one of a resumed run) and after
            every update.
        should_stop: asked after every update; the run then ends with a checkpoint. By default Ctrl-C stops it so.
        start_from: a saved policy (`RunFolder.load("best")`) to start from instead of fresh weights, for fine-tuning or
            for another body. Single weights start every one of independent policies.
        logger: any of TorchRL's loggers (CSV, TensorBoard, W&B); receives every number of every row.

    Raises:
        RunInUseError: if another process or thread works in the folder `run`.
    """
    with run.lock() if run else nullcontext(), Trainer(make_env, config) as trainer:
        if start_from is not None:
            trainer.start_from(start_from)
        rows: list[dict[str, Any]] = []
        saved = run.load(CHECKPOINT) if run else None
        if run and saved:
            trainer.load_state_dict(saved["trainer"])
            run.keep_rows(saved["rows"])
            rows = run.rows()
            if progress:
                progress(Progress(trainer.env_steps, config.total_steps, trainer.seconds, rows[-1]))
        elif run:
            run.keep_rows(0)  # of a run that was killed before its first checkpoint
        with stop_on_interrupt() if should_stop is None else nullcontext(should_stop) as is_stopped:
            return _loop(trainer, rows, run, progress, is_stopped, logger)


def _loop(
    trainer: Trainer,
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


def _save(trainer: Trainer, is_best: bool, row: dict[str, Any], n_rows: int, run: RunFolder) -> None:
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
