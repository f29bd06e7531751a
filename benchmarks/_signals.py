"""Signals of a finished run's last policy: signals.json and signals.png in its folder."""

import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from evogymcm import Body
from evogymcm._files import write_atomic
from evogymcm.algos import load_actor
from evogymcm.algos.analysis import Signals, VoxelSignals, analyse_signals, record_episode
from evogymcm.envs import SoftRobotEnv

_ACTUATION, _STIFFNESS = "#0072b2", "#d55e00"
_PAPERS_VOXEL = (1, 2)  # row and column, from 0, of the voxel that the paper shows
_SHOWN = 3  # voxels
_STEPS = 100  # env-steps of their series


def analyse_run(folder: Path, task: str, robot: Body) -> Signals:
    """Plays an episode with the last policy of a finished run, and writes signals.json and signals.png.

    The figure is left out, with a warning, where matplotlib is not installed.

    Raises:
        ValueError: The run has no final policy, or one that does not set stiffness.
    """
    policy = folder / "final.pt"
    if not policy.is_file():
        raise ValueError(f"{folder}: it has no final.pt, so that the run is not finished")
    actor = load_actor(torch.load(policy, weights_only=True))
    if "stiffness" not in actor.ranges:
        raise ValueError(f"{folder}: its policy does not set stiffness")
    env = SoftRobotEnv(task, bodies=robot, num_worlds=1, material="reactive", num_threads=1)
    signals = analyse_signals(record_episode(actor, env))
    text = json.dumps(signals.record(), allow_nan=False) + "\n"
    write_atomic(folder / "signals.json", lambda part: part.write_text(text, encoding="utf-8"))
    try:
        plot(signals, folder / "signals.png")
    except ModuleNotFoundError:
        warnings.warn("no signals.png: it needs matplotlib (pip install evogymcm[render])", stacklevel=2)
    return signals


def plot(signals: Signals, path: Path) -> None:
    """Draws series of some voxels, mean spectra, lags, and stiffness around touch-down."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    shown = _chosen(signals)
    figure = plt.figure(figsize=(11, 2.6 + 1.5 * len(shown)), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.5 * len(shown), 2.6))
    named: dict[str, Any] = {}
    for axis, voxel in zip(upper.subplots(len(shown), 1, sharex=True, squeeze=False).flat, shown, strict=True):
        _series(axis, voxel)
        handles, names = axis.get_legend_handles_labels()
        named |= dict(zip(names, handles, strict=True))
    axis.set_xlabel("env-step")
    upper.legend(named.values(), named.keys(), fontsize="x-small", loc="upper right", ncols=3)
    spectra, lags, touch = lower.subplots(1, 3)
    _spectra(spectra, signals)
    _lags(lags, signals)
    _touch_down(touch, signals)
    figure.suptitle(f"{signals.task}, score {signals.score:.2f}", size="medium")
    write_atomic(path, lambda part: figure.savefig(part, dpi=150, format="png"))
    plt.close(figure)


def _chosen(signals: Signals) -> Sequence[VoxelSignals]:
    """Returns the voxels to show: the paper's, then actuators by how often they come down."""

    def rank(voxel: VoxelSignals) -> tuple[bool, bool, int]:
        landings = int((voxel.contact[1:] & ~voxel.contact[:-1]).sum())
        return (voxel.row, voxel.column) != _PAPERS_VOXEL, not voxel.is_actuator, -landings

    return sorted(signals.voxels, key=rank)[:_SHOWN]


def _series(axis: Any, voxel: VoxelSignals) -> None:
    """Middle of the episode of one voxel, contact shaded."""
    n = len(voxel.stiffness)
    start = max(0, (n - _STEPS) // 2)
    steps = np.arange(start, min(n, start + _STEPS))
    axis.step(steps, voxel.stiffness[steps], where="mid", color=_STIFFNESS, lw=1.2, label="stiffness")
    if voxel.actuation is not None:
        axis.step(steps, voxel.actuation[steps], where="mid", color=_ACTUATION, lw=1.2, label="actuation")
    kind = {"transform": axis.get_xaxis_transform(), "step": "mid", "color": "0.85", "lw": 0}
    axis.fill_between(steps, 0, 1, where=voxel.contact[steps], label="on the ground", **kind)
    axis.set(ylim=(0.4, 2.1), xlim=(steps[0], max(steps[-1], steps[0] + 1)))
    axis.set_title(f"voxel in row {voxel.row}, column {voxel.column}", size="small", loc="left")


def _spectra(axis: Any, signals: Signals) -> None:
    """Mean power densities of the actuators."""
    spectra = signals.spectra
    axis.semilogy(spectra.frequency[1:], spectra.actuation[1:] + 1e-12, color=_ACTUATION, lw=1.2, label="actuation")
    axis.semilogy(spectra.frequency[1:], spectra.stiffness[1:] + 1e-12, color=_STIFFNESS, lw=1.2, label="stiffness")
    top = max(spectra.actuation.max(), spectra.stiffness.max(), 1e-9)
    axis.set(ylim=(1e-5 * top, 2 * top), xlabel="cycles per second of simulated time", ylabel="power density")
    axis.set_title("mean spectra of the actuators", size="small")
    axis.legend(fontsize="x-small")


def _lags(axis: Any, signals: Signals) -> None:
    """Histogram of the phase by which stiffness follows actuation."""
    angles = [voxel.phase_lag for voxel in signals.voxels if voxel.phase_lag is not None]
    axis.hist(np.degrees(angles), bins=np.arange(-180, 181, 30), color="0.5")
    axis.set(xlabel="degrees by which stiffness follows actuation", ylabel="actuators", xticks=range(-180, 181, 90))
    axis.set_title("phase lag at the actuation's frequency", size="small")


def _touch_down(axis: Any, signals: Signals) -> None:
    """Mean stiffness of the voxels that come down."""
    contact = signals.contact
    axis.plot(contact.lags, contact.stiffness, "o-", color=_STIFFNESS, ms=3, lw=1.2)
    axis.axvline(0, color="0.6", lw=0.8, ls="--")
    rise = "" if contact.rise_before_impact is None else f", rise {contact.rise_before_impact:+.2f}"
    if contact.rise_interval is not None:
        rise += " [{:+.2f}, {:+.2f}]".format(*contact.rise_interval)
    axis.set(xlabel="env-steps after touch-down", ylabel="mean stiffness")
    axis.set_title(f"{contact.n_impacts} impacts{rise}", size="small")
