"""How the page looks: colours of the renderer, and the parts that many panels are made of."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import ui

from evogymcm._grid import CELL_CHARS, EMPTY
from evogymcm.body import STIFFNESS_HIGH, STIFFNESS_LOW
from evogymcm.envs.render import palette
from evogymcm.studio.drawing import Drawing
from evogymcm.studio.page.grid import hex_color

BLUE = hex_color(palette.type_color(CELL_CHARS.index("V")))
ORANGE = hex_color(palette.type_color(CELL_CHARS.index("H")))
ICON = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 24"><rect x="2" y="3" width="20" height="10" rx="2"
fill="#b37232"/><rect x="2" y="13" width="7" height="8" rx="2" fill="#326cb3"/><rect x="15" y="13" width="7" height="8"
rx="2" fill="#326cb3"/></svg>"""
SEGMENTS = "unelevated no-caps toggle-color=white color=transparent text-color=grey-8 toggle-text-color=dark"
SEGMENTS = "unelevated no-caps toggle-color=white color=transparent text-color=grey-8 toggle-text-color=dark"
_CSS = Path(__file__).with_name("studio.css")


def dress() -> None:
    """Gives the page its colours and its style sheet."""
    ui.colors(primary=BLUE, secondary=ORANGE, accent=ORANGE, positive="#1d7a45", negative="#b3261e")
    ui.add_css(_CSS.read_text(encoding="utf-8"))


def icon_button(icon: str, what: str, on_click: Callable[[], Any], *, marker: str = "") -> ui.button:
    """Returns a flat button with an icon, and what it does as its tooltip and spoken name."""
    button = ui.button(icon=icon, on_click=on_click).props(f'flat dense color=grey-8 aria-label="{what}"')
    button.classes("studio-tool").tooltip(what)
    return button.mark(marker or icon)


def swatch_button(code: int, name: str, on_click: Callable[[], Any]) -> ui.button:
    """Returns a button that shows a voxel of that type."""
    char = CELL_CHARS[code]
    button = ui.button(on_click=on_click).props(f'flat dense no-caps aria-label="brush {name}"')
    with button.classes("studio-brush").mark(f"brush-{char}"):
        swatch = ui.element("div").classes(f"studio-swatch is-{char if code != EMPTY else 'erase'}")
        if code != EMPTY:
            swatch.style(f"background-color: {hex_color(palette.type_color(code))}")
        with swatch:
            ui.element("i")
        ui.label(name)
    return button


def stiffness_ramp() -> None:
    """Shows the colour bar of stiffness, with its ends."""
    stops = [hex_color(color) for color in palette.stiffness_colors(np.geomspace(STIFFNESS_LOW, STIFFNESS_HIGH, 17))]
    ui.element("div").classes("studio-ramp").style(f"background: linear-gradient(90deg, {', '.join(stops)})")


def thumbnail(drawing: Drawing) -> str:
    """Returns a small picture of a drawing, as SVG."""
    grid, stiffness = drawing.grid, drawing.stiffness
    rows, cols = grid.shape
    size = max(rows, cols)
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size} {size}" aria-hidden="true">']
    for row, col in zip(*np.nonzero(grid), strict=True):
        color = hex_color(palette.type_color(int(grid[row, col]), 1.0, float(stiffness[row, col])))
        x, y = col + (size - cols) / 2, row + size - rows
        parts.append(f'<rect x="{x + 0.03}" y="{y + 0.03}" width=".94" height=".94" rx=".08" fill="{color}"/>')
    return "".join([*parts, "</svg>"])


class Says:
    """A line that says whether something is well.

    Args:
        marker: What tests find it by.
    """

    def __init__(self, marker: str) -> None:
        with ui.element("div").classes("studio-says").props("role=status aria-live=polite") as self._row:
            self._icon = ui.icon("check_circle")
            self._label = ui.label().mark(marker)

    def say(self, text: str, is_good: bool) -> None:
        """Says it."""
        self._label.set_text(text)
        self._icon.set_name("check_circle" if is_good else "error_outline")
        self._row.classes(add="is-good" if is_good else "is-bad", remove="is-bad" if is_good else "is-good")
