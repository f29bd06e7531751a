"""Compares what a voxel may know of the rest of its body, and the plain network, at equal env-steps.

    python benchmarks/contexts.py
    python benchmarks/contexts.py --tasks Walker-v0 --variants body attention --seeds 0 1 2

Each run trains the policy of one variant for the paper's robot of a task. "none", "body", "message" and "attention" are
contexts of the per-voxel network; "mlp" is the plain one on the flat observation. Scores are those of the
deterministic policy in a fresh world. "mean of curve" is the area under the learning curve over its length. The rate is
that of collecting and learning without evaluations, the median over updates of all runs, with as many processes at work
as results.json says.
"""

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import mean, median, stdev
from typing import Any, Literal

import numpy as np
import tyro
from _machine import commit, machine, usable_cores, versions
from _suite import ARMS, PAPER, Job, Suite
from _text import aligned
from run_suite import run_all

from evogymcm.algos import PPOConfig, RunFolder

VARIANTS: Mapping[str, Mapping[str, str]] = {  # -> settings of PPOConfig
    "none": {"context": "none"},
    "body": {"context": "body"},
    "message": {"context": "message"},
    "attention": {"context": "attention"},
    "mlp": {"network": "mlp"},
}
_COLOURS = dict(zip(VARIANTS, ("0.5", "#0072b2", "#009e73", "#d55e00", "#cc79a7"), strict=True))


@dataclass(frozen=True)
class ContextJob(Job):
    """One training run of one variant."""

    variant: str = "body"

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return f"{self.task}-{self.variant}-seed{self.ppo.seed}"

    def run(
        self, folder: Path, resume: bool, tell: Callable[[int, float | None], None], should_stop: Callable[[], bool]
    ) -> dict[str, Any]:
        """Trains in `folder / name` and returns all numbers of the run, see `Job.run`."""
        record = super().run(folder, resume, tell, should_stop)
        run = RunFolder(folder / self.name, asdict(self), resume=True)
        record |= {"variant": self.variant, "material": ARMS[self.arm]}
        record["mean_of_curve"] = mean_of_curve(record["curve"])
        record["update_seconds"] = update_seconds(run.rows())
        record["frames_per_update"] = self.ppo.frames_per_update
        run.write_json("result.json", record)
        return record


def mean_of_curve(points: Sequence[Sequence[float]]) -> float:
    """Returns the mean score over env-steps of a curve of (env-steps, seconds, score)."""
    steps, _, scores = np.array(points, dtype=np.float64).T
    return float(np.trapezoid(scores, steps) / (steps[-1] - steps[0])) if len(points) > 1 else float(scores[0])


def update_seconds(rows: Sequence[Mapping[str, Any]]) -> list[float]:
    """Returns the seconds of each update of a run's table but the first, which loads kernels, and evaluated ones."""
    pairs = list(pairwise(rows))[1:]
    return [row["seconds"] - before["seconds"] for before, row in pairs if "score" not in row]


@dataclass(frozen=True)
class Comparison(Suite):
    """What to run: every variant on every task with every seed."""

    variants: tuple[str, ...] = tuple(VARIANTS)

    def __post_init__(self) -> None:
        super().__post_init__()
        unknown = [variant for variant in self.variants if variant not in VARIANTS]
        if unknown or not self.variants:
            raise ValueError(f"variants: got {list(self.variants)}, allowed are {', '.join(VARIANTS)}")

    def jobs(self) -> list[Job]:
        """Returns all runs, seed by seed, so that an early stop leaves whole comparisons."""
        return [
            ContextJob(task, arm, replace(self.ppo, seed=seed, **VARIANTS[variant]), variant)
            for seed in self.seeds
            for task in self.tasks
            for arm in self.arms
            for variant in self.variants
        ]


