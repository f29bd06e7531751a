"""One training run of the paper's robot of a task: what experiment A and the comparison of contexts consist of."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from math import inf
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.experiments.experiment import Record, Tell
from benchmarks.experiments.signals import analyse_run
from evogymcm.algos.learning import Progress, TrainConfig, train
from evogymcm.algos.runs import RunFolder, RunRecord


@dataclass(frozen=True)
class TrainingJob:
    """One training run."""

    arm: str
    config: TrainConfig

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return f"{self.config.task}-{self.arm}-seed{self.config.ppo.seed}"

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Trains in `folder / name`; a finished run with stiffness control gets signals.json and signals.png too."""

        def progress(state: Progress) -> None:
            tell(state.env_steps, state.row.get("score"))

        run = RunFolder(folder / self.name, {"label": self.arm, **asdict(self.config)}, resume=resume)
        result = train(self.config, run=run, progress=progress, should_stop=should_stop, num_threads=1)
        record = RunRecord.read(run.path).as_dict()
        record["times"] = [row["seconds"] for row in result.rows if "score" in row]  # of the curve's points
        record["env_steps_per_s"] = rate(result.rows, self.config.ppo.frames_per_update)
        if result.finished and self.config.material == "reactive":
            record["signals"] = analyse_run(run.path).summary()
        return record


def first_at(run: Mapping[str, Any], score: float) -> tuple[float, float]:
    """Returns the env-steps and seconds until an evaluation is at or above a score; infinite where none is."""
    points = zip(run["curve"], run["times"], strict=True)
    return next(((steps, seconds) for (steps, value), seconds in points if value >= score), (inf, inf))


def best_score(run: Mapping[str, Any]) -> float:
    """Returns the largest score of a run's evaluations."""
    return max(score for _, score in run["curve"])


def mean_of_curve(points: Sequence[Sequence[float]]) -> float:
    """Returns the area under a curve of (env-steps, score) over its length."""
    steps, scores = np.array(points, dtype=np.float64).T
    return float(np.trapezoid(scores, steps) / (steps[-1] - steps[0])) if len(points) > 1 else float(scores[0])


def rate(rows: Sequence[Mapping[str, Any]], frames: int) -> float | None:
    """Returns env-steps/s of collecting and learning: the median over updates without evaluations.

    The first update is left out, since it loads kernels; None where no other is there.
    """
    pairs = list(pairwise(rows))[1:]
    seconds = [row["seconds"] - before["seconds"] for before, row in pairs if "score" not in row]
    return frames / median(seconds) if seconds else None
