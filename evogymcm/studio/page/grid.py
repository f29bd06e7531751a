"""The grid on which bodies, stiffness and terrain are drawn: one canvas for all cells."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from evogymcm._grid import CELL_CHARS, EMPTY
from evogymcm.envs.render import palette
from evogymcm.studio.drawing import Drawing
from evogymcm.studio.sketch import Sketch

NAMES = {".": "erase", "R": "rigid", "S": "soft", "H": "horizontal", "V": "vertical", "F": "fixed"}
_PHASES = ("start", "go", "end")


@dataclass(frozen=True)
class Stroke:
    """A part of a stroke: "start", "go" or "end", the cells it touches, and whether it erases."""

    phase: str
    cells: tuple[tuple[int, int], ...]
    erases: bool


class GridCanvas(Element, component="grid.js"):
    """The canvas.

    Args:
        label: What screen readers say of it.
        on_stroke: Called with each `Stroke`.
        on_command: Called with commands of the keyboard: a name, and its arguments.
    """

    def __init__(
        self, label: str, on_stroke: Callable[[Stroke], None], on_command: Callable[[str, dict[str, Any]], None]
    ) -> None:
        super().__init__()
        self._props.update(label=label, tool="brush", brush="", ink="", names={}, faded="")
        self.on("stroke", lambda event: self._stroke(event, on_stroke))
        self.on("command", lambda event: on_command(str(event.args.get("name")), event.args))

    @staticmethod
    def _stroke(event: GenericEventArguments, handle: Callable[[Stroke], None]) -> None:
        cells = tuple((int(row), int(col)) for row, col in event.args["cells"])
        if event.args["phase"] in _PHASES:
            handle(Stroke(event.args["phase"], cells, bool(event.args.get("erase"))))

    def show(self, sketch: Sketch, *, by_stiffness: bool = False) -> None:
        """Shows what is drawn, coloured by type or by stiffness."""
        grid = sketch.grid
        codes = grid.ravel()
        stiffness = sketch.stiffness.ravel() if isinstance(sketch, Drawing) else np.ones(codes.size)
        if by_stiffness:
            colors = palette.stiffness_colors(stiffness)
        else:
            colors = palette.type_colors(codes, np.ones(codes.size), stiffness)
        shown = codes != EMPTY
        faded = np.zeros(codes.size, bool)
        if isinstance(sketch, Drawing):
            pieces = sketch.pieces().ravel()
            faded = shown & (pieces != np.argmax(np.bincount(pieces[shown])) if shown.any() else False)
        self._props.update(
            rows=grid.shape[0],
            cols=grid.shape[1],
            codes="".join(CELL_CHARS[code] for code in codes),
            fills=[hex_color(color) if there else "" for color, there in zip(colors, shown, strict=True)],
            numbers=[f"{s:.3g}" if there and by_stiffness else None for s, there in zip(stiffness, shown, strict=True)],
            faded="".join("1" if is_faded else "0" for is_faded in faded),
        )
        self.update()

    def hold(self, tool: str, brush: str, ink: str, characters: str) -> None:
        """Puts a tool into the hand: its name, what it draws, its colour, and the brushes that keys choose."""
        names = {char: NAMES[char] for char in characters}
        self._props.update(tool=tool, brush=brush, ink=ink, names=names)
        self.update()


def hex_color(color: Any) -> str:
    """Returns a colour of the renderer as CSS has it."""
    return "#{:02x}{:02x}{:02x}".format(*(int(part) for part in color))
