"""Tables and figure of a suite's runs."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from statistics import mean, stdev
from typing import Any

import _text
import numpy as np
from _comparison import Interval, coverage, difference, improvement, interquartile_mean, normalise
from _suite import ARMS, PAPER

CONTROL, TREATED = ARMS
KINDS = {"final": "final score", "best": "best in training"}  # scores of a run that are compared
_COLOURS = dict(zip(ARMS, ("#0072b2", "#d55e00"), strict=True))

Row = dict[str, Any]
Line = tuple[str, ...]


def summarise(runs: Sequence[Row]) -> list[Row]:
    """Returns one row per task and arm: means and standard deviations over the finished runs' seeds.

    The rows of co-optimisation hold the gain over control-only, where the task has both.
    """
    rows: list[Row] = []
    for task in PAPER:
        of_task: dict[str, Row] = {}
        for arm in ARMS:
            group = [run for run in runs if run["task"] == task and run["arm"] == arm and run["finished"]]
            if group:
                of_task[arm] = {"task": task, "arm": arm, "robot": PAPER[task].robot, **_statistics(group)}
                of_task[arm]["paper_score"], of_task[arm]["paper_std"] = PAPER[task].scores[arm]
        if len(of_task) == len(ARMS):
            of_task[TREATED]["gain"] = _gain(of_task[CONTROL], of_task[TREATED])
        rows += of_task.values()
    return rows


def _statistics(group: Sequence[Row]) -> Row:
    """Numbers of one task and arm."""
    columns = {
        "final_score": [run["final"]["score"] for run in group],
        "final_return": [run["final"]["return"] for run in group],
        "best_score": [run["best_score"] for run in group],
        "untrained_score": [run["untrained"]["score"] for run in group],
    }
    row: Row = {"seeds": len(group), "env_steps": group[0]["env_steps"]}
    for name, values in columns.items():
        row[name] = mean(values)
        row[f"{name}_std"] = stdev(values) if len(values) > 1 else None  # n - 1 in the denominator
    row |= {f"{kind}_scores": columns[f"{kind}_score"] for kind in KINDS}
    fractions = [run["final"].get("fraction_of_ceiling") for run in group]
    row["fraction_of_ceiling"] = None if None in fractions else mean(fractions)
    return row


def _gain(control: Row, treated: Row) -> Row:
    """Comparison of the arms of one task."""
    gain: Row = {"paper": treated["paper_score"] - control["paper_score"]}
    for kind in KINDS:
        pair = control[f"{kind}_scores"], treated[f"{kind}_scores"]
        gain[kind], gain[f"{kind}_interval"] = difference(*pair)
        gain[f"{kind}_improvement"] = improvement({"": pair[0]}, {"": pair[1]})[0]
    return gain


def overall(rows: Sequence[Row]) -> Row:
    """Returns the comparison over all tasks that have both arms, empty where there is none.

    Scores count in units of the paper's mean of control-only in their task.
    """
    tasks = [row["task"] for row in rows if "gain" in row]
    if not tasks:
        return {}
    units = {task: PAPER[task].scores[CONTROL][0] for task in tasks}
    result: Row = {"tasks": tasks}
    for kind in KINDS:
        arms = {
            arm: normalise(
                {r["task"]: r[f"{kind}_scores"] for r in rows if r["arm"] == arm and r["task"] in tasks}, units
            )
            for arm in ARMS
        }
        for arm, scores in arms.items():
            value, interval = interquartile_mean(scores)
            result.setdefault(arm, {})[kind] = {"interquartile_mean": value, "interval": interval}
        value, interval = improvement(arms[CONTROL], arms[TREATED])
        result.setdefault("improvement", {})[kind] = {"probability": value, "interval": interval}
    return result


def table(rows: Sequence[Row]) -> str:
    """Returns the summary as text: the paper's scores beside ours, then the gain of co-optimisation."""
    parts = [_text.aligned(_score_lines(rows))]
    if any("gain" in row for row in rows):
        parts += [
            _text.aligned(_gain_lines(rows)),
            _text.aligned(_overall_lines(rows)),
            textwrap.fill(_note(rows), 120),
        ]
    return "\n\n".join(parts)


