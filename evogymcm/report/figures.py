"""Curves over env-steps and fitness over generations, as plotly figures."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from evogymcm._extras import load_plotly
from evogymcm.algos.analysis import Band, band
from evogymcm.algos.runs.record import Kind, RunRecord
from evogymcm.report.sources import Arm

if TYPE_CHECKING:
    import plotly.graph_objects as go

_BAND, _SEED = 0.16, 0.35  # opacities
_INK = "#191c21"


def new_figure(x: str, y: str) -> "go.Figure":
    """Returns an empty figure in the look of the page."""
    figure = load_plotly().Figure()
    figure.update_layout(
        template="plotly_white",
        margin={"l": 8, "r": 12, "t": 36, "b": 8},
        font={"family": "system-ui, sans-serif", "size": 13, "color": _INK},
        legend={"orientation": "h", "yref": "container", "yanchor": "bottom", "y": 0, "x": 0, "traceorder": "normal"},
        hovermode="closest",
    )
    axis = {"automargin": True, "ticks": "outside", "linecolor": "#8a9099", "showline": True, "zeroline": False}
    axis["title_font_size"] = 13
    figure.update_xaxes(title_text=x, nticks=7, **axis)
    figure.update_yaxes(title_text=y, exponentformat="power", **axis)
    return figure


def curves(task: str, arms: Sequence[Arm], kind: Kind) -> "go.Figure":
    """Returns the mean over seeds against env-steps with its band, seeds as thin lines, and the paper's score.

    In training it is the score of each evaluation, in co-design the best so far, against env-steps of all kinds.
    """
    is_training = kind == "train"
    axes = ("env-steps", "score (deterministic policy)"), ("simulated env-steps, of all kinds", "best score so far")
    figure = new_figure(*axes[0 if is_training else 1])
    shown = [(arm, arm.of(task, kind)) for arm in arms if arm.of(task, kind)]
    for arm, runs in shown:
        _add_arm(figure, arm, runs, is_stepwise=not is_training)
    for arm, runs in shown:
        if is_training and task in arm.paper:
            score, end = arm.paper[task][0], max(run.curve[-1][0] for run in runs)
            name = f"paper, {arm.label}: {score:.2f}"
            line = {"width": 1.4, "dash": "dot"}
            options = {"name": name, "showlegend": True, "hovertemplate": f"{name}<extra></extra>"}
            _add_line(figure, arm, [0, end], [score, score], "linear", line, **options)
    return figure


def fitness_by_generation(task: str, arms: Sequence[Arm]) -> "go.Figure":
    """Returns the fitness of every body that was trained, by the generation in which it was proposed."""
    figure = new_figure("generation", "fitness")
    shown = [(arm, arm.of(task, "codesign")) for arm in arms]
    shown = [(arm, runs) for arm, runs in shown if any(len(run.designs) > 1 for run in runs)]
    for i, (arm, runs) in enumerate(shown):
        offset = 0.16 * (i - (len(shown) - 1) / 2)  # arms side by side
        told = [(run, row) for run in runs for row in run.ranked()]
        figure.add_scatter(
            x=[row.get("generation", 0) + offset for _, row in told],
            y=[row["fitness"] for _, row in told],
            mode="markers",
            name=arm.label,
            marker={"color": arm.colour, "size": 6, "opacity": 0.6},
            text=[f"{row['body']}<br>{_seed(run.seed)}, number {row.get('index')}" for run, row in told],
            hovertemplate="%{y:.3f}<br>%{text}<extra></extra>",
        )
    last = max((row.get("generation", 0) for _, runs in shown for run in runs for row in run.ranked()), default=0)
    figure.update_xaxes(tick0=0, dtick=last // 8 + 1, range=[-0.6, last + 0.6])
    return figure


def _seed(seed: int | None) -> str:
    return "seed not recorded" if seed is None else f"seed {seed}"


def _add_arm(figure: "go.Figure", arm: Arm, runs: Sequence[RunRecord], *, is_stepwise: bool) -> None:
    """Adds an arm's band, seeds and mean."""
    mean = band([run.curve for run in runs], is_stepwise=is_stepwise)
    shape = "hv" if is_stepwise else "linear"
    if mean is not None and mean.low is not None:
        _add_band(figure, arm, mean, shape)
    if len(runs) > 1 or mean is None:
        for run in runs:
            steps, scores = zip(*run.curve, strict=True)
            hover = f"{arm.label}, {_seed(run.seed)}: %{{y:.3f}}<extra></extra>"
            _add_line(figure, arm, steps, scores, shape, {"width": 0.9}, opacity=_SEED, hovertemplate=hover)
    if mean is not None:
        label = f"{arm.label}, " + (_seed(runs[0].seed) if len(runs) == 1 else f"mean of {len(runs)} seeds")
        hover = f"{label}: %{{y:.3f}}<extra></extra>"
        options = {"name": label, "showlegend": True, "hovertemplate": hover}
        mode = "lines" if len(mean.steps) > 1 else "markers"
        _add_line(figure, arm, mean.steps, mean.mean, shape, {"width": 2.4}, mode=mode, **options)


def _add_line(figure: "go.Figure", arm: Arm, x: Any, y: Any, shape: str, line: dict[str, Any], **options: Any) -> None:
    """Adds a line in the arm's colour; without a legend's entry unless the options ask for one."""
    line = {"color": arm.colour, "shape": shape} | line
    options = {"mode": "lines", "showlegend": False, "legendgroup": arm.label} | options
    figure.add_scatter(x=x, y=y, line=line, **options)


def _add_band(figure: "go.Figure", arm: Arm, mean: Band, shape: str) -> None:
    red, green, blue = (int(arm.colour[i : i + 2], 16) for i in (1, 3, 5))
    fill = f"rgba({red},{green},{blue},{_BAND})"
    _add_line(figure, arm, mean.steps, mean.low, shape, {"width": 0}, hoverinfo="skip")
    _add_line(figure, arm, mean.steps, mean.high, shape, {"width": 0}, fill="tonexty", fillcolor=fill, hoverinfo="skip")
