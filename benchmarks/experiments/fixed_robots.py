"""Experiment A, the paper's Table I: one robot a task, trained with stiffness control and without."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import mean, stdev
from typing import Any

from benchmarks.experiments import figures
from benchmarks.experiments.experiment import Comparison, Record
from benchmarks.experiments.paper import CONTROL, FIXED_ARMS, PAPER, TREATED
from benchmarks.experiments.signals import signals_table
from benchmarks.experiments.tables import table, with_interval, with_std
from benchmarks.experiments.training import TrainingJob, best_score
from benchmarks.experiments.tuned import TUNED
from evogymcm.algos.analysis import coverage, difference, improvement, interquartile_mean, normalise
from evogymcm.algos.learning import PPOConfig, TrainConfig
from evogymcm.algos.learning.config import Material

__all__ = ["SIZES", "FixedRobots", "overall"]

KINDS = {"final": "final score", "best": "best in training"}  # scores of a run that are compared


@dataclass(frozen=True)
class FixedRobots(Comparison):
    """One robot for each task, with control of its actuators alone and with control of its stiffness too.

    Each run trains one policy with PPO. Scores are those of the deterministic policy in a fresh world, summed without
    an episode's last step, as in the paper. The last policy's score and the best of training stand apart.

    Attributes:
        tuned: whether tasks have the settings of their own that are known to be better for them (`tuned.py`).
        ppo: settings of each run; its seed comes from `seeds`.
    """

    tasks: tuple[str, ...] = tuple(PAPER)
    arms: tuple[str, ...] = tuple(FIXED_ARMS)
    seeds: tuple[int, ...] = (0, 1, 2)
    tuned: bool = False
    ppo: PPOConfig = field(default_factory=PPOConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.ppo.seed:
            raise ValueError(f"ppo.seed: got {self.ppo.seed}, here it comes from seeds")

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
        return TrainConfig(task, (PAPER[task].robot,), material, ppo=replace(self.ppo, seed=seed, **changes))

    def job(self, task: str, arm: str, seed: int) -> TrainingJob:
        """Returns one run."""
        return TrainingJob(arm, self.settings(task, FIXED_ARMS[arm], seed))

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns one row a task and arm: means and standard deviations over the finished runs' seeds.

        The rows of co-optimisation hold the gain over control-only, where the task has both.
        """
        rows: dict[tuple[str, str], Record] = {}
        for task, arm, group in self.groups([run for run in runs if run["finished"]]):
            row = {"task": task, "arm": arm, "robot": PAPER[task].robot, **_statistics(group)}
            row["paper_score"], row["paper_std"] = PAPER[task].scores[arm]
            rows[task, arm] = row
        for task in self.tasks:
            if (task, CONTROL) in rows and (task, TREATED) in rows:
                rows[task, TREATED]["gain"] = _gain(rows[task, CONTROL], rows[task, TREATED])
        return list(rows.values())

    def table(self, rows: Sequence[Mapping[str, Any]]) -> str:
        """Returns the paper's scores beside ours, the gain of co-optimisation, and what stiffness does in the gaits."""
        parts = [table(_score_lines(rows))]
        if any("gain" in row for row in rows):
            parts += [table(_gain_lines(rows)), table(_overall_lines(overall(rows))), _note(rows)]
        played = [((row["task"], str(s["seed"])), s) for row in rows for s in row["signals"]]
        if played:
            parts.append(signals_table(("stiffness in gaits", "seed"), played))
        return "\n\n".join(parts)

    def plot(self, runs: Sequence[Record], path: Path) -> None:
        """Draws the learning curves, one panel a task."""
        figures.learning_curves(runs, self.tasks, self.arms, path)


def _statistics(group: Sequence[Record]) -> Record:
    """Numbers of one task and arm."""
    columns = {
        "final_score": [run["final"]["score"] for run in group],
        "final_return": [run["final"]["return"] for run in group],
        "best_score": [best_score(run) for run in group],
        "untrained_score": [run["curve"][0][1] for run in group],
    }
    row: Record = {"seeds": len(group), "env_steps": group[0]["env_steps"]}
    for name, values in columns.items():
        row[name] = mean(values)
        row[f"{name}_std"] = stdev(values) if len(values) > 1 else None  # n - 1 in the denominator
    row |= {f"{kind}_scores": columns[f"{kind}_score"] for kind in KINDS}
    fractions = [run["final"].get("fraction_of_ceiling") for run in group]
    row["fraction_of_ceiling"] = None if None in fractions else mean(fractions)
    row["signals"] = [{"seed": run["seed"], **run["signals"]} for run in group if "signals" in run]
    return row


