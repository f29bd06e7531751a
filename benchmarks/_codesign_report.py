"""Tables and figures of co-design runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from _codesign import PUBLISHED_BODIES
from _comparison import mean_interval
from _suite import PAPER
from _text import aligned

PUBLISHED: Mapping[str, float] = {  # best returns of published runs of EvoGym's genetic algorithm
    "Walker-v0": 10.55,
    "BridgeWalker-v0": 3.87,
    "DownStepper-v0": 4.90,
    "CaveCrawler-v0": 4.41,
    "AreaMaximizer-v0": 2.52,
    "AreaMinimizer-v0": 0.81,
}
COLOURS: Mapping[str, str] = {
    "fixed": "#0072b2",
    "prescribed": "#0072b2",
    "reactive": "#d55e00",
    "invariant": "#009e73",
}


def best_at(points: Sequence[Sequence[float]], steps: Sequence[float] | np.ndarray) -> np.ndarray:
    """Returns the best fitness that a run had at each number of env-steps, NaN before its first."""
    at, best = np.array(points).T
    place = np.searchsorted(at, steps, side="right") - 1
    return np.where(place >= 0, best[place.clip(0)], np.nan)


def summarise(runs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Returns one row per task and arm: best fitness over the seeds, where the shortest run of the task ended.

    A phase's result is there at its end only, so that a cut shortly before the end of a generation takes all of it from
    a run. Hence `ends`, the best of whole runs, which end within a phase of each other.
    """
    rows = []
    for task in PAPER:
        of_task = [run for run in runs if run["task"] == task and run["curve"]]
        end = min((run["curve"][-1][0] for run in of_task), default=0)
        for arm in dict.fromkeys(run["arm"] for run in of_task):
            group = [run for run in of_task if run["arm"] == arm]
            scores = [float(best_at(run["curve"], [end])[0]) for run in group]
            returns = [run["best_return"] for run in group if run.get("best_return") is not None]
            rows.append(
                {
                    "task": task,
                    "arm": arm,
                    "seeds": len(group),
                    "env_steps": end,
                    "bodies": float(np.mean([run["bodies"] for run in group])),
                    "scores": scores,
                    "mean": float(np.mean(scores)),
                    "std": float(np.std(scores, ddof=1)) if len(scores) > 1 else None,
                    "ends": [float(run["curve"][-1][1]) for run in group],
                    "end_steps": float(np.mean([run["curve"][-1][0] for run in group])),
                    "returns": returns,
                }
            )
    return rows


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns the summary as text; beside published returns where as many bodies were trained."""
    head = ["task", "arm", "seeds", "env-steps", "bodies trained", "best score", "of each seed"]
    head += ["of whole runs", "to env-steps"]
    compared = [row["bodies"] == PUBLISHED_BODIES and bool(row.get("returns")) for row in rows]
    if any(compared):
        head += ["best return", "published"]
    lines = [head]
    for row, is_compared in zip(rows, compared, strict=True):
        spread = "" if row["std"] is None else f" ({row['std']:.2f})"
        each = " ".join(f"{score:.2f}" for score in row["scores"])
        cells = [row["task"], row["arm"], str(row["seeds"]), f"{row['env_steps']:,.0f}", f"{row['bodies']:.0f}"]
        cells += [f"{row['mean']:.2f}{spread}", each]
        cells += [" ".join(f"{score:.2f}" for score in row["ends"]), f"{row['end_steps']:,.0f}"]
        if is_compared:
            cells += [f"{np.mean(row['returns']):.2f}", f"{PUBLISHED[row['task']]:.2f}"]
        lines.append(cells + [""] * (len(head) - len(cells)))
    return aligned(lines)


def _panels(count: int) -> tuple[int, int]:
    """Returns columns and rows of a figure with so many panels, at most three side by side."""
    columns = min(count, 3)
    return columns, -(-count // columns)


def plot(runs: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draws the best score against env-steps of all kinds: mean and its interval over seeds, and single seeds."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    runs = [run for run in runs if run["curve"]]
    tasks = [task for task in PAPER if any(run["task"] == task for run in runs)]
    if not tasks:
        return  # stopped before any run had a score
    columns, n_rows = _panels(len(tasks))
    size = (5 * columns, 3.6 * n_rows)
    figure, axes = plt.subplots(n_rows, columns, figsize=size, squeeze=False, layout="constrained")
    for axis, task in zip(axes.flat, tasks, strict=False):
        of_task = [run for run in runs if run["task"] == task]
        end = min(run["curve"][-1][0] for run in of_task)
        grid = np.linspace(0, end, 200)
        for arm in dict.fromkeys(run["arm"] for run in of_task):
            lines = np.stack([best_at(run["curve"], grid) for run in of_task if run["arm"] == arm])
            known = np.isfinite(lines).all(0)
            style = {"color": COLOURS[arm], "drawstyle": "steps-post"}
            axis.plot(grid, lines.T, lw=0.6, alpha=0.5, **style)
            axis.plot(grid[known], lines[:, known].mean(0), lw=2, label=arm, **style)
            if len(lines) > 1:
                ends = mean_interval(lines[:, known])
                axis.fill_between(grid[known], *ends, color=COLOURS[arm], alpha=0.12, step="post")
        axis.set(title=task, xlabel="simulated env-steps, of all kinds", ylabel="best score so far")
        axis.ticklabel_format(axis="x", style="sci", scilimits=(0, 0))
        seeds = f"mean of {len(lines)} seeds, 95 % interval" if len(lines) > 1 else "one seed"
        axis.legend(fontsize="small", title=seeds, title_fontsize="small")
    for axis in axes.flat[len(tasks) :]:
        axis.set_axis_off()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def draw_designs(runs: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draws the best design of every run, voxels by type and, where it is searched, their stiffness."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.patches import Rectangle

    from evogymcm import Body
    from evogymcm.envs.render import palette

    shown = sorted((run for run in runs if run["best"]), key=lambda run: (run["task"], run["arm"], run["seed"]))
    if not shown:
        return
    seeds = len({run["seed"] for run in shown})
    columns, n_rows = (seeds, -(-len(shown) // seeds)) if seeds > 1 else _panels(len(shown))
    size = (2.1 * columns, 2.4 * n_rows)
    figure, axes = plt.subplots(n_rows, columns, figsize=size, squeeze=False, layout="constrained")
    for axis, run in zip(axes.flat, shown, strict=False):
        grid = Body(run["best"]["body"], run["best"]["connections"]).grid
        stiffness = run["best"]["stiffness"]
        for row, column in np.argwhere(grid):
            colour = np.array(palette.type_color(int(grid[row, column]))) / 255
            axis.add_patch(Rectangle((column, -row), 1, 1, facecolor=colour, edgecolor="white", lw=0.6))
            if stiffness is not None:
                ink = "white" if colour.mean() < 0.5 else "black"
                label = f"{stiffness[row][column]:.1f}"
                axis.text(column + 0.5, 0.5 - row, label, color=ink, ha="center", va="center", size=7)
        axis.set(xlim=(-0.1, grid.shape[1] + 0.1), ylim=(0.9 - grid.shape[0], 1.1), aspect="equal")
        axis.set_title(f"{run['task']}\n{run['arm']}, seed {run['seed']}: {run['best']['fitness']:.2f}", size=6)
        axis.set_axis_off()
    for axis in axes.flat[len(shown) :]:
        axis.set_axis_off()
    figure.savefig(path, dpi=150)
    plt.close(figure)
