"""Experiment A, the paper's Table I: one robot a task, trained with stiffness control and without."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from statistics import mean, median
from typing import Any

from benchmarks.experiments import figures
from benchmarks.experiments.experiment import Comparison, Record
from benchmarks.experiments.observations import anticipation_table
from benchmarks.experiments.paper import CONTROL, FIXED_ARMS, PAPER, TREATED
from benchmarks.experiments.signals import signals_table
from benchmarks.experiments.tables import table, with_interval
from benchmarks.experiments.training import TrainingJob, best_score, first_at
from benchmarks.experiments.tuned import TUNED
from evogymcm.algos.analysis import coverage, difference, improvement, interquartile_mean, normalise, summarise
from evogymcm.algos.learning import PPOConfig, TrainConfig
from evogymcm.algos.learning.config import FRESH, Material
from evogymcm.algos.learning.initial import find_initial

KINDS = {"final": "final score", "best": "best in training"}  # scores of a run that are compared
Pairs = Mapping[str, tuple[Record, Record]]  # task -> rows of both arms


@dataclass(frozen=True)
class FixedRobots(Comparison):
    """One robot for each task, with control of its actuators alone and with control of its stiffness too.

    Each run trains one policy with PPO. Scores are those of the deterministic policy in a fresh world, summed without
    an episode's last step, as in the paper. The last policy's score and the best of training stand apart.

    Attributes:
        tuned: whether tasks have the settings of their own that are known to be better for them (`tuned.py`).
        initial: what weights are at first, see `TrainConfig`; fresh, as in the paper, by default.
        ppo: settings of each run; its seed comes from `seeds`.
    """

    tasks: tuple[str, ...] = tuple(PAPER)
    arms: tuple[str, ...] = tuple(FIXED_ARMS)
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    tuned: bool = False
    initial: str = FRESH
    ppo: PPOConfig = field(default_factory=PPOConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.ppo.seed:
            raise ValueError(f"ppo.seed: got {self.ppo.seed}, here it comes from seeds")
        for material in FIXED_ARMS.values():
            for task in self.tasks:
                find_initial(self.initial, task, material, self.ppo)  # is there one?

    @property
    def allowed_arms(self) -> tuple[str, ...]:
        """All arms that there are."""
        return tuple(FIXED_ARMS)

    @property
    def steps_per_run(self) -> int:
        """Env-steps of each run, in whole rollouts."""
        return -(-self.ppo.total_steps // self.ppo.frames_per_update) * self.ppo.frames_per_update

    def settings(self, task: str, material: Material, seed: int, **changes: Any) -> TrainConfig:
        """Returns the settings of a run on the paper's robot of the task, with changes of those of PPO."""
        if self.tuned and task in TUNED:
            changes = {**TUNED[task].ppo, **changes}
        ppo = replace(self.ppo, seed=seed, **changes)
        return TrainConfig(task, (PAPER[task].robot,), material, ppo=ppo, initial=self.initial)

    def job(self, task: str, arm: str, seed: int) -> TrainingJob:
        """Returns one run."""
        return TrainingJob(arm, self.settings(task, FIXED_ARMS[arm], seed))

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns one row a task and arm: scores of the finished runs, one a seed, and the paper's."""
        rows = []
        for task, arm, group in self.groups([run for run in runs if run["finished"]]):
            fractions = [run["final"].get("fraction_of_ceiling") for run in group]
            paper, paper_std = PAPER[task].scores[arm]
            steps, seconds = (median(column) for column in zip(*(first_at(run, paper) for run in group), strict=True))
            rows.append(
                {
                    "task": task,
                    "arm": arm,
                    "env_steps": group[0]["env_steps"],
                    "untrained": mean(run["curve"][0][1] for run in group),
                    "final": [run["final"]["score"] for run in group],
                    "fraction_of_ceiling": None if None in fractions else mean(fractions),
                    "best": [best_score(run) for run in group],
                    "paper_score": paper,
                    "paper_std": paper_std,
                    "steps_to_paper": steps if isfinite(steps) else None,
                    "seconds_to_paper": seconds if isfinite(seconds) else None,
                    "signals": [{"seed": run["seed"], **run["signals"]} for run in group if "signals" in run],
                }
            )
        return rows

    def table(self, rows: Sequence[Record]) -> str:
        """Returns the paper's scores beside ours, the gain of co-optimisation, and what stiffness does in the gaits."""
        parts = [table(_score_lines(rows))]
        found = {(row["task"], row["arm"]): row for row in rows}
        pairs = {
            task: (found[task, CONTROL], found[task, TREATED])
            for task in self.tasks
            if {(task, arm) for arm in FIXED_ARMS} <= found.keys()
        }
        if pairs:
            parts += [table(_gain_lines(pairs)), table(_overall_lines(pairs)), _note(pairs)]
        played = [((row["task"], str(s["seed"])), s) for row in rows for s in row["signals"]]
        if played:
            parts.append(signals_table(("stiffness in gaits", "seed"), played))
            parts.append(anticipation_table([(task, signals) for (task, _), signals in played]))
        return "\n\n".join(parts)

    def plot(self, runs: Sequence[Record], path: Path) -> None:
        """Draws the learning curves, one panel a task."""
        figures.learning_curves(runs, self.tasks, self.arms, path)


