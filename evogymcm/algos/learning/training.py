"""Training a policy for bodies on a task, from settings alone."""

import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

from torchrl.record.loggers import Logger

from evogymcm._messages import brief
from evogymcm.algos.learning.bodies import RandomBodies
from evogymcm.algos.learning.config import AUTO, FRESH, PPOConfig, TrainConfig
from evogymcm.algos.learning.initial import following, initial_policy
from evogymcm.algos.learning.loop import Progress, TrainResult, train_to_the_end
from evogymcm.algos.learning.trainer import Trainer
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.algos.runs.origin import find_origin
from evogymcm.algos.runs.record import RunRecord
from evogymcm.envs import SoftRobotEnv


def train(
    config: TrainConfig,
    *old: PPOConfig,
    run: RunFolder | str | os.PathLike[str] | None = None,
    progress: Callable[[Progress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    initial: Mapping[str, Any] | None = None,
    logger: Logger | None = None,
    num_threads: int | None = None,
    start_from: Mapping[str, Any] | None = None,
) -> TrainResult:
    """Trains a policy with PPO and returns it with its learning curve.

    The same settings and seed give the same policy, whether or not the run was stopped and resumed in between.

    Args:
        config: Settings of the run.
        *old: No longer in use: `train(make_env, ppo)` is now `Trainer(make_env, ppo).train()`.
        run: Folder for the run's record, its table and checkpoints: `checkpoint` (to resume from), `best` and `final`
            (policies, with their row of the table). A run that exists at a path is resumed, and so is a `RunFolder`
            that was opened with `resume`. None keeps everything in memory.
        progress: Called at the start (with the untrained policy's row, or the last one of a resumed run) and after
            every update.
        should_stop: Called after every update; if it returns True, the run ends with a checkpoint. By default Ctrl-C
            does this.
        initial: A saved policy (`load_policy(path).state`) to start from in place of what `config.initial` says, as it
            is, its exploration and optimiser included. A single policy can be the start of all independent ones.
        logger: Any of TorchRL's loggers (CSV, TensorBoard, W&B); receives every number of every row.
        num_threads: Threads of the simulator; all cores by default. Results do not depend on it.
        start_from: No longer in use: the name of `initial` in earlier versions.

    Raises:
        ValueError: The task, a body or a field cannot be used, or the folder belongs to a run with other settings.
        RunInUseError: Another process or thread works in the folder.
    """
    told: dict[str, Any] = {"progress": progress, "should_stop": should_stop, "logger": logger}
    if start_from is not None:
        warnings.warn("train: start_from is now called initial", DeprecationWarning, stacklevel=2)
        initial = start_from
    if callable(config) and len(old) == 1:
        warnings.warn("train(make_env, ppo) is now Trainer(make_env, ppo).train()", DeprecationWarning, stacklevel=2)
        assert run is None or isinstance(run, RunFolder)
        return Trainer(config, old[0]).train(run=run, initial=initial, **told)
    if old or not isinstance(config, TrainConfig):
        raise ValueError(f"config: got {brief((config, *old))}, expected a TrainConfig")
    settings, config = asdict(config), config.resolved()
    if initial is not None and config.initial not in (AUTO, FRESH):  # the default, and that of stored runs
        raise ValueError(f"initial: got a policy, and {config.initial!r} in the settings too, expected one of them")
    began, policy = ("policy", initial) if initial is not None else _beginning(config)
    with make_trainer(config, num_threads, policy) as trainer:
        if run is None:
            return train_to_the_end(trainer, run=None, **told)
        if not isinstance(run, RunFolder):
            run = RunFolder(run, settings, resume=True)
        run.check_settings(settings)
        with run.lock():
            record = RunRecord(
                "train",
                config.task,
                label=config.material,
                material=config.material,
                bodies=config.bodies,
                stiffness=config.stiffness,
                edge_rule=config.edge_rule,
                seed=config.ppo.seed,
                initial=began,
                origin=find_origin(),
            )
            record.write(run)
            result = train_to_the_end(trainer, run=run, **told)
            final = result.final
            replace(
                record,
                finished=result.finished,
                env_steps=result.env_steps,
                seconds=result.seconds,
                curve=tuple((row["env_steps"], row["score"]) for row in result.rows if "score" in row),
                final=None if final is None else final.summary() | {"ceiling": float(final.ceiling.mean())},
            ).write(run)
    return result


def _beginning(config: TrainConfig) -> tuple[str, dict[str, Any] | None]:
    """Returns what `initial_policy` does; by default, a policy for all bodies begins afresh, as baselines do."""
    word = FRESH if config.initial == AUTO and config.random_bodies is not None else config.initial
    return initial_policy(word, config.task, config.material, config.ppo)


def make_trainer(
    config: TrainConfig, num_threads: int | None = None, initial: Mapping[str, Any] | None = None
) -> Trainer:
    """Returns what trains a policy with these settings, see `train`; ValueError as there."""
    if initial is None:
        _, initial = _beginning(config)
    ppo = config.ppo if initial is None else following(config.ppo, initial)
    bodies, fields = config.designs()
    make_env = partial(
        SoftRobotEnv,
        config.task,
        bodies=bodies,
        material=config.material,
        stiffness=fields,
        edge_rule=config.edge_rule,
        work_weight=config.work_weight,
        num_threads=num_threads,
        grid_shape=config.random_bodies,
    )
    if config.random_bodies is None:
        trainer = Trainer(make_env, ppo)
    else:
        assert config.stiffness is None or isinstance(config.stiffness, float)
        stream = RandomBodies(config.random_bodies, config.stiffness, config.pool)
        trainer = Trainer(partial(make_env, bodies=stream, stiffness=None), ppo, make_env)
    try:
        if initial is not None:
            trainer.start_from(initial)
    except BaseException:
        trainer.close()
        raise
    return trainer
