"""Bodies and fields on their voxels as SVG."""

from collections.abc import Callable, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from evogymcm.body import H_ACT, RIGID, SOFT, STIFFNESS_HIGH, STIFFNESS_LOW, V_ACT, Body
from evogymcm.envs.render import palette

Field = NDArray[np.float64]
Colours = Callable[[Field], NDArray[np.int64]]

_NAMES = {RIGID: "rigid", SOFT: "soft", H_ACT: "horizontal actuator", V_ACT: "vertical actuator"}
_MARKS = {H_ACT: (0.6, 0.12), V_ACT: (0.12, 0.6)}  # parts of a voxel, across and up
_CELL = 30  # pixels of a voxel in a field's picture
_EMPTY = "#eef0f3"


def css(colour: Sequence[int]) -> str:
    """Returns a colour as CSS writes it."""
    red, green, blue = (int(part) for part in colour)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _svg(width: float, height: float, content: str, label: str, box: tuple[float, float, float, float]) -> str:
    view = " ".join(f"{number:g}" for number in box)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" viewBox="{view}" role="img">'
        f"<title>{escape(label)}</title>{content}</svg>"
    )


def body_shapes(body: Body) -> str:
    """Returns the voxels as SVG shapes of size 1, one path for each type."""
    shapes = []
    for code in _NAMES:
        squares = "".join(f"M{column} {row}h1v1h-1z" for row, column in np.argwhere(body.grid == code))
        if squares:
            colour = palette.type_color(code)
            shapes.append(f'<path d="{squares}" fill="{css(colour)}" stroke="#fff" stroke-width=".06"/>')
            shapes.append(_marks(body.grid == code, code))
    return "".join(shapes)


def _marks(chosen: NDArray[np.bool_], code: int) -> str:
    """Strokes along which actuators work, so that their types can be told apart without colours."""
    if code not in _MARKS:
        return ""
    across, up = _MARKS[code]
    left, top = (1 - across) / 2, (1 - up) / 2
    ink = css(palette.shade(palette.type_color(code), 0.45))
    strokes = "".join(
        f"M{column + left:g} {row + top:g}h{across}v{up}h-{across}z" for row, column in np.argwhere(chosen)
    )
    return f'<path d="{strokes}" fill="{ink}"/>'


def body_svg(body: Body) -> str:
    """Returns the picture of a body, voxels by type, 90 pixels along its longer side."""
    unit = 90 / max(body.shape)
    return _svg(body.cols * unit, body.rows * unit, body_shapes(body), body.text, (0, 0, body.cols, body.rows))


def types_svg() -> str:
    """Returns the legend of the types."""
    parts = []
    for i, (code, name) in enumerate(_NAMES.items()):
        text = f'<text x="1.3" y=".75" font-size=".8">{name}</text>'
        mark = _marks(np.full((1, 1), True), code)
        square = f'<rect width="1" height="1" fill="{css(palette.type_color(code))}"/>'
        x, y = (0, 9.5)[i % 2], (0, 1.5)[i // 2]
        parts.append(f'<g transform="translate({x} {y})">{square}{mark}{text}</g>')
    return _svg(330, 46, "".join(parts), "colours of the voxel types", (0, 0, 19, 2.65))


def stiffness_svg(field: Field, occupancy: NDArray[np.bool_], hints: Sequence[str] | None = None) -> str:
    """Returns a stiffness field (rows, cols) as a map with its numbers, dark where stiff."""
    return cells_svg(field, occupancy, palette.stiffness_colors, "{:z.2f}", hints)


def cells_svg(
    values: Field, occupancy: NDArray[np.bool_], colours: Colours, form: str, hints: Sequence[str] | None = None
) -> str:
    """Returns values (rows, cols) as coloured squares with numbers; NaN is a pale square without one.

    Args:
        values: (rows, cols) what is shown.
        occupancy: where there are voxels; other cells stay empty.
        colours: returns (n, 3) colours of (n,) values.
        form: format of the numbers.
        hints: what to tell of each occupied cell, row-major, when it is pointed at.
    """
    cells = np.argwhere(occupancy)
    parts = []
    for i, (row, column) in enumerate(cells):
        value = values[row, column]
        is_known = np.isfinite(value)
        colour = colours(np.array([value]))[0] if is_known else None
        hint = f"<title>{escape(hints[i])}</title>" if hints else ""
        fill = _EMPTY if colour is None else css(colour)
        square = f'<rect width="{_CELL}" height="{_CELL}" fill="{fill}" stroke="#fff"/>'
        ink = "#fff" if colour is not None and np.dot(colour, (0.299, 0.587, 0.114)) < 140 else css(palette.INK)
        number = form.format(value) if is_known else ""
        text = f'<text x="{_CELL / 2}" y="{0.64 * _CELL:g}" text-anchor="middle" font-size="11" fill="{ink}">'
        place = f"translate({column * _CELL} {row * _CELL})"
        parts.append(f'<g transform="{place}">{hint}{square}{text}{number}</text></g>')
    height, width = (_CELL * count for count in values.shape)
    return _svg(width, height, "".join(parts), "values of the voxels", (0, 0, width, height))


def ramp_svg(colours: Colours, low: float, high: float, labels: Sequence[str], *, is_log: bool) -> str:
    """Returns the legend of a colour scale, with labels spread evenly from its low to its high end."""
    at = np.geomspace(low, high, 48) if is_log else np.linspace(low, high, 48)
    bars = "".join(f'<rect x="{4 * i}" width="4.5" height="12" fill="{css(c)}"/>' for i, c in enumerate(colours(at)))
    texts = "".join(
        f'<text x="{192 * i / (len(labels) - 1):g}" y="26" font-size="11" text-anchor="middle">{escape(label)}</text>'
        for i, label in enumerate(labels)
    )
    return _svg(230, 30, bars + texts, "colour scale", (-19, 0, 230, 30))


def stiffness_ramp() -> str:
    """Returns the legend of stiffness maps."""
    return ramp_svg(palette.stiffness_colors, STIFFNESS_LOW, STIFFNESS_HIGH, ("0.5", "1", "2"), is_log=True)
