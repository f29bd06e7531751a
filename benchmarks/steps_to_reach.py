"""Compares how many env-steps two suites of co-design need for the same score.

    python benchmarks/steps_to_reach.py runs/suite-reactive-small runs/suite-reactive-shortcuts

The score to reach is, task by task and arm by arm, the mean final best of the first suite's seeds. Both counts are of
simulated env-steps of all kinds, evaluations included, read from the curves of the mean over seeds and of single seeds.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from _codesign_report import best_at
from _text import aligned

Run = Mapping[str, Any]


def load(folder: Path) -> list[Run]:
    """Returns the runs of a suite's results.json.

    Raises:
        ValueError: There is none, or it is not one of co-design.
    """
    path = folder / "results.json"
    if not path.is_file():
        raise ValueError(f"{folder}: has no results.json; expected the folder of a finished suite")
    runs = json.loads(path.read_text(encoding="utf-8"))["runs"]
    if not all("experiment" in run for run in runs):
        raise ValueError(f"{folder}: holds no co-design, expected experiment B or C")
    return [run for run in runs if run["curve"]]


def mean_curve(runs: Sequence[Run]) -> tuple[np.ndarray, np.ndarray]:
    """Returns env-steps and the mean best score there, NaN before every seed has one, up to the shortest run's end."""
    end = min(run["curve"][-1][0] for run in runs)
    steps = np.unique([point[0] for run in runs for point in run["curve"] if point[0] <= end])
    return steps, np.mean([best_at(run["curve"], steps) for run in runs], axis=0)


def steps_to(goal: float, steps: np.ndarray, best: np.ndarray) -> float | None:
    """Returns the env-steps at which the best score first was the goal; None where it never was."""
    reached = np.flatnonzero(best >= goal)
    return float(steps[reached[0]]) if len(reached) else None


def compare(plain: Sequence[Run], other: Sequence[Run]) -> list[dict[str, Any]]:
    """Returns a row for each task and arm that both suites have."""
    rows = []
    for task, arm in dict.fromkeys((run["task"], run["arm"]) for run in plain):
        group, rivals = ([run for run in runs if (run["task"], run["arm"]) == (task, arm)] for runs in (plain, other))
        if not rivals:
            continue
        curve = mean_curve(group)
        goal = float(curve[1][-1])
        ours, theirs = steps_to(goal, *curve), steps_to(goal, *mean_curve(rivals))
        singles = [steps_to(goal, *np.array(run["curve"]).T) for run in rivals]
        rows.append(
            {
                "task": task,
                "arm": arm,
                "score": goal,
                "steps": ours,
                "other_steps": theirs,
                "share": None if ours is None or theirs is None else theirs / ours,
                "other_steps_of_each_seed": singles,
                "other_final": float(mean_curve(rivals)[1][-1]),
            }
        )
    return rows


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns the comparison as text."""

    def count(steps: float | None) -> str:
        return "never" if steps is None else f"{steps:,.0f}"

    lines = [("task", "arm", "score", "env-steps", "the other's", "share", "of each seed", "the other's final")]
    for row in rows:
        share = "" if row["share"] is None else f"{row['share']:.2f}"
        each = " ".join(count(steps) for steps in row["other_steps_of_each_seed"])
        counts = (count(row["steps"]), count(row["other_steps"]), share, each, f"{row['other_final']:.2f}")
        lines.append((row["task"], row["arm"], f"{row['score']:.2f}", *counts))
    return aligned(lines)


def main(arguments: Sequence[str]) -> int:
    """Prints the table; 2 for arguments that can't be used."""
    if len(arguments) != 2:
        print("usage: steps_to_reach.py PLAIN OTHER (folders of suites)", file=sys.stderr)
        return 2
    try:
        plain, other = (load(Path(folder)) for folder in arguments)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    print(table(compare(plain, other)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
