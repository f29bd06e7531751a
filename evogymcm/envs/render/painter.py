"""Draws the parts of a world on a pygame surface. Surfaces are twice the picture's size: scaling down smooths edges."""

from typing import Any, NamedTuple

import numpy as np

from evogymcm._extras import load_pygame
from evogymcm.envs.render import palette
from evogymcm.envs.render.scenery import Parts, View, stretches
from evogymcm.sim.constants import FIXED, H_ACT, V_ACT, VOXEL

_MARK = 0.28  # half the length of the line that shows an actuator's direction, in voxel widths
_MARKED_FROM = 18  # width of a voxel in fine pixels from which actuators are marked
_OUTLINED_FROM = 10  # ... from which voxels are outlined


class Shown(NamedTuple):
    """What of a world is drawn."""

    background: bool = True  # the implicit floor, and the goal
    edges: bool = True
    voxels: bool = True  # their insides


class Painter:
    """Draws one world, seen from a view, on a surface.

    Args:
        surface: A pygame surface.
        view: What to see; the surface's aspect is kept.
        by_stiffness: Whether colours show stiffness alone, instead of types.
        shown: What to draw.
    """

    def __init__(self, surface: Any, view: View, by_stiffness: bool, shown: Shown) -> None:
        self._pygame = load_pygame()
        self._surface = surface
        self._width, self._height = surface.get_size()
        self._scale = self._height / view.height  # pixels in a metre
        self._left = view.x - self._width / self._scale / 2
        self._top = view.y + view.height / 2
        self._by_stiffness, self._shown = by_stiffness, shown
        voxel = self._scale * VOXEL
        self._thin = 2 if voxel >= _OUTLINED_FROM and shown.edges else 0
        self._bold = 4 if voxel >= _MARKED_FROM else self._thin or 1
        self._has_marks = voxel >= _MARKED_FROM and shown.edges and not by_stiffness

    def _pixels(self, xy: np.ndarray) -> np.ndarray:
        """Returns pixels (..., 2) of metres (..., 2)."""
        return (xy - (self._left, self._top)) * (self._scale, -self._scale)

    def background(self, goal_x: float | None, goal_y: float | None) -> None:
        """Draws the sky, the implicit floor below y = 0, and a dashed line at the goal."""
        surface = self._surface
        surface.fill(palette.SKY)
        if not self._shown.background:
            return
        (x, y), (_, floor) = self._pixels(np.array([[goal_x or 0.0, goal_y or 0.0], [0.0, 0.0]]))
        if floor < self._height:
            surface.fill(palette.FLOOR, (0, max(round(floor), 0), self._width, self._height))
        if goal_x is not None and -2 <= x < self._width:
            for start in range(0, self._height, 24):
                surface.fill(palette.GOAL, (round(x) - 1, start, 3, 14))
        if goal_y is not None and -2 <= y < self._height:
            for start in range(0, self._width, 24):
                surface.fill(palette.GOAL, (start, round(y) - 1, 14, 3))

    def squares(self, parts: Parts) -> None:
        """Draws the voxels that never move, hatched."""
        ends = self._pixels(VOXEL * (parts.squares[:, None] + np.array([[0, 1], [1, 0]])))  # upper left, lower right
        ends = np.rint(ends).astype(int)
        seen = (ends[:, 1] > 0).all(1) & (ends[:, 0] < (self._width, self._height)).all(1)
        color = palette.NEUTRAL_FIXED if self._by_stiffness else palette.type_color(FIXED)
        dark, ink, thin, bold = palette.shade(color, 0.8), palette.shade(color, 0.45), self._thin, self._bold
        surface, line, fill = self._surface, self._pygame.draw.line, self._surface.fill
        surface_sides = []
        for ((x, y), (right, bottom)), sides in zip(
            ends[seen].tolist(), parts.square_sides[seen].tolist(), strict=True
        ):
            if self._shown.voxels:
                fill(dark, (x, y, right - x, bottom - y))
                fill(color, (x, y, right - x - thin, bottom - y - thin))
            if thin:
                line(surface, dark, (x + thin, bottom - 2 * thin), (right - 2 * thin, y + thin), thin)
            if self._shown.edges and any(sides):
                surface_sides.append((x, y, right, bottom, sides))
        for x, y, right, bottom, (at_top, at_right, at_bottom, at_left) in surface_sides:
            if at_top:
                fill(ink, (x, y, right - x, bold))
            if at_bottom:
                fill(ink, (x, bottom - bold, right - x, bold))
            if at_left:
                fill(ink, (x, y, bold, bottom - y))
            if at_right:
                fill(ink, (right - bold, y, bold, bottom - y))

    def voxels(self, parts: Parts, points: np.ndarray, stiffness: np.ndarray) -> None:
        """Draws the voxels that move, deformed as they are.

        Args:
            parts: What to draw.
            points: (2, n) metres, by the scene's numbers.
            stiffness: (V,) the robot's stiffness on the padded grid.
        """
        metres = points.T[parts.corners]
        pixels = self._pixels(metres)
        seen = (pixels.max(1) > 0).all(1) & (pixels.min(1) < (self._width, self._height)).all(1)
        is_robot = np.arange(len(seen)) >= parts.first_robot
        factors = np.ones(len(seen))
        factors[parts.first_robot :] = stiffness[parts.cells]
        colors = self._colors(metres, parts.codes, factors, is_robot)
        for group in (seen & ~is_robot, seen & is_robot):
            self._quads(pixels[group], parts.codes[group], parts.sides[group], colors[group])

    def _colors(self, quads: np.ndarray, codes: np.ndarray, factors: np.ndarray, is_robot: np.ndarray) -> np.ndarray:
        if self._by_stiffness:
            return np.where(is_robot[:, None], palette.stiffness_colors(factors), palette.NEUTRAL)
        return palette.type_colors(codes, stretches(quads, codes), factors)

    def _quads(self, quads: np.ndarray, codes: np.ndarray, sides: np.ndarray, colors: np.ndarray) -> None:
        """Fills and outlines voxels, their surface in bold."""
        draw, surface = self._pygame.draw, self._surface
        corners = quads.tolist()
        if self._shown.voxels:
            for four, color in zip(corners, colors.tolist(), strict=True):
                draw.polygon(surface, color, four)
        if self._thin:
            outlines = np.rint(colors * 0.6).astype(int).tolist()
            for four, outline in zip(corners, outlines, strict=True):
                draw.lines(surface, outline, True, four, self._thin)
        if self._has_marks:
            self._marks(quads, codes, colors)
        if not self._shown.edges:
            return
        for four, is_surface in zip(corners, sides.tolist(), strict=True):
            for i in range(4):
                if is_surface[i]:
                    draw.line(surface, palette.INK, four[i], four[(i + 1) % 4], self._bold)

    def _marks(self, quads: np.ndarray, codes: np.ndarray, colors: np.ndarray) -> None:
        """Draws a line along each actuator's direction, as long as the actuator is stretched."""
        for code, (one, other) in ((H_ACT, ((0, 3), (1, 2))), (V_ACT, ((0, 1), (2, 3)))):
            mine = quads[codes == code]
            a, b = mine[:, one].mean(1), mine[:, other].mean(1)
            ends = np.stack([(a + b) / 2 + _MARK * (b - a), (a + b) / 2 - _MARK * (b - a)], axis=1).tolist()
            marks = np.rint(colors[codes == code] * 0.45).astype(int).tolist()
            for (start, end), color in zip(ends, marks, strict=True):
                self._pygame.draw.line(self._surface, color, start, end, self._bold)
