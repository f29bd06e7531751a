"""The command line: `python -m evogymcm COMMAND`, also installed as `evogymcm`."""

import logging
import os
import sys
from collections.abc import Sequence
from dataclasses import make_dataclass
from importlib import import_module
from types import MappingProxyType
from typing import Annotated, Any, Union

import tyro

from evogymcm import __version__
from evogymcm._settings import check_choice
from evogymcm.commands._options import INTERRUPTED, UsageError, checking_arguments

COMMANDS: MappingProxyType[str, str] = MappingProxyType(  # modules of `evogymcm.commands`, and what they do
    {
        "warmup": "compile the simulator once and keep it on disk",
        "selfcheck": "compare this machine's bits with the package's",
        "tasks": "list the tasks: ids, episode lengths, score ceilings, what they ask for",
        "watch": "show robots at work, in a window or as a video",
        "gait": "search for a gait that moves a body, within seconds",
        "evolve": "evolve bodies together with gaits, within minutes",
        "train": "train a policy for given bodies",
        "codesign": "evolve bodies, materials and control together",
        "specialise": "train a policy for each of the best designs of a search",
        "studio": "draw a robot in the browser, and watch it move and learn",
        "report": "make an HTML report of training, co-design or suite folders",
        "export": "write a design as drawing, table and meshes, for fabrication",
    }
)
_BROKEN_PIPE = 141  # exit status, as shells have it
_DESCRIPTION = """Voxel soft robots with continuous stiffness: simulation, learning, co-design.

examples:
  evogymcm tasks
  evogymcm train Walker-v0 --body Walk_Bot --run runs/first
  evogymcm watch --policy runs/first
  evogymcm codesign BridgeWalker-v0 --material invariant --search
  evogymcm COMMAND --help    # all options of a command
  evogymcm --print-completion bash > ~/.local/share/bash-completion/completions/evogymcm
  evogymcm --version"""


def _parse(arguments: Sequence[str]) -> Any:
    """Returns the options of the command, an object of its module's `Options`."""
    is_completed = arguments[:1] == ["--print-completion"]
    if is_completed:  # by tyro, under a name that says so
        check_choice("--print-completion", "".join(arguments[1:]), ("bash", "zsh", "fish"))
        arguments = ["--tyro-print-completion", *arguments[1:]]
    kinds = []
    for name, about in COMMANDS.items():
        kind: Any = make_dataclass(name, ())  # of the others the name is enough; their settings take time to load
        if is_completed or name in arguments[:1]:
            module = import_module(f"evogymcm.commands.{name}")
            kind, about = module.Options, about if is_completed else module.DESCRIPTION
        kinds.append(Annotated[kind, tyro.conf.subcommand(name, prefix_name=False, description=about)])
    every: Any = Union[tuple(kinds)]  # noqa: UP007  (of a tuple)
    config = (tyro.conf.FlagCreatePairsOff,)
    return tyro.cli(every, prog="evogymcm", description=_DESCRIPTION, args=arguments, config=config)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command, and returns its exit status: 2 for arguments that can't be used, 130 after Ctrl-C.

    What goes wrong later than that is raised, with its traceback.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        print(f"evogymcm {__version__}")
        return 0
    logging.basicConfig(format="%(message)s")
    try:
        with checking_arguments():  # what settings say of their values
            if arguments[:1] == ["codesign"]:
                from evogymcm.commands.codesign import in_present_words

                arguments = ["codesign", *in_present_words(arguments[1:])]
            options = _parse(arguments)
        status = int(import_module(f"evogymcm.commands.{arguments[0]}").run(options, arguments[1:]) or 0)
        sys.stdout.flush()
        return status
    except UsageError as error:
        print(f"evogymcm: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # `evogymcm tasks | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nothing more can be said there
        return _BROKEN_PIPE
    except KeyboardInterrupt:
        print("evogymcm: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
