"""`evogymcm tasks`: a table of the tasks."""

import argparse
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Adds the command to a parser."""
    parser = subparsers.add_parser("tasks", help="list the tasks: ids, worlds, episode lengths, observed parts")
    parser.set_defaults(run=run)


def run(_: argparse.Namespace) -> int:
    """Prints the table."""
    from evogymcm.envs.tasks import tasks

    print(f"{'id':24}{'world':24}{'limit':>6}  observes")
    for task in tasks.values():
        name = task.world if isinstance(task.world, str) else "(its own)"
        print(f"{task.id:24}{name:24}{task.time_limit:6}  {', '.join(task.observes)}")
    return 0
