"""`evogymcm tasks`: a table of the tasks."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from evogymcm.algos.learning.bodies import STANDARD_BODY

ABOUT: Mapping[str, str] = {  # what each task asks for; the order is that of the tables
    "Walker-v0": "walk on flat ground",
    "BridgeWalker-v0": "cross a soft bridge",
    "DownStepper-v0": "go down stairs",
    "CaveCrawler-v0": "get through a low cave",
    "AreaMaximizer-v0": "grow the convex hull",
    "AreaMinimizer-v0": "shrink the convex hull",
    "WingspanMazimizer-v0": "grow wide",
    "HeightMaximizer-v0": "grow tall",
    "BidirectionalWalker-v0": "walk to and fro between random goals",
    "UpStepper-v0": "climb stairs",
    "ObstacleTraverser-v0": "walk over bumps",
    "ObstacleTraverser-v1": "walk over rough ground",
    "Hurdler-v0": "get over hurdles",
    "PlatformJumper-v0": "move along platforms at different heights",
    "GapJumper-v0": "move along platforms with gaps",
    "Traverser-v0": "cross a pit of loose blocks",
    "Carrier-v0": "carry a soft package",
    "Carrier-v1": "carry a rigid package to a table",
    "Pusher-v0": "push a soft package",
    "Pusher-v1": "drag a rigid package",
    "Thrower-v0": "throw a package",
    "Catcher-v0": "catch a package that falls from a random place",
    "BeamToppler-v0": "topple a beam",
    "BeamSlider-v0": "slide a beam",
    "Lifter-v0": "lift a package out of a pit",
    "Climber-v0": "climb a pipe",
    "Climber-v1": "climb a pipe with soft walls",
    "Climber-v2": "climb a winding pipe",
    "Flipper-v0": "turn over and over",
    "Jumper-v0": "jump on the spot",
    "Balancer-v0": "balance on a pole",
    "Balancer-v1": "get onto a pole",
    "CaveCrawler-v1": "climb through a cave",
    "HoleCrawler-v0": "get through a hole",
}

DESCRIPTION = f"""Lists the tasks: episode length in env-steps, score ceiling for the body
{STANDARD_BODY} (empty where a task has none), and what each asks for.

examples:
  evogymcm tasks
  evogymcm tasks --long    # also the world, and what a policy observes of it"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        long: also the world and what is observed.
    """

    long: bool = False


class Row(NamedTuple):
    """One task of the table."""

    id: str
    about: str
    time_limit: int
    ceiling: str


def table() -> Iterator[Row]:
    """Yields the tasks: those of the EvoGymCM paper first, then the others, then those registered by users."""
    import numpy as np

    from evogymcm.envs.core import TaskEngine
    from evogymcm.envs.tasks import tasks

    for name in (*ABOUT, *sorted(set(tasks) - set(ABOUT))):
        if name in tasks:
            ceiling = TaskEngine(name, STANDARD_BODY, num_threads=1, with_voxels=False).score_ceiling[0]
            text = "" if np.isnan(ceiling) else f"{ceiling:.2f}"
            yield Row(name, ABOUT.get(name, ""), tasks[name].time_limit, text)


def run(options: Options, arguments: Sequence[str]) -> int:
    """Prints the table."""
    from evogymcm.envs.tasks import tasks

    head = f"{'id':22}  episode  ceiling  {'about':46}"
    print((head + f"  {'world':22}  observes" if options.long else head).rstrip())
    for row in table():
        line = f"{row.id:22}  {row.time_limit:7}  {row.ceiling:>7}  {row.about:46}"
        if options.long:
            task = tasks[row.id]
            world = task.world if isinstance(task.world, str) else "(its own)"
            line += f"  {world:22}  {', '.join(task.observes)}"
        print(line.rstrip())
    return 0
