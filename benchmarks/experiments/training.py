"""One training run of the paper's robot of a task: what experiment A and the comparison of contexts consist of."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.experiments import signals
from benchmarks.experiments.experiment import Record, Tell
from benchmarks.experiments.paper import PAPER
from evogymcm import robots
from evogymcm.algos import PPOConfig, Progress, RunFolder, train
from evogymcm.envs import SoftRobotEnv

__all__ = ["TrainingJob", "finished_runs", "mean_of_curve", "rate"]


@dataclass(frozen=True)
class TrainingJob:
    """One training run of the paper's robot of a task."""

    task: str
    arm: str
    material: str
    ppo: PPOConfig

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return f"{self.task}-{self.arm}-seed{self.ppo.seed}"

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Trains in `folder / name`; a finished run with stiffness control gets signals.json and signals.png too."""

        def progress(state: Progress) -> None:
            tell(state.env_steps, state.row.get("score"))

        robot = robots[PAPER[self.task].robot]
        run = RunFolder(folder / self.name, asdict(self), resume=resume)
        make_env = partial(SoftRobotEnv, self.task, bodies=robot, material=self.material, num_threads=1)
        result = train(make_env, self.ppo, run=run, progress=progress, should_stop=should_stop)
        curve = [[row["env_steps"], row["seconds"], row["score"]] for row in result.rows if "score" in row]
        record: Record = {
            "task": self.task,
            "arm": self.arm,
            "material": self.material,
            "seed": self.ppo.seed,
            "robot": PAPER[self.task].robot,
            "finished": result.finished,
            "env_steps": result.env_steps,
            "train_seconds": result.seconds,
            "env_steps_per_s": rate(result.rows, self.ppo.frames_per_update),
            "untrained": {key: result.rows[0][key] for key in ("score", "return")},
            "best_score": result.best_score,
            "mean_of_curve": mean_of_curve(curve),
            "final": None if result.final is None else result.final.summary(),
            "ceiling": None if result.final is None else float(result.final.ceiling[0]),
            "curve": curve,
        }
        run.write_json("result.json", record)
        if result.finished and self.material == "reactive":
            record["signals"] = signals.analyse_run(run.path, self.task, robot).summary()
            run.write_json("result.json", record)
        return record


def mean_of_curve(points: Sequence[Sequence[float]]) -> float:
    """Returns the area under a curve of (env-steps, seconds, score) over its length."""
    steps, _, scores = np.array(points, dtype=np.float64).T
    return float(np.trapezoid(scores, steps) / (steps[-1] - steps[0])) if len(points) > 1 else float(scores[0])


def rate(rows: Sequence[Mapping[str, Any]], frames: int) -> float | None:
    """Returns env-steps/s of collecting and learning: the median over updates without evaluations.

    The first update is left out, since it loads kernels; None where no other is there.
    """
    pairs = list(pairwise(rows))[1:]
    seconds = [row["seconds"] - before["seconds"] for before, row in pairs if "score" not in row]
    return frames / median(seconds) if seconds else None


def finished_runs(runs: Sequence[Record], task: str, arm: str) -> list[Record]:
    """Returns the finished runs of a task and arm."""
    return [run for run in runs if (run["task"], run["arm"]) == (task, arm) and run["finished"]]
