"""`evogymcm codesign`: evolve bodies together with their material and control, kept in a run folder."""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import arg

from evogymcm.algos.codesign.config import CodesignConfig, SearchConfig
from evogymcm.algos.runs.older import of_arm
from evogymcm.commands._options import (
    INTERRUPTED,
    Bar,
    checking_arguments,
    how_to_resume,
    open_run,
    print_beginning,
    work_lines,
    write_stiffness,
)

if TYPE_CHECKING:
    from evogymcm.algos.codesign import CodesignProgress, CodesignResult

DESCRIPTION = """Evolves bodies together with their material and control, and keeps all of it in a run folder.

materials:
  --material reactive                     bodies evolve, and their policies set stiffness
  --material invariant                    bodies evolve, with stiffness 1
  --material invariant --stiffness 1.5    the same with another stiffness of all voxels
  --material invariant --search           stiffness belongs to the design and is searched, and survivors are fine-tuned

Any of the --search options turns the search on. The --ppo options are those of one body. Ctrl-C stops at the end of the
present update; --resume continues from there.

examples:
  evogymcm codesign Walker-v0 --population 8 --budget 32
  evogymcm codesign BridgeWalker-v0 --material invariant --max-env-steps 5000000 --search.rounds 10
  evogymcm codesign Walker-v0 --material invariant --rungs 0.25 0.5 --keep 0.5 0.5 --ppo.total-steps 200000"""


@dataclass(frozen=True)
class Settings(CodesignConfig):
    """The same with the task in front, and without the search, which is optional as a whole."""

    task: Annotated[tyro.conf.Positional[str], arg(metavar="TASK")] = tyro.MISSING
    search: Annotated[SearchConfig | None, tyro.conf.Suppress] = None


Settings.__doc__ = CodesignConfig.__doc__  # where tyro finds what the fields mean


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        config: settings of the run.
        has_search: search the survivors' stiffness fields, then fine-tune.
        search: settings of that search.
        run: folder of the run.
        resume: continue the run in the folder.
        overwrite: replace the run in the folder.
        workers: processes over which the pieces of a generation spread; the result does not depend on them.
    """

    config: Annotated[Settings, arg(name="")]
    has_search: Annotated[bool, arg(name="search")] = False
    search: SearchConfig = field(default_factory=SearchConfig)
    run: Annotated[
        Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: runs/TASK-codesign-MATERIAL-seedSEED)")
    ] = None
    resume: bool = False
    overwrite: bool = False
    workers: Annotated[
        int | None, arg(metavar="INT", help_behavior_hint="(default: as many as there are cores, 1 for a short run)")
    ] = None


def in_present_words(arguments: Sequence[str]) -> list[str]:
    """Returns arguments of `codesign` with `--arm` and `--prescribed` as they are written today, and says so."""
    rest = [part for item in arguments for part in (item.split("=", 1) if item.startswith("--") else [item])]
    old: dict[str, str] = {}
    for name in ("arm", "prescribed"):
        while f"--{name}" in rest:
            place = rest.index(f"--{name}")
            old[name] = "".join(rest[place + 1 : place + 2])
            del rest[place : place + 2]
    if not old:
        return list(arguments)
    now = of_arm(old.get("arm", "reactive"), old.get("prescribed", "1.0"), ["--search"])
    words = ["--material", now["material"]]
    words += now["search"] or ([] if now["stiffness"] == 1.0 else ["--stiffness", now["stiffness"]])
    if not now["search"]:  # whose options had no effect then
        for place in [i for i, item in enumerate(rest) if item.startswith("--search.")][::-1]:
            del rest[place : place + 2]
    said = " ".join(f"--{name} {value}" for name, value in old.items())
    print(f"evogymcm: {said} is of before and will go; write {' '.join(words)}", file=sys.stderr)
    return [*rest, *words]


def config_of(options: Options, arguments: Sequence[str]) -> CodesignConfig:
    """Returns the settings of the run, with a search where any of its options is among the arguments."""
    settings = {item.name: getattr(options.config, item.name) for item in fields(CodesignConfig)}
    has_search = any(argument.startswith("--search") for argument in arguments)
    return CodesignConfig(**settings | {"search": options.search if has_search else None})


def run(options: Options, arguments: Sequence[str]) -> int:
    """Evolves and returns the exit status."""
    from evogymcm.algos.codesign import codesign, cost_of
    from evogymcm.algos.codesign.codesigning import count_workers
    from evogymcm.algos.codesign.start import check_start
    from evogymcm.algos.learning import keep_freed_memory

    with checking_arguments():
        config = config_of(options, arguments)
        workers = count_workers(config, options.workers)
        check_start(config)
        path = options.run or Path("runs") / f"{Path(config.task).stem}-codesign-{config.material}-seed{config.seed}"
        folder = open_run(path, asdict(config), resume=options.resume, overwrite=options.overwrite)
    cost = cost_of(config)
    limit = cost.total if config.max_env_steps is None else min(cost.total, config.max_env_steps)
    parts = ", ".join(f"{name} {steps:,}" for name, steps in asdict(cost).items() if steps)
    kind = config.material + (", with a search of stiffness" if config.search else "")
    print(f"{config.budget} bodies, {kind}: at most {cost.total:,} env-steps ({parts})", flush=True)
    if workers > 1:
        print(f"spread over {workers} processes", flush=True)
    if limit < cost.total:
        print(f"ends with the generation in which {limit:,} env-steps are reached", flush=True)
    with Bar(limit) as bar:
        keep_freed_memory()
        result = codesign(config, run=folder, progress=lambda state: _show(bar, state), workers=workers)
        if result.finished and result.best is not None:  # with what scoring has done since the last update
            bar.show(result.env_steps, {"best": f"{result.best.fitness:.3f}"})
    if result.best is not None:
        _print_best(config, result, folder.path)
        print_beginning(folder)
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
    """Prints the best design with its score, played again in a fresh world."""
    import numpy as np

    from evogymcm.algos.codesign import score_alone
    from evogymcm.algos.codesign.start import env_maker

    assert result.best is not None
    assert result.policy is not None
    design = result.best.design.at(config.stiffness)
    alone = score_alone(env_maker(config), [design], [result.policy], starts=config.eval_starts)
    score, ceiling = alone.score[0], alone.ceiling[0]
    bound = "" if np.isnan(ceiling) else f" of at most {ceiling:.2f} ({score / ceiling:.1%})"
    print(f"best design, number {result.best.index} (generation {result.best.generation}): {design.body.text}")
    if config.material == "reactive":
        print("stiffness: set by the policy in every step")
    else:
        print("\n".join(["stiffness:", *write_stiffness(design.field, design.body.occupancy)]))
    print(f"score   {score:.3f}{bound}: its stored policy, deterministic, in a fresh world")
    print(f"return  {alone.returns[0]:.3f}")
    if config.eval_starts > 1:
        hair = f"the score from {config.eval_starts} starts that differ by 1e-6 m"
        print(f"robust  {alone.robust[0]:.3f} ± {alone.spread[0]:.3f}: {hair}")
    for line in work_lines(alone.row(0)):
        print(line)
    print(f"run     {path} ({result.env_steps:,} env-steps)")
    print(f"watch   evogymcm watch --policy {path}")
    print(f"report  evogymcm report {path}")
