"""Curves over env-steps and fitness over generations, as plotly figures."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from evogymcm.algos.analysis import Band, band
from evogymcm.report.sources import Arm

if TYPE_CHECKING:
    import plotly.graph_objects as go

_BAND, _SEED = 0.16, 0.35  # opacities
_INK = "#191c21"


def load_plotly() -> Any:
    """Returns `plotly.graph_objects`.

    Raises:
        ImportError: It is not installed.
    """
    try:
        import plotly.graph_objects as go
    except ImportError as error:
        raise ImportError("reports need plotly, which cannot be imported: pip install evogymcm[report]") from error
    return go


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


def learning_curves(task: str, arms: Sequence[Arm]) -> "go.Figure":
    """Returns the learning curves of a task: the mean over seeds with its band, seeds as thin lines, the paper's."""
    figure = new_figure("env-steps", "score (deterministic policy)")
    for arm in arms:
        runs = arm.of(task, "train")
        if runs:
            _add_arm(figure, arm, [run.curve for run in runs], [_seed(run.seed) for run in runs], is_stepwise=False)
    for arm in arms:
        if task in arm.paper and arm.of(task, "train"):
            _add_level(figure, arm, arm.paper[task][0], max(run.curve[-1][0] for run in arm.of(task, "train")))
    return figure


def codesign_curves(task: str, arms: Sequence[Arm]) -> "go.Figure":
    """Returns the best score so far against env-steps of all kinds."""
    figure = new_figure("simulated env-steps, of all kinds", "best score so far")
    for arm in arms:
        runs = arm.of(task, "codesign")
        if runs:
            _add_arm(figure, arm, [run.curve for run in runs], [_seed(run.seed) for run in runs], is_stepwise=True)
    return figure


def fitness_by_generation(task: str, arms: Sequence[Arm]) -> "go.Figure":
    """Returns the fitness of every body that was trained, by the generation in which it was proposed."""
    go = load_plotly()
    figure = new_figure("generation", "fitness")
    shown = [(arm, arm.of(task, "codesign")) for arm in arms]
    shown = [(arm, runs) for arm, runs in shown if any(len(run.designs) > 1 for run in runs)]
    for i, (arm, runs) in enumerate(shown):
        offset = 0.16 * (i - (len(shown) - 1) / 2)  # arms side by side
        told = [(run, row) for run in runs for row in run.ranked()]
        figure.add_trace(
            go.Scatter(
                x=[row.get("generation", 0) + offset for _, row in told],
                y=[row["fitness"] for _, row in told],
                mode="markers",
                name=arm.label,
                marker={"color": arm.colour, "size": 6, "opacity": 0.6},
                text=[f"{row['body']}<br>{_seed(run.seed)}, number {row.get('index')}" for run, row in told],
                hovertemplate="%{y:.3f}<br>%{text}<extra></extra>",
            )
        )
    last = max((row.get("generation", 0) for _, runs in shown for run in runs for row in run.ranked()), default=0)
    figure.update_xaxes(tick0=0, dtick=last // 8 + 1, range=[-0.6, last + 0.6])
    return figure


def _seed(seed: int | None) -> str:
    return "seed not recorded" if seed is None else f"seed {seed}"


def _add_arm(figure: "go.Figure", arm: Arm, curves: Sequence[Any], names: Sequence[str], *, is_stepwise: bool) -> None:
    """Adds an arm's band, seeds and mean."""
    mean = band(curves, is_stepwise=is_stepwise)
    shape = "hv" if is_stepwise else "linear"
    if mean is not None and mean.low is not None:
        _add_band(figure, arm, mean, shape)
    if len(curves) > 1 or mean is None:
        for curve, name in zip(curves, names, strict=True):
            steps, scores = zip(*curve, strict=True)
            hover = f"{arm.label}, {name}: %{{y:.3f}}<extra></extra>"
            _add_line(figure, arm, steps, scores, shape, {"width": 0.9}, opacity=_SEED, hovertemplate=hover)
    if mean is not None:
        label = f"{arm.label}, {names[0]}" if len(curves) == 1 else f"{arm.label}, mean of {len(curves)} seeds"
        hover = f"{label}: %{{y:.3f}}<extra></extra>"
        options = {"name": label, "showlegend": True, "hovertemplate": hover}
        mode = "lines" if len(mean.steps) > 1 else "markers"
        _add_line(figure, arm, mean.steps, mean.mean, shape, {"width": 2.4}, mode=mode, **options)


def _add_line(figure: "go.Figure", arm: Arm, x: Any, y: Any, shape: str, line: dict[str, Any], **options: Any) -> None:
    """Adds a line in the arm's colour; without a legend's entry unless the options ask for one."""
    line = {"color": arm.colour, "shape": shape} | line
    options = {"mode": "lines", "showlegend": False, "legendgroup": arm.label} | options
    figure.add_trace(load_plotly().Scatter(x=x, y=y, line=line, **options))


def _add_band(figure: "go.Figure", arm: Arm, mean: Band, shape: str) -> None:
    red, green, blue = (int(arm.colour[i : i + 2], 16) for i in (1, 3, 5))
    fill = f"rgba({red},{green},{blue},{_BAND})"
    _add_line(figure, arm, mean.steps, mean.low, shape, {"width": 0}, hoverinfo="skip")
    _add_line(figure, arm, mean.steps, mean.high, shape, {"width": 0}, fill="tonexty", fillcolor=fill, hoverinfo="skip")


def _add_level(figure: "go.Figure", arm: Arm, score: float, end: float) -> None:
    """Adds the paper's score as a dotted line."""
    name = f"paper, {arm.label}: {score:.2f}"
    hover = f"{name}<extra></extra>"
    line = {"width": 1.4, "dash": "dot"}
    _add_line(figure, arm, [0, end], [score, score], "linear", line, name=name, showlegend=True, hovertemplate=hover)
