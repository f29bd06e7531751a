"""What an experiment is: settings, runs, a summary, a table, a figure."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Protocol

from benchmarks.experiments.paper import PAPER

Record = dict[str, Any]  # of JSON types
Tell = Callable[[int, float | None], None]  # env-steps done, and the latest score, None where there is no new one


class Job(Protocol):
    """One run."""

    @property
    def name(self) -> str:
        """Name of the run's folder."""

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Does the run in `folder / name` and returns its record, that so far where it is stopped.

        The record is that of `RunRecord.as_dict` and what else is to be told; its `label` is the run's arm.

        Args:
            folder: of the experiment.
            resume: go on with what is there.
            tell: called after every update.
            should_stop: asked after every update.
        """


class Experiment(ABC):
    """Settings of an experiment: a frozen dataclass, from which the command line is built."""

    @property
    @abstractmethod
    def steps_per_run(self) -> int:
        """The most env-steps of a run."""

    @abstractmethod
    def jobs(self) -> Sequence[Job]:
        """Returns all runs, in an order in which an early stop leaves whole comparisons."""

    @abstractmethod
    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns what is to be told of the records of runs, finished or not, as rows of JSON types."""

    @abstractmethod
    def table(self, rows: Sequence[Record]) -> str:
        """Returns the summary in Markdown."""

    def plot(self, runs: Sequence[Record], path: Path) -> None:  # noqa: B027  not all have a figure
        """Draws the runs, where there is something to draw.

        Raises:
            ModuleNotFoundError: matplotlib is not installed.
        """


@dataclass(frozen=True)
class Comparison(Experiment):
    """Every task in every arm with every seed.

    Attributes:
        tasks: ids of tasks.
        arms: what is compared.
        seeds: training seeds.

    Raises:
        ValueError: A task or arm is unknown, or there is none.
    """

    tasks: tuple[str, ...]
    arms: tuple[str, ...]
    seeds: tuple[int, ...]

    @property
    @abstractmethod
    def allowed_arms(self) -> tuple[str, ...]:
        """All arms that there are."""

    @abstractmethod
    def job(self, task: str, arm: str, seed: int) -> Job:
        """Returns one run."""

    def __post_init__(self) -> None:
        for name, given, allowed in (("tasks", self.tasks, PAPER), ("arms", self.arms, self.allowed_arms)):
            unknown = [item for item in given if item not in allowed]
            if unknown or not given or len(set(given)) < len(given):
                raise ValueError(f"{name}: got {list(given)}, allowed are some of {', '.join(allowed)}, each once")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds: got {list(self.seeds)}, expected one or more, each once")

    def jobs(self) -> list[Job]:
        """Returns all runs, seed by seed."""
        return [self.job(task, arm, seed) for seed in self.seeds for task in self.tasks for arm in self.arms]

    def groups(self, runs: Sequence[Record]) -> Iterator[tuple[str, str, list[Record]]]:
        """Yields each task and arm that has runs, in order, with its runs."""
        for task, arm in product(self.tasks, self.arms):
            if group := [run for run in runs if (run["task"], run["label"]) == (task, arm)]:
                yield task, arm, group
