"""`evogymcm gait`: a walk for any body within seconds, without learning."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import arg

from evogymcm._settings import EdgeRule, Material
from evogymcm.algos.gaits.config import GaitConfig
from evogymcm.algos.learning.bodies import default_body
from evogymcm.commands._options import INTERRUPTED, Bar, checking_arguments, choose_task, read_stiffness

if TYPE_CHECKING:
    import numpy as np

DESCRIPTION = """Searches for the wave of actuation that brings a body furthest, without a network.

examples:
  evogymcm gait Walker-v0 --body HHH/V.V --out walk.json
  evogymcm watch --policy walk.json
  evogymcm gait CaveCrawler-v0 --material reactive --env-steps 200000"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        task: id of the task, such as Walker-v0; `evogymcm tasks` lists all.
        world: walk in the world of this file instead (.json of the EvoGym Design Tool, or a picture, .txt).
        body: rows of voxels (HHH/S.R), a robot's name or a file (.npz, .npy, .txt, .json); each gets a gait of its own.
        material: "reactive" (stiffness is part of the gait) or "invariant" (it belongs to the body).
        stiffness: invariant setting only: a number, or numbers in rows like the body's (2,2,2/0.5,1,0.5); one for all
            bodies or one for each.
        edge_rule: how stiffness acts on shared edges.
        out: file to write; an earlier one is replaced.
        num_threads: threads of the simulator; the gait does not depend on them.
        search: settings of the search.
    """

    task: Annotated[tyro.conf.Positional[str], arg(metavar="TASK")] = "Walker-v0"
    world: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    body: Annotated[
        tuple[str, ...], arg(metavar="BODY", help_behavior_hint="(default: the task's own robot, or the standard one)")
    ] = ()
    material: Material = "invariant"
    stiffness: Annotated[tuple[str, ...], arg(metavar="FIELD", help_behavior_hint="(default: 1)")] = ()
    edge_rule: EdgeRule = "mean_factor"
    out: Annotated[Path, arg(metavar="FILE")] = Path("gait.json")
    num_threads: int | None = None
    search: Annotated[GaitConfig, arg(name="")] = field(default_factory=GaitConfig)


def run(options: Options, arguments: Sequence[str]) -> int:
    """Searches, writes the file and returns the exit status."""
    from evogymcm.algos.gaits import save_gaits, search_gaits
    from evogymcm.algos.gaits.search import trial_lengths
    from evogymcm.algos.runs.folder import stop_on_interrupt
    from evogymcm.body import as_body
    from evogymcm.envs import TaskEngine
    from evogymcm.envs.tasks import as_task

    with checking_arguments():
        if options.out.suffix != ".json":
            raise ValueError(f"out: got {options.out}, expected a file .json")
        task = choose_task(options.task, options.world)
        texts = list(options.body or [default_body(task)])
        bodies = [as_body(text) for text in texts]
        fields = read_stiffness(options.stiffness, bodies)
        worlds = {"material": options.material, "stiffness": fields, "edge_rule": options.edge_rule}
        TaskEngine(task, bodies, with_voxels=False, with_flat=False, **worlds).close()  # before a search: can it be?
        trial_lengths(task, options.search)
        if not options.out.parent.is_dir():
            raise ValueError(f"out: the folder {options.out.parent} does not exist")
    with stop_on_interrupt() as is_stopped, Bar(options.search.env_steps) as bar:

        def show(done: int, best: "np.ndarray") -> None:
            bar.show(done, {"score": f"{best.mean():.3f}"})

        found = search_gaits(
            task,
            bodies,
            options.search,
            progress=show,
            should_stop=is_stopped,
            num_threads=options.num_threads,
            **worlds,
        )
    save_gaits(options.out, found, task, texts, stiffness=fields, edge_rule=options.edge_rule)
    trial = "score" if found.curve[-1][1] == as_task(task).time_limit else "score of short trials"
    for body, score, steps in zip(bodies, found.score, found.env_steps, strict=True):
        print(f"{body.text}: {trial} {score:.3f} after {steps:,} env-steps")
    print(f"wrote {options.out}; see it: evogymcm watch --policy {options.out}")
    return 0 if found.finished else INTERRUPTED
