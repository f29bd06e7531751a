"""`evogymcm train`: a policy for one or several bodies, kept in a run folder."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from evogymcm.commands._errors import checking_arguments
from evogymcm.commands._options import (
    INTERRUPTED,
    Bar,
    LoggerName,
    check_logger,
    choose_bodies,
    choose_task,
    how_to_resume,
    make_logger,
    open_run,
    read_stiffness,
)

if TYPE_CHECKING:
    from evogymcm.algos import EnvFactory, PPOConfig, Progress, RunFolder, TrainResult

_DESCRIPTION = """Trains a policy with PPO and keeps it in a run folder.

Ctrl-C stops at the end of the present update; --resume goes on from there.

examples:
  evogymcm train Walker-v0 --body Walk_Bot --total-steps 200000
  evogymcm train Walker-v0 --body HHH/V.V --material invariant --stiffness 2,2,2/0.5,1,0.5
  evogymcm train --world terrain.json --body robot.npz
  evogymcm train Walker-v0 --body Walk_Bot --run runs/first --logger csv
  evogymcm train Walker-v0 --body Walk_Bot --run runs/first --logger csv --resume"""


def add_parser(subparsers: Any) -> None:
    """Adds the command to a parser; its options are tyro's, see `options`."""
    parser = subparsers.add_parser("train", help="train a policy for given bodies", add_help=False)
    parser.set_defaults(run=run, takes_rest=True)


def options() -> type:
    """Returns the dataclass of the command line; making it loads torch."""
    import tyro
    from tyro.conf import arg

    from evogymcm.algos import PPOConfig

    @dataclass(frozen=True)
    class TrainOptions:
        """Options of the command.

        Attributes:
            task: such as Walker-v0; `evogymcm tasks` lists them.
            world: walk in the world of this file instead (.json of the EvoGym Design Tool, or a picture, .txt).
            body: rows of voxels (HHH/S.R), a robot's name or a file (.npz, .npy, .txt, .json); several learn side by
                side.
            material: whether the policy sets stiffness too ("reactive"), or stiffness belongs to the body.
            stiffness: with --material invariant, a number, or numbers in rows like the body's (2,2,2/0.5,1,0.5); one
                for all bodies or one for each.
            edge_rule: how stiffness acts on shared edges.
            run: folder of the run.
            resume: go on with the run in the folder.
            overwrite: replace the run in the folder.
            logger: also write every number with one of TorchRL's loggers; csv and tensorboard write into the run.
            num_threads: threads of the simulator; None for all cores. Results do not depend on it.
            ppo: settings of PPO.
        """

        task: Annotated[tyro.conf.Positional[str], arg(metavar="TASK", help_behavior_hint="(or --world)")] = ""
        world: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
        body: Annotated[tuple[str, ...], arg(metavar="BODY", help_behavior_hint="(default: the task's own robot)")] = ()
        material: Literal["reactive", "invariant"] = "reactive"
        stiffness: Annotated[tuple[str, ...], arg(metavar="FIELD", help_behavior_hint="(default: 1)")] = ()
        edge_rule: Literal["mean_factor", "mean_stiffness"] = "mean_factor"
        run: Annotated[
            Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: runs/TASK-MATERIAL-seedSEED)")
        ] = None
        resume: bool = False
        overwrite: bool = False
        logger: LoggerName = "none"
        num_threads: int | None = None
        ppo: Annotated[PPOConfig, arg(name="")] = field(default_factory=PPOConfig)

    return TrainOptions


def run(args: argparse.Namespace) -> int:
    """Trains and returns the exit status.

    Raises:
        UsageError: An argument cannot be used, or a logger's package is missing.
    """
    from evogymcm.algos import keep_freed_memory, train

    with checking_arguments():
        given, make_env, config, folder = _prepare(args.rest)
        logger = make_logger(given.logger, folder.path)
    with Bar(given.ppo.total_steps) as bar:
        keep_freed_memory()
        result = train(make_env, given.ppo, run=folder, progress=partial(_show, bar, {}), logger=logger)
    folder.write_json("result.json", _record(config, given.ppo, result))
    if result.final is None:
        print(f"stopped after {result.env_steps:,} env-steps; to go on:\n  {how_to_resume('train', args.rest)}")
        return INTERRUPTED
    _print_result(result, config, folder.path)
    return 0


