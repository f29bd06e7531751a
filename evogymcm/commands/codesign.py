"""`evogymcm codesign`: evolve bodies together with their material and control, kept in a run folder."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import arg

from evogymcm._settings import EdgeRule
from evogymcm.algos.codesign.config import CodesignConfig
from evogymcm.commands._errors import checking_arguments
from evogymcm.commands._options import INTERRUPTED, Bar, how_to_resume, open_run, write_stiffness

if TYPE_CHECKING:
    from evogymcm.algos.codesign.run import CodesignProgress, CodesignResult
    from evogymcm.algos.runs.folder import RunFolder

DESCRIPTION = """Evolves bodies together with their material and control, and keeps all of it in a run folder.

arms:
  reactive      bodies evolve, and their policies set stiffness
  fixed         the same with stiffness 1
  invariant     stiffness belongs to the design and is searched, and survivors are fine-tuned
  prescribed    the same with one given stiffness (--prescribed), without search

The --ppo options are those of one body. Ctrl-C stops at the end of the present update; --resume goes on from there.

examples:
  evogymcm codesign Walker-v0 --arm reactive --population 8 --budget 32
  evogymcm codesign BridgeWalker-v0 --arm invariant --max-env-steps 5000000 --search.rounds 10
  evogymcm codesign Walker-v0 --arm fixed --rungs 0.25 0.5 --keep 0.5 0.5 --ppo.total-steps 200000"""


@dataclass(frozen=True)
class Settings(CodesignConfig):
    """The same with the task in front, and choices where tyro can name them."""

    task: Annotated[tyro.conf.Positional[str], arg(metavar="TASK")] = tyro.MISSING
    arm: Literal["reactive", "fixed", "invariant", "prescribed"] = "reactive"
    method: Literal["ga", "random", "qd"] = "ga"
    edge_rule: EdgeRule = "mean_factor"


Settings.__doc__ = CodesignConfig.__doc__  # where tyro finds what the fields mean


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        config: settings of the run.
        run: folder of the run.
        resume: go on with the run in the folder.
        overwrite: replace the run in the folder.
    """

    config: Annotated[Settings, arg(name="")]
    run: Annotated[
        Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: runs/TASK-codesign-ARM-seedSEED)")
    ] = None
    resume: bool = False
    overwrite: bool = False


def without_choices(settings: Any) -> CodesignConfig:
    """Returns the settings of the command line as the library has them: equal to those made there."""
    return CodesignConfig(**{item.name: getattr(settings, item.name) for item in fields(CodesignConfig)})


def run(options: Options, arguments: Sequence[str]) -> int:
    """Evolves and returns the exit status.

    Raises:
        UsageError: An argument cannot be used, or an optional package is missing.
    """
    with checking_arguments():
        config = without_choices(options.config)
        config.check()
        path = options.run or Path("runs") / f"{Path(config.task).stem}-codesign-{config.arm}-seed{config.seed}"
        folder = open_run(path, asdict(config), resume=options.resume, overwrite=options.overwrite)
    return _codesign(config, folder, arguments)


def _codesign(config: CodesignConfig, folder: "RunFolder", arguments: Sequence[str]) -> int:
    from evogymcm.algos.codesign.cost import cost_of
    from evogymcm.algos.codesign.run import codesign
    from evogymcm.algos.learning.memory import keep_freed_memory

    cost = cost_of(config)
    limit = cost.total if config.max_env_steps is None else min(cost.total, config.max_env_steps)
    parts = ", ".join(f"{name} {steps:,}" for name, steps in asdict(cost).items() if steps)
    print(f"{config.budget} bodies, {config.arm} arm: at most {cost.total:,} env-steps ({parts})", flush=True)
    if limit < cost.total:
        print(f"ends with the generation in which {limit:,} env-steps are reached", flush=True)
    with Bar(limit) as bar:
        keep_freed_memory()
        result = codesign(config, run=folder, progress=lambda state: _show(bar, state))
        if result.finished and result.best is not None:  # with what scoring has done since the last update
            bar.show(result.env_steps, {"best": f"{result.best.fitness:.3f}"})
    if result.best is not None:
        _print_best(config, result, folder.path)
    if result.finished:
        return 0
    print(f"stopped after {result.env_steps:,} env-steps; to go on:\n  {how_to_resume('codesign', arguments)}")
    return INTERRUPTED


def _show(bar: Bar, state: "CodesignProgress") -> None:
    numbers = {"generation": str(state.generation), "phase": state.phase, "bodies": str(state.n_designs)}
    if state.best is not None:
        numbers["best"] = f"{state.best:.3f}"
    bar.show(state.env_steps, numbers)


def _print_best(config: CodesignConfig, result: "CodesignResult", path: Path) -> None:
    """Prints the best design with its score, had again in a fresh world."""
    import numpy as np

    from evogymcm.algos.codesign.scoring import score_alone

    assert result.best is not None
    assert result.policy is not None
    design = result.best.design.in_arm(config.arm, config.prescribed)
    alone = score_alone(config.make_arena(), [design], [result.policy])
    score, ceiling = alone.score[0], alone.ceiling[0]
    bound = "" if np.isnan(ceiling) else f" of at most {ceiling:.2f} ({score / ceiling:.1%})"
    print(f"best design, number {result.best.index} (generation {result.best.generation}): {design.body.text}")
    if config.arm == "reactive":
        print("stiffness: set by the policy in every step")
    else:
        print("\n".join(["stiffness:", *write_stiffness(design.field, design.body.occupancy)]))
    print(f"score   {score:.3f}{bound}: its stored policy, deterministic, in a fresh world")
    print(f"return  {alone.returns[0]:.3f}")
    print(f"run     {path} ({result.env_steps:,} env-steps)")
    print(f"watch   evogymcm watch --policy {path}")
    print(f"report  evogymcm report {path}")
