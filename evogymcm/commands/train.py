"""`evogymcm train`: a policy for one or several bodies, kept in a run folder."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import arg

from evogymcm._settings import EdgeRule, Material, WorkWeight
from evogymcm.algos.learning.config import INITIAL, PPOConfig, TrainConfig
from evogymcm.commands._options import (
    INTERRUPTED,
    Bar,
    LoggerName,
    check_logger,
    checking_arguments,
    choose_task,
    how_to_resume,
    make_logger,
    open_run,
    print_beginning,
    read_stiffness,
    show_training,
    work_lines,
)

if TYPE_CHECKING:  # torch is loaded when a command runs, not for its help
    from evogymcm.algos.learning import TrainResult

DESCRIPTION = """Trains a policy with PPO and keeps it in a run folder.

Ctrl-C stops at the end of the present update; --resume continues from there.

examples:
  evogymcm train Walker-v0 --body Walk_Bot --total-steps 200000
  evogymcm train Walker-v0 --body HHH/V.V --stiffness 2,2,2/0.5,1,0.5
  evogymcm train Walker-v0 --body HHH/V.V --material reactive
  evogymcm train Walker-v0 --random-bodies 5 5 --hidden 64
  evogymcm train Walker-v0 --body HHH/V.V --initial baseline --total-steps 50000
  evogymcm train --world terrain.json --body robot.npz
  evogymcm train Walker-v0 --body Walk_Bot --run runs/first --logger csv
  evogymcm train Walker-v0 --body Walk_Bot --run runs/first --logger csv --resume"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        task: id of the task, such as Walker-v0; `evogymcm tasks` lists all.
        world: walk in the world of this file instead (.json of the EvoGym Design Tool, or a picture, .txt).
        body: rows of voxels (HHH/S.R), a robot's name or a file (.npz, .npy, .txt, .json); several learn side by
            side.
        random_bodies: rows and columns of random bodies, a fresh one in every episode; evaluations use others.
        pool: train on so many different random bodies instead of fresh ones.
        material: whether the policy sets stiffness too ("reactive"), or stiffness belongs to the body.
        stiffness: invariant only: a number, or numbers in rows like the body's (2,2,2/0.5,1,0.5); one for all bodies
            or one for each.
        edge_rule: how stiffness acts on shared edges.
        work_weight: what a unit of supplied work costs in reward, or one number for actuation and one for stiffness; 0
            has it measured.
        initial: what the weights are at first: "fresh", the package's "baseline" ("baseline:TASK" or
            "baseline:TASK:MATERIAL" for another's), "auto" (the baseline where there is one and bodies are given), or
            the policy of a run. Exploration begins with `initial_std` in any case.
        run: folder of the run.
        resume: continue the run in the folder.
        overwrite: replace the run in the folder.
        logger: also write every number with one of TorchRL's loggers; csv and tensorboard write into the run's folder.
        num_threads: threads of the simulator; None for all cores. Results do not depend on it.
        ppo: settings of PPO.
    """

    task: Annotated[tyro.conf.Positional[str], arg(metavar="TASK", help_behavior_hint="(or --world)")] = ""
    world: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    body: Annotated[tuple[str, ...], arg(metavar="BODY", help_behavior_hint="(default: the task's own robot)")] = ()
    random_bodies: Annotated[
        tuple[int, int] | None, arg(metavar="ROWS COLUMNS", help_behavior_hint="(default: BODY)")
    ] = None
    pool: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: no limit)")] = None
    material: Material = "invariant"
    stiffness: Annotated[tuple[str, ...], arg(metavar="FIELD", help_behavior_hint="(default: 1)")] = ()
    edge_rule: EdgeRule = "mean_factor"
    work_weight: WorkWeight = None
    initial: Annotated[str, arg(metavar="fresh|baseline[:TASK[:MATERIAL]]|auto|RUN")] = INITIAL
    run: Annotated[Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: runs/TASK-MATERIAL-seedSEED)")] = (
        None
    )
    resume: bool = False
    overwrite: bool = False
    logger: LoggerName = "none"
    num_threads: int | None = None
    ppo: Annotated[PPOConfig, arg(name="")] = field(default_factory=PPOConfig)


def run(options: Options, arguments: Sequence[str]) -> int:
    """Trains and returns the exit status."""
    from evogymcm.algos.learning import keep_freed_memory, train
    from evogymcm.algos.learning.training import make_trainer

    with checking_arguments():
        config = _config(options)
        check_logger(options.logger)
        make_trainer(config, options.num_threads).close()  # what cannot be trained fails before a folder is touched
        path = options.run or Path("runs") / f"{Path(config.task).stem}-{config.material}-seed{config.ppo.seed}"
        folder = open_run(path, asdict(config), resume=options.resume, overwrite=options.overwrite)
        logger = make_logger(options.logger, folder.path)
    with Bar(config.ppo.total_steps) as bar:
        keep_freed_memory()
        show = partial(show_training, bar, {})
        result = train(config, run=folder, progress=show, logger=logger, num_threads=options.num_threads)
    if result.final is None:
        print(f"stopped after {result.env_steps:,} env-steps; to go on:\n  {how_to_resume('train', arguments)}")
        return INTERRUPTED
    _print_result(result, config.bodies or ("random bodies",), folder.path)
    print_beginning(folder)
    return 0


def _config(options: Options) -> TrainConfig:
    """Returns the settings of the run, with bodies that mean the same wherever it is looked at."""
    task = choose_task(options.task, options.world)
    config = TrainConfig(
        task,
        options.body,
        options.material,
        edge_rule=options.edge_rule,
        random_bodies=options.random_bodies,
        pool=options.pool,
        work_weight=options.work_weight,
        ppo=options.ppo,
        initial=options.initial,
    ).resolved()
    is_stream = config.random_bodies is not None
    fields = read_stiffness(options.stiffness, ["H"] if is_stream else config.bodies)
    if fields is not None and is_stream:  # a number: what fits a single voxel
        return replace(config, stiffness=fields[0].item())
    return config if fields is None else replace(config, stiffness=tuple(rows.tolist() for rows in fields))


def _print_result(result: "TrainResult", bodies: Sequence[str], path: Path) -> None:
    import numpy as np

    from evogymcm.algos.learning.evaluation import mean_work

    assert result.final is not None
    final = result.final
    for i, body in enumerate(bodies):
        score, total, ceiling = (
            values[i :: len(bodies)].mean() for values in (final.score, final.returns, final.ceiling)
        )
        bound = "" if np.isnan(ceiling) else f" of at most {ceiling:.2f} ({score / ceiling:.1%})"
        if len(bodies) > 1:
            print(body)
        print(f"score   {score:.3f}{bound}: the final policy, deterministic, in fresh worlds")
        print(f"return  {total:.3f}")
        if len(final.starts) > 1:
            robust, spread = (values[i :: len(bodies)].mean() for values in (final.robust, final.spread))
            print(
                f"robust  {robust:.3f} ± {spread:.3f}: the score from {len(final.starts)} starts that differ by 1e-6 m"
            )
    for line in work_lines(mean_work(final.work)):
        print(line)
    evaluations = sum("score" in row for row in result.rows)
    over = " (means over the bodies)" if len(bodies) > 1 else ""
    print(f"best    {result.best_score:.3f}: the largest score of {evaluations} evaluations in training{over}")
    print(f"run     {path} ({result.env_steps:,} env-steps, {result.seconds:.0f} s)")
    print(f"watch   evogymcm watch --policy {path}")
    print(f"report  evogymcm report {path}")
