"""Table and figure of a suite's runs."""

from collections.abc import Sequence
from pathlib import Path
from statistics import mean, stdev
from typing import Any

from _suite import ARMS, PAPER

_COLOURS = dict(zip(ARMS, ("#0072b2", "#d55e00"), strict=True))


def summarise(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Returns one row per task and arm: means and standard deviations over the finished runs' seeds."""
    rows = []
    for task in PAPER:
        for arm in ARMS:
            group = [run for run in runs if run["task"] == task and run["arm"] == arm and run["finished"]]
            if group:
                rows.append({"task": task, "arm": arm, "robot": PAPER[task].robot, **_statistics(group)})
                rows[-1]["paper_score"], rows[-1]["paper_std"] = PAPER[task].scores[arm]
    return rows


def _statistics(group: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Numbers of one task and arm."""
    columns = {
        "final_score": [run["final"]["score"] for run in group],
        "final_return": [run["final"]["return"] for run in group],
        "best_score": [run["best_score"] for run in group],
        "untrained_score": [run["untrained"]["score"] for run in group],
    }
    row: dict[str, Any] = {"seeds": len(group), "env_steps": group[0]["env_steps"]}
    for name, values in columns.items():
        row[name] = mean(values)
        row[f"{name}_std"] = stdev(values) if len(values) > 1 else None  # n - 1 in the denominator
    fractions = [run["final"].get("fraction_of_ceiling") for run in group]
    row["fraction_of_ceiling"] = None if None in fractions else mean(fractions)
    return row


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Returns the summary as text, the paper's scores beside ours."""
    head = ("task", "arm", "seeds", "env-steps", "untrained", "final score", "of ceiling", "paper", "best in training")
    lines = [head]
    for row in rows:
        fraction = row["fraction_of_ceiling"]
        lines.append(
            (
                row["task"],
                row["arm"],
                str(row["seeds"]),
                f"{row['env_steps']:,}",
                f"{row['untrained_score']:.2f}",
                _with_std(row["final_score"], row["final_score_std"]),
                "" if fraction is None else f"{fraction:.1%}",
                _with_std(row["paper_score"], row["paper_std"]),
                _with_std(row["best_score"], row["best_score_std"]),
            )
        )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)


def _with_std(value: float, std: float | None) -> str:
    return f"{value:.2f}" if std is None else f"{value:.2f} ({std:.2f})"


def plot(runs: Sequence[dict[str, Any]], path: Path) -> None:
    """Draws the learning curves, one panel per task, one line per run; the untrained policy is the point at 0."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    tasks = [task for task in PAPER if any(run["task"] == task for run in runs)]
    columns = min(3, len(tasks))
    shape = (-(-len(tasks) // columns), columns)
    figure, axes = plt.subplots(*shape, figsize=(4.8 * columns, 3.4 * shape[0]), squeeze=False, layout="constrained")
    for axis, task in zip(axes.flat, tasks, strict=False):
        _panel(axis, task, [run for run in runs if run["task"] == task])
    for axis in axes.flat[len(tasks) :]:
        axis.set_axis_off()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _panel(axis: Any, task: str, runs: Sequence[dict[str, Any]]) -> None:
    """Curves of one task."""
    labelled = set()
    for run in runs:
        arm = run["arm"]
        steps, scores = [point[0] for point in run["curve"]], [point[2] for point in run["curve"]]
        axis.plot(steps, scores, color=_COLOURS[arm], lw=1.2, label=None if arm in labelled else arm)
        axis.plot(steps[:1], scores[:1], "o", color=_COLOURS[arm], ms=4)
        labelled.add(arm)
    untrained = mean(run["untrained"]["score"] for run in runs)
    axis.axhline(untrained, color="0.6", lw=0.8, ls="--", label="untrained policy")
    for arm in (arm for arm in ARMS if arm in labelled):
        axis.axhline(PAPER[task].scores[arm][0], color=_COLOURS[arm], lw=0.8, ls=":", label=f"paper, {arm}")
    axis.set(title=f"{task}, {runs[0]['robot']}", xlabel="env-steps", ylabel="score (deterministic policy)")
    axis.ticklabel_format(axis="x", style="sci", scilimits=(0, 0))
    axis.legend(fontsize="x-small")
