"""The command line: `python -m evogymcm COMMAND`, also installed as `evogymcm`."""

import argparse
import logging
import sys
from collections.abc import Sequence

from evogymcm import __version__
from evogymcm.commands import tasks, warmup, watch

_COMMANDS = (warmup, tasks, watch)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command, and returns its exit status: 2 for arguments that can't be used."""
    parser = argparse.ArgumentParser(prog="evogymcm", description="Voxel soft robots with continuous stiffness.")
    parser.add_argument("--version", action="version", version=f"evogymcm {__version__}")
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for command in _COMMANDS:
        command.add_parser(subparsers)
    parsed = parser.parse_args(arguments)
    logging.basicConfig(format="%(message)s")
    try:
        return int(parsed.run(parsed) or 0)
    except ValueError as error:
        parser.exit(2, f"evogymcm: {error}\n")


if __name__ == "__main__":
    sys.exit(main())
