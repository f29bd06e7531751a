"""Shell completion of the whole command line, written by tyro."""

import argparse
from collections.abc import Mapping
from dataclasses import field, make_dataclass
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, Literal, Union

SHELLS = ("bash", "zsh", "fish")


def print_completion(shell: str, parsers: Mapping[str, argparse.ArgumentParser], options: Mapping[str, type]) -> None:
    """Prints the script that a shell reads to complete `evogymcm`.

    Args:
        shell: one of SHELLS.
        parsers: the commands that argparse parses, by name.
        options: the dataclasses of those that tyro parses, by name.
    """
    import tyro

    described = {name: _as_dataclass(name, parser) for name, parser in parsers.items()} | dict(options)
    commands = tuple(Annotated[kind, tyro.conf.subcommand(name, prefix_name=False)] for name, kind in described.items())
    every: Any = Union[commands]  # noqa: UP007  (of a tuple)
    arguments = ["--tyro-print-completion", shell]
    tyro.cli(every, prog="evogymcm", args=arguments, config=(tyro.conf.FlagCreatePairsOff,))


def _as_dataclass(name: str, parser: argparse.ArgumentParser) -> type:
    """Returns a parser's arguments as tyro knows them: names, choices, and which are flags or paths."""
    import tyro

    positional: Any = tyro.conf.Positional
    fields: list[tuple[str, Any, Any]] = []
    for action in parser._actions:  # argparse has no public way to ask
        if isinstance(action, argparse._HelpAction):
            continue
        kind: Any = action.type if action.type in (int, float, Path) else str
        if action.choices:
            kind = Literal[tuple(action.choices)]
        if action.nargs == 0:
            kind = bool
        elif action.nargs in ("+", "*"):
            kind = GenericAlias(tuple, (kind, ...))
        if not action.option_strings:
            kind = positional[kind]
        described = tyro.conf.arg(help=action.help, help_behavior_hint="")
        default = False if kind is bool else tyro.MISSING
        fields.append((action.dest, Annotated[kind, described], field(default=default)))
    return make_dataclass(name, fields, frozen=True)
