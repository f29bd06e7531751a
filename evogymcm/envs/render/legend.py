"""The strip that says what colours mean."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from evogymcm._extras import load_pygame
from evogymcm.envs.render import palette
from evogymcm.envs.render.palette import Color
from evogymcm.sim.constants import FIXED, H_ACT, RIGID, SOFT, STIFFNESS_HIGH, STIFFNESS_LOW, V_ACT

_HATCHED = "fixed"
_TYPES = ((RIGID, "rigid"), (SOFT, "soft"), (H_ACT, "horizontal"), (V_ACT, "vertical"), (FIXED, _HATCHED))
_MARKS = {H_ACT: (5, 1), V_ACT: (1, 5)}  # eighths of a swatch, across and up


class Legend:
    """Writes and fills along a strip, from left to right.

    Args:
        surface: The strip, a pygame surface.
        font: A pygame font that fits.
    """

    def __init__(self, surface: Any, font: Any) -> None:
        self._surface, self._font = surface, font
        self._height = surface.get_height()
        self._box = self._height // 2
        self._gap = self._height // 4
        self._x = self._gap
        surface.fill(palette.PANEL)

    def _fill(self, color: Color, width: int) -> None:
        self._surface.fill(color, (self._x, (self._height - self._box) // 2, width, self._box))
        self._x += width

    def _write(self, text: str) -> None:
        label = self._font.render(text, True, palette.INK)
        self._surface.blit(label, (self._x, (self._height - label.get_height() + 1) // 2))
        self._x += label.get_width() + self._gap

    def _swatch(self, color: Color, text: str, mark: tuple[int, int] | None = None) -> None:
        x, box = self._x, self._box
        self._fill(color, box)
        if mark is not None:
            across, up = (max(box * share // 8, 2) for share in mark)
            place = (x + (box - across) // 2, (self._height - up) // 2, across, up)
            self._surface.fill(palette.shade(color, 0.45), place)
        if text == _HATCHED:
            top = (self._height - box) // 2
            line = (x, top + box - 1), (x + box - 1, top)
            load_pygame().draw.line(self._surface, palette.shade(color, 0.6), *line, 2)
        self._x += self._gap
        self._write(text)
        self._x += self._gap

    def _ramp(self, colors: Sequence[Color], width: int) -> None:
        ends = [i * width // len(colors) for i in range(len(colors) + 1)]
        for color, start, end in zip(colors, ends, ends[1:], strict=False):
            self._fill(color, end - start)
        self._x += self._gap

    def types(self) -> None:
        """Shows the colours of types, of an actuator's length, and of stiffness."""
        for code, name in _TYPES:
            self._swatch(palette.type_color(code), name, _MARKS.get(code))
        lengths = np.linspace(palette.STRETCH_LOW, palette.STRETCH_HIGH, 5)
        self._write("short")
        self._ramp([palette.type_color(H_ACT, stretch=float(length)) for length in lengths], 3 * self._box)
        self._write("long")
        self._x += self._gap
        factors = np.geomspace(STIFFNESS_LOW, STIFFNESS_HIGH, 5)
        self._write(f"stiffness {STIFFNESS_LOW:g}")
        self._ramp([palette.type_color(H_ACT, stiffness=float(factor)) for factor in factors], 3 * self._box)
        self._write(f"{STIFFNESS_HIGH:g}")

    def stiffness(self) -> None:
        """Shows the scale of the stiffness view, which is logarithmic."""
        self._write("stiffness of the robot's voxels")
        for low, high in ((STIFFNESS_LOW, 1.0), (1.0, STIFFNESS_HIGH)):
            self._write(f"{low:g}")
            colors = palette.stiffness_colors(np.geomspace(low, high, 32))
            self._ramp([(int(r), int(g), int(b)) for r, g, b in colors], 8 * self._box)
        self._write(f"{STIFFNESS_HIGH:g}")
        self._x += self._gap
        self._swatch(palette.NEUTRAL, "all else")
