"""The command line: `python -m evogymcm COMMAND`, also installed as `evogymcm`."""

import argparse
import logging
import os
import sys
from collections.abc import Sequence
from types import MappingProxyType, ModuleType
from typing import Any

from evogymcm import __version__
from evogymcm.commands import codesign, report, selfcheck, tasks, train, warmup, watch
from evogymcm.commands._completion import SHELLS, print_completion
from evogymcm.commands._errors import UsageError
from evogymcm.commands._options import INTERRUPTED

_COMMANDS: MappingProxyType[str, ModuleType] = MappingProxyType(
    {
        "warmup": warmup,
        "selfcheck": selfcheck,
        "tasks": tasks,
        "watch": watch,
        "train": train,
        "codesign": codesign,
        "report": report,
    }
)
_BROKEN_PIPE = 141  # exit status, as shells have it
_EXAMPLES = """examples:
  evogymcm tasks
  evogymcm train Walker-v0 --body Walk_Bot --run runs/first
  evogymcm watch --policy runs/first
  evogymcm codesign BridgeWalker-v0 --material invariant --search
  evogymcm COMMAND --help    # all options of a command
  evogymcm --print-completion bash > ~/.local/share/bash-completion/completions/evogymcm"""


class _PrintCompletion(argparse.Action):
    """Prints a completion script, and ends."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option_string: Any = None) -> None:
        subparsers = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
        options = {name: module.options() for name, module in _COMMANDS.items() if hasattr(module, "options")}
        parsers = {name: known for name, known in subparsers.choices.items() if name not in options}
        print_completion(values, parsers, options)
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="evogymcm",
        description="Voxel soft robots with continuous stiffness: simulation, learning, co-design.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"evogymcm {__version__}")
    parser.add_argument(
        "--print-completion",
        action=_PrintCompletion,
        choices=SHELLS,
        help="print the script that lets a shell complete commands and options",
    )
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for command in _COMMANDS.values():
        command.add_parser(subparsers)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command, and returns its exit status: 2 for arguments that can't be used, 130 after Ctrl-C.

    What goes wrong later than that is raised, with its traceback.
    """
    parser = _parser()
    parsed, rest = parser.parse_known_args(arguments)
    if rest and not getattr(parsed, "takes_rest", False):
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    parsed.rest = rest  # for commands whose options are tyro's
    logging.basicConfig(format="%(message)s")
    try:
        status = int(parsed.run(parsed) or 0)
        sys.stdout.flush()
        return status
    except UsageError as error:
        parser.exit(2, f"evogymcm: {error}\n")
    except BrokenPipeError:  # `evogymcm tasks | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nothing more can be said there
        return _BROKEN_PIPE
    except KeyboardInterrupt:
        parser.exit(INTERRUPTED, "evogymcm: interrupted\n")


if __name__ == "__main__":
    sys.exit(main())