def _prepare(arguments: Sequence[str]) -> "tuple[Any, EnvFactory, dict[str, Any], RunFolder]":
    """Returns the options, what makes environments, the run's settings, and its folder, opened once they are fine."""
    from dataclasses import asdict

    import tyro

    from evogymcm.algos import Trainer
    from evogymcm.body import as_body
    from evogymcm.envs import SoftRobotEnv

    given: Any = tyro.cli(
        options(),
        prog="evogymcm train",
        description=_DESCRIPTION,
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    task = choose_task(given.task, given.world)
    bodies = choose_bodies(given.body, task)
    fields = read_stiffness(given.stiffness, bodies)
    make_env = partial(
        SoftRobotEnv,
        task,
        bodies=[as_body(body) for body in bodies],
        material=given.material,
        stiffness=fields,
        edge_rule=given.edge_rule,
        num_threads=given.num_threads,
    )
    config = {
        "task": task,
        "bodies": bodies,
        "material": given.material,
        "stiffness": None if fields is None else [values.tolist() for values in fields],
        "edge_rule": given.edge_rule,
        "ppo": asdict(given.ppo),
    }
    check_logger(given.logger)
    Trainer(make_env, given.ppo).close()  # what cannot be trained fails here, before a folder is touched
    path = given.run or Path("runs") / f"{Path(task).stem}-{given.material}-seed{given.ppo.seed}"
    return given, make_env, config, open_run(path, config, resume=given.resume, overwrite=given.overwrite)


def _show(bar: Bar, latest: dict[str, str], state: "Progress") -> None:
    """Moves the bar; `latest` keeps the score until the next evaluation."""
    if "score" in state.row:
        latest["score"] = f"{state.row['score']:.3f}"
    bar.show(state.env_steps, latest)


def _record(config: Mapping[str, Any], ppo: "PPOConfig", result: "TrainResult") -> dict[str, Any]:
    """Returns the numbers of a run, named as in the benchmark suite's records."""
    from evogymcm import __version__

    return {
        "evogymcm": __version__,
        "task": config["task"],
        "seed": ppo.seed,
        "robot": ", ".join(config["bodies"]),
        "finished": result.finished,
        "env_steps": result.env_steps,
        "train_seconds": result.seconds,
        "untrained": {key: result.rows[0][key] for key in ("score", "return")},
        "best_score": result.best_score,
        "final": None if result.final is None else result.final.summary(),
        "ceiling": None if result.final is None else float(result.final.ceiling.mean()),
    }


def _print_result(result: "TrainResult", config: Mapping[str, Any], path: Path) -> None:
    import numpy as np

    assert result.final is not None
    final, bodies = result.final, config["bodies"]
    for i, body in enumerate(bodies):
        score, total, ceiling = (
            values[i :: len(bodies)].mean() for values in (final.score, final.returns, final.ceiling)
        )
        bound = "" if np.isnan(ceiling) else f" of at most {ceiling:.2f} ({score / ceiling:.1%})"
        if len(bodies) > 1:
            print(body)
        print(f"score   {score:.3f}{bound}: the final policy, deterministic, in fresh worlds")
        print(f"return  {total:.3f}")
    evaluations = sum("score" in row for row in result.rows)
    over = " (means over the bodies)" if len(bodies) > 1 else ""
    print(f"best    {result.best_score:.3f}: the largest score of {evaluations} evaluations in training{over}")
    print(f"run     {path} ({result.env_steps:,} env-steps, {result.seconds:.0f} s)")
    print(f"watch   evogymcm watch --policy {path}")
    print(f"report  evogymcm report {path}")
