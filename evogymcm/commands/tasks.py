"""`evogymcm tasks`: a table of the tasks."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from evogymcm.algos.learning.bodies import STANDARD_BODY

DESCRIPTION = f"""Lists the tasks: episode length in env-steps, score ceiling for the body
{STANDARD_BODY} (empty where a task has none), and what each asks for.

examples:
  evogymcm tasks
  evogymcm tasks --long    # also the world, and what a policy observes of it"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        long: also show the world and what is observed.
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

    from evogymcm.body import robot_tasks
    from evogymcm.envs import TaskEngine
    from evogymcm.envs.tasks import tasks

    for name in dict.fromkeys((*robot_tasks.values(), *tasks)):
        ceiling = TaskEngine(name, STANDARD_BODY, num_threads=1, with_voxels=False).score_ceiling[0]
        text = "" if np.isnan(ceiling) else f"{ceiling:.2f}"
        yield Row(name, tasks[name].about, tasks[name].time_limit, text)


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
