"""Figures of experiments. They need matplotlib (extra "render"), and are written whole or not at all."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np

from benchmarks.experiments.paper import PAPER
from evogymcm import Body
from evogymcm._files import write_atomic
from evogymcm.algos.analysis import Signals, VoxelSignals, align, band, mean_stiffness
from evogymcm.algos.codesign.design import Design
from evogymcm.body import STIFFNESS_HIGH, STIFFNESS_LOW
from evogymcm.envs.render import palette

_BLUE, _RED, _GREEN, _PINK, _GREY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "0.5"
_COLOURS: Mapping[str, str] = {
    "control-only": _BLUE, "co-optimisation": _RED,
    "fixed": _BLUE, "reactive": _RED, "invariant": _GREEN, "priced": _PINK,
    "none": _GREY, "body": _BLUE, "message": _GREEN, "attention": _RED, "mlp": _PINK,
}  # fmt: skip
_PAPERS_VOXEL = (1, 2)  # row and column, from 0, of the voxel whose signals the paper shows
_SHOWN, _STEPS = 3, 100  # voxels, and env-steps of their series


@contextmanager
def _figure(path: Path, **options: Any) -> Iterator[Any]:
    """A figure that is written at the end."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure = plt.figure(layout="constrained", **options)
    try:
        yield figure
        write_atomic(path, lambda part: figure.savefig(part, dpi=100, format="png"))
    finally:
        plt.close(figure)


