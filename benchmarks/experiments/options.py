"""The command line: an experiment, a size, and every field of its settings."""

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar, Union

import tyro

from benchmarks.experiments import (
    contexts,
    evolved_gaits,
    evolved_robots,
    fixed_robots,
    gaits,
    signals,
    specialists,
    universal,
)
from benchmarks.experiments.experiment import Experiment

EXPERIMENTS: Mapping[str, tuple[str, Mapping[str, Experiment]]] = {  # -> what it is, and its settings in each size
    "A": ("fixed robots, with stiffness control and without", fixed_robots.SIZES),
    "B": ("evolved robots, with stiffness control and without", evolved_robots.SIZES_B),
    "C": ("evolved robots, with searched stiffness fields and without", evolved_robots.SIZES_C),
    "evolve": ("bodies evolved together with their gaits, with stiffness and without", evolved_gaits.SIZES),
    "specialists": ("policies of their own for bodies that have evolved with gaits", specialists.SIZES),
    "universal": ("one policy for every body, scored on unseen ones", universal.SIZES),
    "gaits": ("open-loop gaits of the paper's robots and of random bodies", gaits.SIZES),
    "contexts": ("what a voxel should know of its body", contexts.SIZES),
    "signals": ("what stiffness does in the gaits of finished runs", signals.SIZES),
}
SIZES = ("quick", "small", "paper")
_PROGRAM = "python benchmarks/run_suite.py"
_Settings = TypeVar("_Settings")


@dataclass(frozen=True)
class Options(Generic[_Settings]):
    """Command line of an experiment.

    Attributes:
        experiment: what to run.
        name: its name.
        size: what the other settings are where they are not given.
        output: folder of the results; default runs/EXPERIMENT-SIZE.
        processes: runs side by side; default one per core.
        resume: go on with the runs in the folder.
        overwrite: delete the runs in the folder first.
    """

    experiment: Annotated[_Settings, tyro.conf.arg(name="")]
    name: tyro.conf.Suppress[str]
    size: Literal["quick", "small", "paper"] = "quick"
    output: Path | None = None
    processes: int | None = None
    resume: bool = False
    overwrite: bool = False

    def settings(self) -> dict[str, Any]:
        """Returns what is run, of JSON types."""
        settings = {"experiment": self.name, **asdict(self.experiment)}  # type: ignore[call-overload]
        return json.loads(json.dumps(settings, default=str))  # type: ignore[no-any-return]


@dataclass(frozen=True)
class WriteDocs:
    """Writes the tables of benchmarks/results/, those of docs/results.md, and its figures.

    Attributes:
        figures: whether to draw the figures too (extra "render").
    """

    figures: bool = True


def parse(arguments: Sequence[str]) -> Options[Any] | WriteDocs:
    """Returns what is asked for.

    Raises:
        ValueError: Settings are out of range, or do not go together.
        SystemExit: Help is asked for, or an argument is none of this program's.
    """
    size = _size(arguments)
    commands: list[Any] = [Annotated[WriteDocs, tyro.conf.subcommand("write-docs")]]
    for name, (about, sizes) in EXPERIMENTS.items():
        default = Options(sizes[size], name, size)  # type: ignore[arg-type]
        subcommand = tyro.conf.subcommand(name, default=default, description=about)
        commands.append(Annotated[Options[type(sizes[size])], subcommand])  # type: ignore[misc]
    any_of = Union[tuple(commands)]  # noqa: UP007  known at run time only
    return tyro.cli(any_of, args=arguments, prog="run_suite.py", config=(tyro.conf.AvoidSubcommands,))  # type: ignore[no-any-return]


def _size(arguments: Sequence[str]) -> str:
    """Returns the size that is asked for; it is read first, since it decides what the other settings are."""
    words = [word for argument in arguments for word in argument.split("=", 1)]
    given = words[words.index("--size") + 1 :][:1] if "--size" in words else []
    return given[0] if given and given[0] in SIZES else SIZES[0]


def parse_command(command: str) -> Options[Any]:
    """Returns what a command of `command_of` asks for."""
    asked = parse(shlex.split(command.removeprefix(_PROGRAM)))
    assert isinstance(asked, Options)
    return asked


def command_of(name: str, experiment: Experiment) -> str:
    """Returns the shortest command that asks for these settings of an experiment."""
    commands = []
    for size, default in EXPERIMENTS[name][1].items():
        words = [name, *([] if size == SIZES[0] else ["--size", size])]
        commands.append(words + words_of(experiment, default))
    return f"{_PROGRAM} {shlex.join(min(commands, key=len))}"


def words_of(settings: Any, default: Any) -> list[str]:
    """Returns the options of a command line whose settings would be `default` without them."""
    known = dict(_flat(default))
    return [word for path, value in _flat(settings) if known.get(path, ...) != value for word in _option(path, value)]


def _flat(settings: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the path and value of every setting."""
    for item in fields(settings):
        value = getattr(settings, item.name)
        if is_dataclass(value):
            yield from _flat(value, f"{prefix}{item.name}.")
        else:
            yield prefix + item.name, value


def _option(path: str, value: Any) -> list[str]:
    """Returns the words that set a setting."""
    *parents, last = path.replace("_", "-").split(".")
    if isinstance(value, bool):
        return ["--" + ".".join([*parents, last if value else f"no-{last}"])]
    values = value if isinstance(value, tuple) else (value,)
    return ["--" + ".".join([*parents, last]), *map(str, values)]