def _gain(control: Record, treated: Record) -> Record:
    """Comparison of the arms of one task."""
    gain: Record = {"paper": treated["paper_score"] - control["paper_score"]}
    for kind in KINDS:
        pair = control[f"{kind}_scores"], treated[f"{kind}_scores"]
        gain[kind], gain[f"{kind}_interval"] = difference(*pair)
        gain[f"{kind}_improvement"] = improvement({"": pair[0]}, {"": pair[1]})[0]
    return gain


def overall(rows: Sequence[Mapping[str, Any]]) -> Record:
    """Returns the comparison over all tasks that have both arms, empty where there is none.

    Scores count in units of the paper's mean of control-only in their task.
    """
    tasks = [row["task"] for row in rows if "gain" in row]
    if not tasks:
        return {}
    units = {task: PAPER[task].scores[CONTROL][0] for task in tasks}
    result: Record = {"tasks": tasks}
    for kind in KINDS:
        arms = {
            arm: normalise(
                {row["task"]: row[f"{kind}_scores"] for row in rows if row["arm"] == arm and row["task"] in tasks},
                units,
            )
            for arm in FIXED_ARMS
        }
        for arm, scores in arms.items():
            result.setdefault(arm, {})[kind] = interquartile_mean(scores)
        result.setdefault("improvement", {})[kind] = improvement(arms[CONTROL], arms[TREATED])
    return result


def _score_lines(rows: Sequence[Mapping[str, Any]]) -> list[Sequence[str]]:
    lines: list[Sequence[str]] = [
        ("task", "arm", "seeds", "env-steps", "untrained", "final score", "of ceiling", "paper", "best in training")
    ]
    for row in rows:
        fraction = row["fraction_of_ceiling"]
        lines.append(
            (
                row["task"],
                row["arm"],
                str(row["seeds"]),
                f"{row['env_steps']:,}",
                f"{row['untrained_score']:.2f}",
                with_std(row["final_score"], row["final_score_std"]),
                "" if fraction is None else f"{fraction:.1%}",
                with_std(row["paper_score"], row["paper_std"]),
                with_std(row["best_score"], row["best_score_std"]),
            )
        )
    return lines


def _gain_lines(rows: Sequence[Mapping[str, Any]]) -> list[Sequence[str]]:
    """Co-optimisation minus control-only, task by task; P is how often a run of the former beats one of the latter."""
    head = ["co-optimisation minus control-only", "seeds"]
    for name in KINDS.values():
        head += [name, "P"]
    lines: list[Sequence[str]] = [[*head, "paper"]]
    control = {row["task"]: row for row in rows if row["arm"] == CONTROL}
    for row in (row for row in rows if "gain" in row):
        gain, seeds = row["gain"], {control[row["task"]]["seeds"], row["seeds"]}
        cells = [row["task"], " and ".join(map(str, sorted(seeds)))]
        for kind in KINDS:
            cells.append(with_interval(gain[kind], gain[f"{kind}_interval"], "+.2f"))
            cells.append(f"{gain[f'{kind}_improvement']:.2f}")
        lines.append([*cells, f"{gain['paper']:+.2f}"])
    return lines


def _overall_lines(total: Record) -> list[Sequence[str]]:
    lines: list[Sequence[str]] = [(f"over {len(total['tasks'])} tasks", *KINDS.values())]
    names = {arm: f"interquartile mean, {arm}" for arm in FIXED_ARMS} | {"improvement": "P, mean over tasks"}
    lines += [(name, *(with_interval(*total[key][kind], ".2f") for kind in KINDS)) for key, name in names.items()]
    return lines


def _note(rows: Sequence[Mapping[str, Any]]) -> str:
    """How the numbers are to be read, with these numbers of seeds."""
    tasks = {row["task"] for row in rows if "gain" in row}
    counts = {row["seeds"] for row in rows if row["task"] in tasks}
    note = (
        "P: how often a run of co-optimisation beats one of control-only. Interquartile means: scores divided by the"
        " paper's control-only mean of their task."
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
