"""`evogymcm specialise`: a policy for each of the best designs that a search has left behind."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import arg

from evogymcm.algos.codesign.specialist_config import SpecialistConfig
from evogymcm.commands._options import INTERRUPTED, Bar, checking_arguments, how_to_resume, open_run, show_training

DESCRIPTION = """Trains a policy for each of the best designs of a run of evolve or codesign, for that design alone.

It is kept as a run of train in the folder `specialists` of the search. The --ppo options are those of one design.
Ctrl-C stops at the end of the present update; --resume continues from there.

examples:
  evogymcm specialise runs/walk
  evogymcm specialise runs/walk --count 1 --ppo.total-steps 500000"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        search: folder of the search.
        config: settings.
        run: folder of this training.
        resume: continue the run in the folder.
        overwrite: replace the run in the folder.
        num_threads: threads of the simulator; None for all cores. Results do not depend on it.
    """

    search: Annotated[tyro.conf.Positional[Path], arg(metavar="RUN")]
    config: Annotated[SpecialistConfig, arg(name="")] = field(default_factory=SpecialistConfig)
    run: Annotated[Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: RUN/specialists)")] = None
    resume: bool = False
    overwrite: bool = False
    num_threads: int | None = None


def run(options: Options, arguments: Sequence[str]) -> int:
    """Trains and returns the exit status."""
    from evogymcm.algos.codesign.specialists import FOLDER, settings_of, specialise
    from evogymcm.algos.learning import keep_freed_memory

    with checking_arguments():
        settings = settings_of(options.search, options.config)
        path = options.run or options.search / FOLDER
        folder = open_run(path, asdict(settings), resume=options.resume, overwrite=options.overwrite)
    print(f"{len(settings.bodies)} designs, {settings.material}: {settings.ppo.total_steps:,} env-steps", flush=True)
    with Bar(settings.ppo.total_steps) as bar:
        keep_freed_memory()
        show = partial(show_training, bar, {})
        found = specialise(options.search, options.config, run=folder, progress=show, num_threads=options.num_threads)
    if not found.finished:
        print(f"stopped after {found.env_steps:,} env-steps; to go on:\n  {how_to_resume('specialise', arguments)}")
        return INTERRUPTED
    for row in found.table():
        print(f"design {row['index']}: {row['body']}")
        before, now = row["before"], row["now"]
        print(f"robust  {now['score']:.3f} ± {now['spread']:.3f}, in the search {before['score']:.3f}")
        print(f"return  {now['return']:.3f}, in the search {before['return']:.3f}")
    print(f"run     {path} ({found.env_steps:,} env-steps)")
    print(f"watch   evogymcm watch --policy {path}/best.pt")
    return 0
