"""`evogymcm evolve`: bodies evolve together with gaits, within minutes and without learning."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import arg

from evogymcm.algos.codesign.evolve_config import EvolveConfig
from evogymcm.commands._options import INTERRUPTED, Bar, checking_arguments, how_to_resume, open_run, write_stiffness

if TYPE_CHECKING:
    from evogymcm.algos.codesign import CodesignProgress, EvolveResult

DESCRIPTION = """Evolves bodies together with their gaits (and material), one episode a candidate, without a network.

Ctrl-C stops after the present generation; --resume continues from there.

examples:
  evogymcm evolve Walker-v0
  evogymcm evolve BridgeWalker-v0 --evolves-stiffness
  evogymcm evolve CaveCrawler-v0 --material reactive --max-env-steps 4000000"""


@dataclass(frozen=True)
class Settings(EvolveConfig):
    """The same with the task in front."""

    task: Annotated[tyro.conf.Positional[str], arg(metavar="TASK")] = tyro.MISSING


Settings.__doc__ = EvolveConfig.__doc__  # where tyro finds what the fields mean


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        config: settings of the run.
        run: folder of the run.
        resume: continue the run in the folder.
        overwrite: replace the run in the folder.
    """

    config: Annotated[Settings, arg(name="")]
    run: Annotated[
        Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: runs/TASK-evolve-MATERIAL-seedSEED)")
    ] = None
    resume: bool = False
    overwrite: bool = False


def run(options: Options, arguments: Sequence[str]) -> int:
    """Evolves and returns the exit status."""
    from evogymcm.algos.codesign import evolve
    from evogymcm.algos.codesign.evolution import check_evolution

    with checking_arguments():
        config = EvolveConfig(**{item.name: getattr(options.config, item.name) for item in fields(EvolveConfig)})
        check_evolution(config)
        path = options.run or Path("runs") / f"{Path(config.task).stem}-evolve-{config.material}-seed{config.seed}"
        folder = open_run(path, asdict(config), resume=options.resume, overwrite=options.overwrite)
    with Bar(config.max_env_steps) as bar:

        def show(state: "CodesignProgress") -> None:
            bar.show(state.env_steps, {"generation": str(state.generation), "best": f"{state.best:.3f}"})

        result = evolve(config, run=folder, progress=show)
    if result.best is not None:
        _print_best(config, result, folder.path)
    if result.finished:
        return 0
    print(f"stopped after {result.env_steps:,} env-steps; to go on:\n  {how_to_resume('evolve', arguments)}")
    return INTERRUPTED


def _print_best(config: EvolveConfig, result: "EvolveResult", path: Path) -> None:
    """Prints the best design with its scores."""
    assert result.best is not None
    assert result.waves is not None
    design = result.best.design.at(config.stiffness)
    row = next(row for row in reversed(result.rows) if row["index"] == result.best.index)
    print(f"best design, number {result.best.index} (generation {result.best.generation}): {design.body.text}")
    if config.material == "reactive":
        print("stiffness: set by the gait in every step")
    else:
        print("\n".join(["stiffness:", *write_stiffness(design.field, design.body.occupancy)]))
    print("gait    " + ", ".join(f"{name} {value:.2f}" for name, value in result.waves.settings[0].items()))
    print(f"score   {result.best.fitness:.3f}: an episode of it, from the exact start")
    print(f"return  {row['return']:.3f}")
    if "robust_score" in row:
        hair = f"the score from {config.eval_starts} starts that differ by 1e-6 m"
        print(f"robust  {row['robust_score']:.3f} ± {row['spread']:.3f}: {hair}")
    print(f"run     {path} ({result.env_steps:,} env-steps, {result.played:,} candidates)")
    print(f"watch   evogymcm watch --policy {path}")
    print(f"report  evogymcm report {path}")
