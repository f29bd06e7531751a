"""`evogymcm tasks`: a table of the tasks."""

import argparse
from collections.abc import Iterator
from typing import Any, NamedTuple

from evogymcm.commands._options import STANDARD_BODY

_DESCRIPTION = f"""Lists the tasks: episode length in env-steps, score ceiling for the body
{STANDARD_BODY} (empty where a task has none), and what each asks for."""
_EXAMPLES = """examples:
  evogymcm tasks
  evogymcm tasks --long    # also the world, and what a policy observes of it"""


class Row(NamedTuple):
    """One task of the table."""

    id: str
    about: str
    time_limit: int
    ceiling: str


def add_parser(subparsers: Any) -> None:
    """Adds the command to a parser."""
    parser = subparsers.add_parser(
        "tasks",
        help="list the tasks: ids, episode lengths, score ceilings, what they ask for",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--long", action="store_true", help="also the world and what is observed")
    parser.set_defaults(run=run)


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


def run(args: argparse.Namespace) -> int:
    """Prints the table."""
    from evogymcm.envs.tasks import tasks

    head = f"{'id':22}  episode  ceiling  {'about':46}"
    print((head + f"  {'world':22}  observes" if args.long else head).rstrip())
    for row in table():
        line = f"{row.id:22}  {row.time_limit:7}  {row.ceiling:>7}  {row.about:46}"
        if args.long:
            task = tasks[row.id]
            world = task.world if isinstance(task.world, str) else "(its own)"
            line += f"  {world:22}  {', '.join(task.observes)}"
        print(line.rstrip())
    return 0