@contextmanager
def _panels(path: Path, count: int, columns: int = 3, size: tuple[float, float] = (4.8, 3.4)) -> Iterator[list[Any]]:
    """So many panels of one figure, row by row."""
    columns = min(count, columns)
    rows = -(-count // columns)
    with _figure(path, figsize=(size[0] * columns, size[1] * rows)) as figure:
        axes = list(figure.subplots(rows, columns, squeeze=False).flat)
        yield axes[:count]
        for axis in axes[count:]:
            axis.set_axis_off()


def _known(tasks: Sequence[str], runs: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Returns the runs of each task that have a curve."""
    groups = {task: [run for run in runs if run["task"] == task and run["curve"]] for task in tasks}
    return {task: group for task, group in groups.items() if group}


def learning_curves(runs: Sequence[Mapping[str, Any]], tasks: Sequence[str], arms: Sequence[str], path: Path) -> None:
    """Draws scores in training, one panel a task: single runs thin, their mean bold, their range as a band."""
    of_tasks = _known(tasks, runs)
    if not of_tasks:
        return
    with _panels(path, len(of_tasks)) as axes:
        for axis, (task, group) in zip(axes, of_tasks.items(), strict=True):
            for arm in arms:
                curves = [run["curve"] for run in group if run["label"] == arm]
                aligned = align(curves, is_stepwise=False) if curves else None
                if aligned is None:
                    continue
                for curve in curves:
                    axis.plot(*np.transpose(curve), color=_COLOURS[arm], lw=0.6, alpha=0.5)
                steps, scores = aligned
                name = f"{arm}, mean and range of {len(curves)} seeds" if len(curves) > 1 else arm
                axis.plot(steps, scores.mean(0), color=_COLOURS[arm], lw=1.6, label=name)
                axis.fill_between(steps, scores.min(0), scores.max(0), color=_COLOURS[arm], alpha=0.12, lw=0)
                if paper := PAPER[task].scores.get(arm):
                    axis.axhline(paper[0], color=_COLOURS[arm], lw=0.8, ls=":", label=f"paper, {arm}")
            untrained = mean(run["curve"][0][1] for run in group)
            axis.axhline(untrained, color="0.6", lw=0.8, ls="--", label="untrained policy")
            axis.set(title=f"{task}, {PAPER[task].robot}", xlabel="env-steps", ylabel="score (deterministic policy)")
            axis.ticklabel_format(axis="x", style="sci", scilimits=(0, 0))
            axis.legend(fontsize="x-small")


def best_curves(runs: Sequence[Mapping[str, Any]], tasks: Sequence[str], arms: Sequence[str], path: Path) -> None:
    """Draws the best score so far against env-steps of all kinds: single seeds, their mean and its interval."""
    of_tasks = _known(tasks, runs)
    if not of_tasks:
        return  # stopped before any run had a score
    with _panels(path, len(of_tasks)) as axes:
        for axis, (task, group) in zip(axes, of_tasks.items(), strict=True):
            for arm in arms:
                curves = [run["curve"] for run in group if run["label"] == arm]
                if not curves or (lines := band(curves, is_stepwise=True)) is None:
                    continue
                style = {"color": _COLOURS[arm], "drawstyle": "steps-post"}
                for curve in curves:
                    axis.plot(*np.transpose(curve), lw=0.6, alpha=0.5, **style)
                name = f"{arm}, mean of {len(curves)} seeds, 95 % interval" if len(curves) > 1 else arm
                axis.plot(lines.steps, lines.mean, lw=2, label=name, **style)
                if lines.low is not None:
                    ends = (lines.steps, lines.low, lines.high)
                    axis.fill_between(*ends, color=_COLOURS[arm], alpha=0.12, step="post")
            axis.set(title=task, xlabel="simulated env-steps, of all kinds", ylabel="best score so far")
            axis.ticklabel_format(axis="x", style="sci", scilimits=(0, 0))
            axis.legend(fontsize="x-small")


def designs(runs: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draws the best design of each arm (rows) and task: voxels by type and, where it is searched, their stiffness."""
    best: dict[tuple[str, str], Mapping[str, Any]] = {}
    for run in sorted((run for run in runs if run["best"]), key=lambda run: (run["label"], run["task"])):
        key = run["label"], run["task"]
        if key not in best or run["best"]["fitness"] > best[key]["best"]["fitness"]:
            best[key] = run
    if not best:
        return
    with _panels(path, len(best), len({task for _, task in best}), (2.1, 2.4)) as axes:
        for axis, ((arm, task), run) in zip(axes, best.items(), strict=True):
            _design(axis, run["best"])
            axis.set_title(f"{task}\n{arm}, seed {run['seed']}: {run['best']['fitness']:.2f}", size=7)


def _design(axis: Any, best: Mapping[str, Any]) -> None:
    from matplotlib.patches import Rectangle

    grid, stiffness = Body(best["body"], best["connections"]).grid, best["stiffness"]
    for row, column in np.argwhere(grid):
        colour = np.array(palette.type_color(int(grid[row, column]))) / 255
        axis.add_patch(Rectangle((column, -row), 1, 1, facecolor=colour, edgecolor="white", lw=0.6))
        if stiffness is not None:
            ink = "white" if colour.mean() < 0.5 else "black"
            label = f"{stiffness[row][column]:.1f}"
            axis.text(column + 0.5, 0.5 - row, label, color=ink, ha="center", va="center", size=7)
    axis.set(xlim=(-0.1, grid.shape[1] + 0.1), ylim=(0.9 - grid.shape[0], 1.1), aspect="equal")
    axis.set_axis_off()


def mean_fields(groups: Mapping[tuple[str, str], Sequence[Design]], path: Path) -> None:
    """Draws the mean stiffness field of the designs of each task and arm, with intervals and numbers of designs."""
    shown = {key: mean_stiffness(designs) for key, designs in groups.items() if designs}
    if not shown:
        return
    from matplotlib.colors import LogNorm

    with _panels(path, len(shown), size=(3.6, 3.4)) as axes:
        for axis, ((task, arm), field) in zip(axes, shown.items(), strict=True):
            assert field.low is not None
            assert field.high is not None
            image = axis.imshow(field.mean, cmap="PuOr_r", norm=LogNorm(STIFFNESS_LOW, STIFFNESS_HIGH))
            for (row, column), count in np.ndenumerate(field.count):
                low, mean, high = (values[row, column] for values in (field.low, field.mean, field.high))
                text = f"n={count}" if np.isnan(mean) else f"{mean:.2f}\n[{low:.2f}, {high:.2f}]\nn={count}"
                ink = "white" if abs(np.log2(mean)) > 0.7 else "black"
                axis.text(column, row, text, color=ink, ha="center", va="center", size=5.5)
            axis.set(xticks=[], yticks=[])
            axis.set_title(f"{task}\n{arm}, mean stiffness of {len(groups[task, arm])} designs", size="small")
        bar = axes[0].figure.colorbar(image, ax=axes, shrink=0.6, ticks=(0.5, 1, 2), format="%g")
        bar.minorticks_off()


def unseen_curves(runs: Sequence[Mapping[str, Any]], tasks: Sequence[str], arms: Sequence[str], path: Path) -> None:
    """Draws what one policy is worth on bodies that it has not seen while it trains on others, one panel a task."""
    of_tasks = _known(tasks, runs)
    if not of_tasks:
        return
    with _panels(path, len(of_tasks)) as axes:
        for axis, (task, group) in zip(axes, of_tasks.items(), strict=True):
            for place, arm in enumerate(arms):
                curves = [run["curve"] for run in group if run["label"] == arm]
                if not curves or (lines := band(curves, is_stepwise=False)) is None:
                    continue
                for curve in curves:
                    axis.plot(*np.transpose(curve), color=f"C{place}", lw=0.6, alpha=0.5)
                axis.plot(lines.steps, lines.mean, color=f"C{place}", lw=1.6, label=arm)
            axis.set(title=task, xlabel="env-steps", ylabel="score of unseen bodies")
            axis.ticklabel_format(axis="x", style="sci", scilimits=(0, 0))
            axis.legend(fontsize="x-small")


def signals(given: Signals, path: Path) -> None:
    """Draws series of some voxels, mean spectra, lags, and stiffness around touch-down."""
    shown = sorted(given.voxels, key=_rank)[:_SHOWN]
    with _figure(path, figsize=(11, 2.6 + 1.5 * len(shown))) as figure:
        upper, lower = figure.subfigures(2, 1, height_ratios=(1.5 * len(shown), 2.6))
        named: dict[str, Any] = {}
        for axis, voxel in zip(upper.subplots(len(shown), 1, sharex=True, squeeze=False).flat, shown, strict=True):
            _series(axis, voxel)
            handles, names = axis.get_legend_handles_labels()
            named |= dict(zip(names, handles, strict=True))
        axis.set_xlabel("env-step")
        upper.legend(named.values(), named.keys(), fontsize="x-small", loc="upper right", ncols=3)
        spectra, lags, touch = lower.subplots(1, 3)
        _spectra(spectra, given)
        _lags(lags, given)
        _touch_down(touch, given)
        figure.suptitle(f"{given.task}, score {given.score:.2f}", size="medium")


def _rank(voxel: VoxelSignals) -> tuple[bool, bool, int]:
    """Order in which voxels are shown: the paper's, then actuators by how often they come down."""
    landings = int((voxel.contact[1:] & ~voxel.contact[:-1]).sum())
    return (voxel.row, voxel.column) != _PAPERS_VOXEL, not voxel.is_actuator, -landings


def _series(axis: Any, voxel: VoxelSignals) -> None:
    """Middle of the episode of one voxel, contact shaded."""
    n = len(voxel.stiffness)
    start = max(0, (n - _STEPS) // 2)
    steps = np.arange(start, min(n, start + _STEPS))
    axis.step(steps, voxel.stiffness[steps], where="mid", color=_RED, lw=1.2, label="stiffness")
    if voxel.actuation is not None:
        axis.step(steps, voxel.actuation[steps], where="mid", color=_BLUE, lw=1.2, label="actuation")
    kind = {"transform": axis.get_xaxis_transform(), "step": "mid", "color": "0.85", "lw": 0}
    axis.fill_between(steps, 0, 1, where=voxel.contact[steps], label="on the ground", **kind)
    axis.set(ylim=(0.4, 2.1), xlim=(steps[0], max(steps[-1], steps[0] + 1)))
    axis.set_title(f"voxel in row {voxel.row}, column {voxel.column}", size="small", loc="left")


def _spectra(axis: Any, given: Signals) -> None:
    """Mean power densities of the actuators."""
    spectra = given.spectra
    axis.semilogy(spectra.frequency[1:], spectra.actuation[1:] + 1e-12, color=_BLUE, lw=1.2, label="actuation")
    axis.semilogy(spectra.frequency[1:], spectra.stiffness[1:] + 1e-12, color=_RED, lw=1.2, label="stiffness")
    top = max(spectra.actuation.max(), spectra.stiffness.max(), 1e-9)
    axis.set(ylim=(1e-5 * top, 2 * top), xlabel="cycles per second of simulated time", ylabel="power density")
    axis.set_title("mean spectra of the actuators", size="small")
    axis.legend(fontsize="x-small")


def _lags(axis: Any, given: Signals) -> None:
    """Histogram of the phase by which stiffness follows actuation."""
    angles = [voxel.phase_lag for voxel in given.voxels if voxel.phase_lag is not None]
    axis.hist(np.degrees(angles), bins=np.arange(-180, 181, 30), color=_GREY)
    axis.set(xlabel="degrees by which stiffness follows actuation", ylabel="actuators", xticks=range(-180, 181, 90))
    axis.set_title("phase lag at the actuation's frequency", size="small")


def _touch_down(axis: Any, given: Signals) -> None:
    """Mean stiffness of the voxels that come down."""
    contact = given.contact
    axis.plot(contact.lags, contact.stiffness, "o-", color=_RED, ms=3, lw=1.2)
    axis.axvline(0, color="0.6", lw=0.8, ls="--")
    rise = "" if contact.rise_before_impact is None else f", rise {contact.rise_before_impact:+.2f}"
    if contact.rise_interval is not None:
        rise += " [{:+.2f}, {:+.2f}]".format(*contact.rise_interval)
    axis.set(xlabel="env-steps after touch-down", ylabel="mean stiffness")
    axis.set_title(f"{contact.n_impacts} impacts{rise}", size="small")