def markdown(rows: Sequence[Row]) -> str:
    """Returns the same tables as Markdown."""
    parts = [_text.markdown(_score_lines(rows))]
    if any("gain" in row for row in rows):
        parts += [_text.markdown(_gain_lines(rows)), _text.markdown(_overall_lines(rows)), _note(rows)]
    return "\n\n".join(parts) + "\n"


def _score_lines(rows: Sequence[Row]) -> list[Line]:
    head = ("task", "arm", "seeds", "env-steps", "untrained", "final score", "of ceiling", "paper", "best in training")
    lines: list[Line] = [head]
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
    return lines


def _gain_lines(rows: Sequence[Row]) -> list[Line]:
    """Co-optimisation minus control-only, task by task; P is how often a run of the former beats one of the latter."""
    head = ["co-optimisation minus control-only", "seeds"]
    for name in KINDS.values():
        head += [name, "P"]
    lines: list[Line] = [(*head, "paper")]
    control = {row["task"]: row for row in rows if row["arm"] == CONTROL}
    for row in (row for row in rows if "gain" in row):
        gain, seeds = row["gain"], {control[row["task"]]["seeds"], row["seeds"]}
        cells = [row["task"], " and ".join(map(str, sorted(seeds)))]
        for kind in KINDS:
            cells += [
                _with_interval(gain[kind], gain[f"{kind}_interval"], "+.2f"),
                f"{gain[f'{kind}_improvement']:.2f}",
            ]
        lines.append((*cells, f"{gain['paper']:+.2f}"))
    return lines


def _overall_lines(rows: Sequence[Row]) -> list[Line]:
    total = overall(rows)
    lines: list[Line] = [(f"over {len(total['tasks'])} tasks", *KINDS.values())]
    for arm in ARMS:
        cells = [_with_interval(total[arm][k]["interquartile_mean"], total[arm][k]["interval"], ".2f") for k in KINDS]
        lines.append((f"interquartile mean, {arm}", *cells))
    chances = [total["improvement"][kind] for kind in KINDS]
    cells = [_with_interval(chance["probability"], chance["interval"], ".2f") for chance in chances]
    return [*lines, ("P, mean over tasks", *cells)]


def _note(rows: Sequence[Row]) -> str:
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


def _with_std(value: float, std: float | None) -> str:
    return f"{value:.2f}" if std is None else f"{value:.2f} ({std:.2f})"


def _with_interval(value: float, interval: Interval | None, form: str) -> str:
    if interval is None:
        return format(value, form)
    return f"{value:{form}} [{interval[0]:{form}}, {interval[1]:{form}}]"


def plot(runs: Sequence[Row], path: Path) -> None:
    """Draws the learning curves, one panel per task: single runs thin, their mean bold, their range as a band."""
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


def _panel(axis: Any, task: str, runs: Sequence[Row]) -> None:
    """Curves of one task."""
    for arm in ARMS:
        curves = [np.array(run["curve"])[:, [0, 2]].T for run in runs if run["arm"] == arm and run["curve"]]
        if not curves:
            continue
        colour = _COLOURS[arm]
        for steps, scores in curves:
            axis.plot(steps, scores, color=colour, lw=0.6, alpha=0.5)
        grid, scores = common_curve(curves)
        name = f"{arm}, mean and range of {len(curves)} seeds" if len(curves) > 1 else arm
        axis.plot(grid, scores.mean(0), color=colour, lw=1.6, label=name)
        axis.fill_between(grid, scores.min(0), scores.max(0), color=colour, alpha=0.12, lw=0)
        axis.axhline(PAPER[task].scores[arm][0], color=colour, lw=0.8, ls=":", label=f"paper, {arm}")
    untrained = mean(run["untrained"]["score"] for run in runs)
    axis.axhline(untrained, color="0.6", lw=0.8, ls="--", label="untrained policy")
    axis.set(title=f"{task}, {runs[0]['robot']}", xlabel="env-steps", ylabel="score (deterministic policy)")
    axis.ticklabel_format(axis="x", style="sci", scilimits=(0, 0))
    axis.legend(fontsize="x-small")


def common_curve(curves: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the env-steps (n,) of all (2, ...) curves up to the end of the shortest, and (runs, n) scores there."""
    end = min(steps[-1] for steps, _ in curves)
    grid = np.unique(np.concatenate([steps[steps <= end] for steps, _ in curves]))
    return grid, np.stack([np.interp(grid, steps, scores) for steps, scores in curves])
