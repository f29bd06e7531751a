"""How stiffness, actuation and contact go together in an episode of a run's policy."""

import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.experiments import figures
from benchmarks.experiments.experiment import Experiment, Record, Tell
from benchmarks.experiments.tables import table, with_interval
from evogymcm._files import write_atomic
from evogymcm.algos.analysis import Signals, analyse_signals, record_episode
from evogymcm.algos.gaits import load_gaits
from evogymcm.algos.runs import load_policy
from evogymcm.algos.runs.record import GAIT

_HEAD = ("score", "same frequency", "lag, degrees", "coherence", "impacts", "rise before impact", "rank")


def analyse_run(folder: Path) -> Signals:
    """Plays an episode with the policy of a run, or its gait, and writes signals.json and signals.png there.

    The figure is left out, with a warning, where matplotlib is not installed.

    Raises:
        ValueError: The run has no policy, or one that does not set stiffness.
    """
    if (folder / GAIT).is_file():
        found = load_gaits(folder / GAIT)
        recording = record_episode(found.waves, found.make_engine(1, num_threads=1))
    else:
        policy = load_policy(folder)
        env = policy.make_env(1, num_threads=1)
        recording = record_episode(policy.module(env), env)
    signals = analyse_signals(recording)
    text = json.dumps(signals.record(), allow_nan=False) + "\n"
    write_atomic(folder / "signals.json", lambda part: part.write_text(text, encoding="utf-8"))
    try:
        figures.signals(signals, folder / "signals.png")
    except ModuleNotFoundError:
        warnings.warn("no signals.png: it needs matplotlib (pip install evogymcm[render])", stacklevel=2)
    return signals


def signals_table(head: Sequence[str], rows: Sequence[tuple[Sequence[str], Mapping[str, Any]]]) -> str:
    """Returns the summaries of signals, each with the cells that name it, in Markdown."""
    lines: list[Sequence[str]] = [(*head, *_HEAD)]
    for cells, row in rows:
        rise, interval = row["rise_before_impact"], row["rise_interval"]
        lines.append(
            (
                *cells,
                f"{row['score']:.2f}",
                f"{_number(row['same_frequency'], '.0%')} of {row['varying']}",
                _number(row["phase_lag"], "+.0f", 180 / math.pi),
                _number(row["coherence"], ".2f"),
                str(row["n_impacts"]),
                "-" if rise is None else with_interval(rise, interval, "+.2f"),
                _number(row["rise_rank"], ".2f"),
            )
        )
    return table(lines)


def _number(value: float | None, form: str, factor: float = 1.0) -> str:
    return "-" if value is None else format(factor * value, form)


@dataclass(frozen=True)
class SignalJob:
    """One run to analyse."""

    run_folder: Path

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.run_folder.name

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Writes signals.json and signals.png into the run's own folder."""
        summary = analyse_run(self.run_folder).summary()
        tell(1, summary["score"])
        return {"run": self.name, "finished": True, **summary}


@dataclass(frozen=True)
class SignalStudy(Experiment):
    """Signals of the last policies of runs with stiffness control; each run's folder gets signals.json and .png.

    Numbers are medians over the actuators whose actuation and stiffness both vary; the rise of stiffness before impact
    has its 95 % interval. A rise's rank is the share of all shifts of the stiffness in time that would give a smaller
    one: 0.5 is chance.

    Attributes:
        folders: of the runs.
    """

    folders: tuple[Path, ...] = ()

    @property
    def steps_per_run(self) -> int:
        """Episodes of each run."""
        return 1

    def jobs(self) -> list[SignalJob]:
        """Returns all runs."""
        if not self.folders:
            raise ValueError("folders: got none, expected the folders of finished runs")
        return [SignalJob(folder) for folder in self.folders]

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns the summaries of all runs."""
        return list(runs)

    def table(self, rows: Sequence[Record]) -> str:
        """Returns a line a run."""
        return signals_table(("run",), [((row["run"],), row) for row in rows])


SIZES: Mapping[str, SignalStudy] = dict.fromkeys(("quick", "small", "paper"), SignalStudy())