def summarise(runs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Returns one row per task and variant over its finished runs."""
    finished = [run for run in runs if run["finished"]]
    rows = []
    for task in dict.fromkeys(run["task"] for run in finished):
        for variant in VARIANTS:
            group = [run for run in finished if (run["task"], run["variant"]) == (task, variant)]
            if not group:
                continue
            scores = [run["final"]["score"] for run in group]
            seconds = [second for run in group for second in run["update_seconds"]]
            rows.append(
                {
                    "task": task,
                    "variant": variant,
                    "env_steps": group[0]["env_steps"],
                    "scores": scores,
                    "mean": mean(scores),
                    "std": stdev(scores) if len(scores) > 1 else None,
                    "best_in_training": mean(run["best_score"] for run in group),
                    "mean_of_curve": mean(run["mean_of_curve"] for run in group),
                    "env_steps_per_s": group[0]["frames_per_update"] / median(seconds) if seconds else None,
                }
            )
    return rows


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns the summary as text."""
    lines = [("task", "variant", "env-steps", "final score", "of each seed", "best", "mean of curve", "env-steps/s")]
    for row in rows:
        spread = "" if row["std"] is None else f" ({row['std']:.2f})"
        each = " ".join(f"{score:.2f}" for score in row["scores"])
        rate = "" if row["env_steps_per_s"] is None else f"{row['env_steps_per_s']:,.0f}"
        head = (row["task"], row["variant"], f"{row['env_steps']:,}", f"{row['mean']:.2f}{spread}", each)
        lines.append((*head, f"{row['best_in_training']:.2f}", f"{row['mean_of_curve']:.2f}", rate))
    return aligned(lines)


def plot(runs: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draws the learning curves, one panel per task: the mean over seeds, single seeds as thin lines."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    finished = [run for run in runs if run["finished"]]
    tasks = list(dict.fromkeys(run["task"] for run in finished))
    figure, axes = plt.subplots(1, len(tasks), figsize=(5 * len(tasks), 3.6), squeeze=False, layout="constrained")
    for axis, task in zip(axes.flat, tasks, strict=True):
        for variant, colour in _COLOURS.items():
            curves = [np.array(run["curve"]) for run in finished if (run["task"], run["variant"]) == (task, variant)]
            for curve in curves:
                axis.plot(curve[:, 0], curve[:, 2], color=colour, lw=0.6, alpha=0.5)
            if curves:
                axis.plot(curves[0][:, 0], np.mean(curves, 0)[:, 2], color=colour, lw=2, label=variant)
        axis.set(title=f"{task}, {PAPER[task].robot}", xlabel="env-steps", ylabel="score (deterministic policy)")
        axis.legend(fontsize="small")
    figure.savefig(path, dpi=150)
    plt.close(figure)


@dataclass(frozen=True)
class Options:
    """Command line.

    Attributes:
        tasks: tasks, each with the paper's robot.
        variants: of "none", "body", "message", "attention" and "mlp".
        seeds: training seeds.
        total_steps: env-steps of each run.
        num_worlds: worlds simulated together.
        material: "reactive" (policies set stiffness) or "invariant".
        output: folder of the results.
        processes: runs trained side by side; default one per core.
        resume: go on with the runs in the folder.
        overwrite: delete the runs in the folder first.
    """

    tasks: tuple[str, ...] = ("Walker-v0", "DownStepper-v0")
    variants: tuple[str, ...] = tuple(VARIANTS)
    seeds: tuple[int, ...] = (0, 1)
    total_steps: int = 300_000
    num_worlds: int = 64
    material: Literal["reactive", "invariant"] = "reactive"
    output: Path = Path("runs/contexts")
    processes: int | None = None
    resume: bool = False
    overwrite: bool = False

    def comparison(self) -> Comparison:
        """Returns what is asked for.

        Raises:
            ValueError: There is no such task, variant or setting.
        """
        arms = tuple(arm for arm, material in ARMS.items() if material == self.material)
        interval = max(1, self.total_steps // 20)
        ppo = PPOConfig(total_steps=self.total_steps, num_worlds=self.num_worlds, eval_interval=interval)
        return Comparison(self.tasks, arms, self.seeds, ppo, self.variants)


def main(options: Options) -> int:
    """Runs the comparison, writes results.json and curves.png into the folder and prints the table."""
    try:
        comparison = options.comparison()
        run = RunFolder(options.output, asdict(comparison), resume=options.resume, overwrite=options.overwrite)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    except FileExistsError as error:
        print(f"{error} (--resume, --overwrite)", file=sys.stderr)
        return 2
    start = time.perf_counter()
    n_runs = len(comparison.jobs())
    processes = min(options.processes or usable_cores(), n_runs)
    runs = run_all(comparison, options.output, processes, options.resume)
    is_complete = len(runs) == n_runs and all(record["finished"] for record in runs)
    rows = summarise(runs)
    results = {
        "comparison": asdict(comparison),
        "finished": is_complete,
        "processes": processes,
        "machine": machine(),
        "versions": versions(),
        "commit": commit(),
        "wall_seconds": time.perf_counter() - start,
        "summary": rows,
        "runs": runs,
    }
    run.write_json("results.json", results)
    if rows:
        try:
            plot(runs, options.output / "curves.png")
        except ModuleNotFoundError:
            print("No figure: it needs matplotlib (pip install evogymcm[render]).", file=sys.stderr)
    print(table(rows))
    print(f"Results: {options.output.resolve()}")
    if not is_complete:
        print("Not finished; go on with --resume.")
    return 0 if is_complete else 1


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