def _score_lines(rows: Sequence[Record]) -> list[Sequence[str]]:
    head = ("task", "arm", "seeds", "env-steps", "untrained", "final score", "of ceiling", "paper", "best in training")
    lines: list[Sequence[str]] = [[*head, "to the paper's", "seconds"]]
    for row in rows:
        final, best, fraction = summarise(row["final"]), summarise(row["best"]), row["fraction_of_ceiling"]
        cells = [row["task"], row["arm"], str(final.n), f"{row['env_steps']:,}", f"{row['untrained']:.2f}", str(final)]
        cells += ["" if fraction is None else f"{fraction:.1%}", f"{row['paper_score']:.2f} ({row['paper_std']:.2f})"]
        reached = (row["steps_to_paper"], row["seconds_to_paper"])
        lines.append([*cells, str(best), *("-" if value is None else f"{value:,.0f}" for value in reached)])
    return lines


def _gain_lines(pairs: Pairs) -> list[Sequence[str]]:
    """Co-optimisation minus control-only, task by task; P is how often a run of the former beats one of the latter."""
    names = [cell for name in KINDS.values() for cell in (name, "P")]
    lines: list[Sequence[str]] = [["co-optimisation minus control-only", "seeds", *names, "paper"]]
    for task, (control, treated) in pairs.items():
        cells = [task, " and ".join(map(str, sorted({len(control["final"]), len(treated["final"])})))]
        for kind in KINDS:
            cells.append(with_interval(*difference(control[kind], treated[kind]), "+.2f"))
            cells.append(f"{improvement({task: control[kind]}, {task: treated[kind]})[0]:.2f}")
        lines.append([*cells, f"{treated['paper_score'] - control['paper_score']:+.2f}"])
    return lines


def _overall_lines(pairs: Pairs) -> list[Sequence[str]]:
    """All tasks together, where scores count in units of the paper's mean of control-only in their task."""
    units = {task: PAPER[task].scores[CONTROL][0] for task in pairs}
    columns = []
    for kind in KINDS:
        arms = [normalise({task: pair[i][kind] for task, pair in pairs.items()}, units) for i in range(2)]
        columns.append([interquartile_mean(arms[0]), interquartile_mean(arms[1]), improvement(*arms)])
    names = [*(f"interquartile mean, {arm}" for arm in FIXED_ARMS), "P, mean over tasks"]
    cells = [[with_interval(*found, ".2f") for found in row] for row in zip(*columns, strict=True)]
    head = (f"over {len(pairs)} tasks", *KINDS.values())
    return [head, *((name, *row) for name, row in zip(names, cells, strict=True))]


def _note(pairs: Pairs) -> str:
    """How the numbers are to be read, with these numbers of seeds."""
    counts = {len(row["final"]) for pair in pairs.values() for row in pair}
    note = (
        "To the paper's: env-steps, and seconds of training and evaluations with as many processes side by side as are"
        " named below, until an evaluation is at the paper's score; medians over seeds. P: how often a run of"
        " co-optimisation beats one of control-only. Interquartile means: scores divided by the paper's control-only"
        " mean of their task."
    )
    if max(counts) > 1:
        seeds = min(counts - {1})
        note += (
            f" In brackets: 95 % bootstrap intervals over seeds. With {seeds} seeds an arm they are too narrow: in"
            f" simulation, with normal scores, that of a difference holds the true one in {coverage(seeds):.0%} of"
            " cases."
        )
    if 1 in counts:
        note += " One seed says nothing about the spread: an arm with a single one has no interval."
    return note


SIZES: Mapping[str, FixedRobots] = {
    "quick": FixedRobots(("Walker-v0",), seeds=(0,), ppo=PPOConfig(total_steps=500_000)),
    "small": FixedRobots(ppo=PPOConfig(total_steps=600_000, eval_interval=20_000)),
    "paper": FixedRobots(ppo=PPOConfig(total_steps=1_000_000)),
}
