"""Signals of a policy that sets stiffness: time series, spectra, lags and what happens around impacts."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from evogymcm.algos.runs.record import Row
from evogymcm.report.figures import new_figure
from evogymcm.report.parts import Figure, Note, Part, Picture, Pictures, Table
from evogymcm.report.pictures import cells_svg, ramp_svg, stiffness_ramp, stiffness_svg

_ACTUATION, _STIFFNESS, _CONTACT = "#0072b2", "#d55e00", "#6b727c"
_SHOWN = 200  # env-steps of the time series


def signal_parts(signals: Row) -> list[Part]:
    """Returns what can be shown of a `signals.json`; what it lacks is left out."""
    step = signals.get("step_seconds")
    voxels = [voxel for voxel in signals.get("voxels") or () if voxel.get("stiffness")]
    parts: list[Part] = []
    if voxels:
        parts += [_series(voxels, step), _maps_over_time(voxels, step), _cells(voxels)]
    spectra = signals.get("spectra") or {}
    if spectra.get("frequency"):
        parts.append(_spectra(spectra))
    contact = signals.get("contact") or {}
    if contact.get("lags") and contact.get("n_impacts"):
        parts.append(_around_impacts(contact))
    elif contact:
        parts.append(Note("No voxel came down on the ground in this episode, so there is no average around impacts."))
    if voxels:
        parts.append(_voxel_table(voxels))
    return parts or [Note("The file signals.json holds no signals.")]


def _name(voxel: Row) -> str:
    return f"row {voxel.get('row', '?')}, column {voxel.get('column', '?')}"


def _times(length: int, step: float | None) -> tuple[np.ndarray, str]:
    """Returns times of env-steps and what they count."""
    return (np.arange(length), "env-step") if step is None else (np.arange(length) * step, "simulated seconds")


def _series(voxels: Sequence[Row], step: float | None) -> Figure:
    """Actuation and stiffness of the voxel in which they go together most closely."""
    voxel = max(voxels, key=lambda voxel: (voxel.get("actuation") is not None, voxel.get("correlation") or -2.0))
    times, unit = _times(min(len(voxel["stiffness"]), _SHOWN), step)
    figure = new_figure(unit, "stiffness; actuation")
    traces = [("stiffness", voxel["stiffness"], _STIFFNESS)]
    if voxel.get("actuation"):
        traces.append(("actuation (target length)", voxel["actuation"], _ACTUATION))
    for name, values, colour in traces:
        line = {"color": colour, "width": 1.8, "shape": "hv"}
        figure.add_scatter(x=times, y=values[:_SHOWN], name=name, line=line, mode="lines")
    touching = [time for time, touches in zip(times, voxel.get("contact") or (), strict=False) if touches]
    if touching:
        marker = {"color": _CONTACT, "symbol": "square", "size": 5}
        figure.add_scatter(x=touching, y=[0.42] * len(touching), name="on the ground", mode="markers", marker=marker)
    caption = f"The voxel in {_name(voxel)}, the first {len(times)} env-steps."
    if voxel.get("correlation") is not None:
        caption += " Of all actuators it is the one whose stiffness follows its actuation most closely."
    return Figure("Actuation and stiffness of one voxel", figure, caption)


def _maps_over_time(voxels: Sequence[Row], step: float | None) -> Figure:
    """Actuation and stiffness of all voxels over time."""
    from plotly.subplots import make_subplots

    driven = [voxel for voxel in voxels if voxel.get("actuation")]
    groups = [("actuation", driven, "Blues", 0.6, 1.6), ("stiffness", list(voxels), "Viridis_r", 0.5, 2.0)]
    groups = [group for group in groups if group[1]]
    look = new_figure("", "").layout
    heights = [len(group[1]) for group in groups]
    titles = [f"{name} of {len(members)} voxels" for name, members, *_ in groups]
    figure = make_subplots(len(groups), 1, shared_xaxes=True, row_heights=heights, vertical_spacing=0.12)
    figure.update_layout(template=look.template, margin=look.margin, font=look.font)
    for i, (name, members, scale, low, high) in enumerate(groups, 1):
        values = np.array([voxel[name] for voxel in members], float)
        times, unit = _times(values.shape[1], step)
        labels = [f"{voxel.get('row', '?')},{voxel.get('column', '?')}" for voxel in members]
        low_share = 1 - sum(heights[:i]) / sum(heights)
        bar = {"len": 0.9 * heights[i - 1] / sum(heights), "y": low_share, "yanchor": "bottom", "thickness": 12}
        # Voxels are numbered, as labels alone would be read as decimal numbers.
        figure.add_heatmap(
            x=times, y=np.arange(len(members)), z=values, colorscale=scale, zmin=low, zmax=high, colorbar=bar,
            hovertemplate=f"%{{x:.3f}}: {name} %{{z:z.2f}}<extra></extra>", row=i, col=1,
        )  # fmt: skip
        every = max(1, len(labels) // 10)
        axis = {"tickvals": list(range(0, len(labels), every)), "ticktext": labels[::every]}
        axis["title"] = {"text": name, "font_size": 13}
        figure.update_yaxes(autorange="reversed", automargin=True, row=i, col=1, **axis)
    figure.update_xaxes(title={"text": unit, "font_size": 13}, automargin=True, row=len(groups), col=1)
    caption = f"{'; '.join(titles)}. A voxel is named by its row and column."
    return Figure("All voxels over time", figure, caption, height=200 + 9 * sum(heights))


def _grid(voxels: Sequence[Row], value: Any) -> tuple[np.ndarray, np.ndarray]:
    """Returns (rows, cols) values of the voxels, NaN where there is none, and where there are voxels."""
    cells = np.array([(voxel["row"], voxel["column"]) for voxel in voxels])
    shape = cells.max(0) + 1
    values, occupancy = np.full(shape, np.nan), np.zeros(shape, bool)
    for (row, column), voxel in zip(cells, voxels, strict=True):
        found = value(voxel)
        occupancy[row, column] = True
        values[row, column] = np.nan if found is None else found
    return values, occupancy


def phase_colours(angles: np.ndarray) -> np.ndarray:
    """Returns (n, 3) colours of angles in radians, the same at -pi and pi."""
    turns = np.stack([np.cos(angles - shift) for shift in (0.0, 2 * np.pi / 3, 4 * np.pi / 3)], axis=-1)
    return np.rint(165 + 75 * turns).astype(int)


def _cells(voxels: Sequence[Row]) -> Part:
    """Mean stiffness and phase lag on the body."""
    placed = [voxel for voxel in voxels if "row" in voxel and "column" in voxel]
    if not placed:
        return Note("The voxels' places are not recorded.")
    mean = _grid(placed, lambda voxel: float(np.mean(voxel["stiffness"])))
    spread = _grid(placed, lambda voxel: float(np.std(voxel["stiffness"])))
    hints = [
        f"{_name(voxel)}: stiffness {np.mean(voxel['stiffness']):z.2f}, std {np.std(voxel['stiffness']):z.2f}"
        for voxel in sorted(placed, key=lambda voxel: (voxel["row"], voxel["column"]))
    ]
    lag = _grid(placed, lambda voxel: voxel.get("phase_lag"))
    most = max(float(np.nanmax(spread[0])), 0.05)

    def greys(values: np.ndarray) -> np.ndarray:
        return np.rint(245 - 190 * (np.asarray(values) / most).clip(0, 1))[:, None].repeat(3, axis=1).astype(int)

    pictures = [
        Picture(stiffness_svg(*mean, hints) + stiffness_ramp(), "stiffness, mean over the episode"),
        Picture(
            cells_svg(*spread, greys, "{:z.2f}", hints) + ramp_svg(greys, 0, most, ("0", f"{most:z.2f}"), is_log=False),
            "stiffness, standard deviation over the episode",
        ),
    ]
    if np.isfinite(lag[0]).any():
        ramp = ramp_svg(phase_colours, -np.pi, np.pi, ("-π", "0", "π"), is_log=False)
        pictures.append(
            Picture(
                cells_svg(*lag, phase_colours, "{:z.1f}") + ramp,
                "phase in radians by which stiffness follows actuation; pale: not an actuator, or one signal is still",
            )
        )
    return Pictures("On the body", pictures)


def _spectra(spectra: Row) -> Figure:
    figure = new_figure("cycles per simulated second", "mean power density")
    for name, colour in (("actuation", _ACTUATION), ("stiffness", _STIFFNESS)):
        if spectra.get(name):
            line = {"color": colour, "width": 1.8}
            figure.add_scatter(x=spectra["frequency"], y=spectra[name], name=name, line=line, mode="lines")
    return Figure("Spectra", figure, "Means over the actuators.")


def _around_impacts(contact: Row) -> Figure:
    figure = new_figure("env-steps after touch-down", "mean stiffness")
    line = {"color": _STIFFNESS, "width": 2}
    figure.add_scatter(x=contact["lags"], y=contact.get("stiffness"), line=line, mode="lines+markers")
    figure.add_vline(x=0, line={"color": _CONTACT, "dash": "dash", "width": 1})
    caption = f"Mean over {contact['n_impacts']} impacts of voxels."
    rise = contact.get("rise_before_impact")
    if rise is not None:
        caption += f" Rise before the impact: {rise:+.3f}"
        interval = contact.get("rise_interval")
        caption += f" (95 % interval {interval[0]:+.3f} to {interval[1]:+.3f})." if interval else "."
    rank = contact.get("rise_rank")
    if rank is not None:
        caption += f" It is larger than at {rank:.0%} of all other moments of the episode (chance: 50 %)."
    return Figure("Stiffness around impacts", figure, caption, height=320)


def _voxel_table(voxels: Sequence[Row]) -> Table:
    """Numbers of every actuator."""
    columns = {
        "frequency of actuation": ("frequency_actuation", "{:z.1f}"),
        "of stiffness": ("frequency_stiffness", "{:z.1f}"),
        "phase lag (rad)": ("phase_lag", "{:+z.2f}"),
        "coherence": ("coherence", "{:z.2f}"),
        "lag (env-steps)": ("lag_steps", "{:+d}"),
        "correlation": ("correlation", "{:z.2f}"),
    }
    driven = [voxel for voxel in voxels if voxel.get("is_actuator")]
    columns = {head: (key, form) for head, (key, form) in columns.items() if any(key in voxel for voxel in driven)}
    rows = [
        [
            _name(voxel),
            *("" if voxel.get(key) is None else form.format(voxel[key]) for key, form in columns.values()),
        ]
        for voxel in driven
    ]
    caption = "Strongest frequencies, in cycles per simulated second. A positive lag: stiffness follows actuation."
    return Table("Actuators", ["voxel", *columns], rows, caption, numeric=frozenset(range(1, len(columns) + 1)))
