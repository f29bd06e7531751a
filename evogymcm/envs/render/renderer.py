"""Pictures of worlds: one, or a whole population side by side. No display is needed."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evogymcm._extras import load_pygame
from evogymcm.body import Body
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.engines import engine_of
from evogymcm.envs.render import palette
from evogymcm.envs.render.downscale import FINE, downscale
from evogymcm.envs.render.legend import Legend
from evogymcm.envs.render.painter import Painter, Shown
from evogymcm.envs.render.scenery import Camera, Parts, make_parts

VIEWS = ("types", "stiffness")
FPS = 50  # env-steps in a second, as EvoGym shows them
_STRIP, _FONT = 22, 16  # heights of the legend and of its letters in a picture 640 wide
_LEGEND_FROM = 600  # narrower pictures have no legend
_TEXT_FROM = 110  # narrower pictures have no text
_PADDING = (5, 3)  # voxels around the robot, across and up, as in EvoGym
_GRID_PADDING = (2, 1)  # ... in a population, where pictures are small
_GRID_GAP = 2
_NARROWEST_TILE, _SMALLEST = 48, 16
_OPTIONS = ("width", "height", "view", "legend", "hide_background", "hide_edges", "hide_voxels")
_WITHOUT_EFFECT = ("verbose", "hide_grid")  # EvoGym's: nothing is printed here, and there is no grid behind the robot
_DRAWN = ("_pygame", "_font", "_strip", "_surfaces")  # what pygame made, which can be neither copied nor pickled


class Renderer:
    """Draws the worlds of an environment as they are.

    Types view: hue is the voxel's type, brightness falls with its stiffness (0.9 / sqrt(S)), and an actuator is
    paler the longer it is. Stiffness view: the robot's stiffness alone, on a logarithmic scale. The camera follows
    the robot, and the package or beam of its task, with some delay over env-steps; it starts anew in a new episode.

    Args:
        env: The environment, or its engine, to draw.
        width: Pixels across.
        height: Pixels up.
        view: "types" or "stiffness".
        legend: Whether a strip below says what colours mean; by default in pictures at least 600 wide.
        hide_background: Whether to leave out the implicit floor and the goal.
        hide_edges: Whether to leave out outlines and the marks of actuators.
        hide_voxels: Whether to leave the voxels unfilled.

    Raises:
        ImportError: pygame-ce is not installed.
        ValueError: The view is unknown, the picture smaller than 16 x 16, or there is no engine in `env`.
    """

    def __init__(
        self,
        env: object,
        width: int = 640,
        height: int = 320,
        view: str = "types",
        *,
        legend: bool | None = None,
        hide_background: bool = False,
        hide_edges: bool = False,
        hide_voxels: bool = False,
    ) -> None:
        if view not in VIEWS:
            raise ValueError(f"view: got {view!r}, allowed are {VIEWS}")
        if min(width, height) < _SMALLEST:
            raise ValueError(f"size: got {width} x {height}, allowed are 16 x 16 and more")
        self.engine, self.width, self.height, self.view = engine_of(env), width, height, view
        self._shown = Shown(not hide_background, not hide_edges, not hide_voxels)
        self._parts: dict[Body, Parts] = {}
        self._drawn: dict[int, Body] = {}  # the body of each world when it was last drawn
        self._cameras: dict[tuple[int, bool], Camera] = {}  # by world, and whether it is for the grid
        self._unit = max(1.0, min(width / 640, height / 320))
        has_legend = width >= _LEGEND_FROM and height >= 4 * _STRIP if legend is None else legend
        self._strip_height = round(_STRIP * self._unit) if has_legend else 0
        self._scene_height = height - self._strip_height
        self._prepare()

    def _prepare(self) -> None:
        """Makes what belongs to pygame."""
        self._pygame = load_pygame()
        self._pygame.font.init()
        self._surfaces: dict[tuple[int, int], Any] = {}
        self._font = self._pygame.font.Font(None, round(_FONT * self._unit * FINE))
        self._strip = self._make_strip(self._strip_height) if self._strip_height else None

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in self.__dict__.items() if name not in _DRAWN}
        return kept | {"_parts": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()

    def frame(self, world: int = 0) -> np.ndarray:
        """Returns a picture of one world, uint8 (height, width, 3)."""
        surface = self._surface(self.width, self.height)
        self._draw(surface.subsurface((0, 0, FINE * self.width, FINE * self._scene_height)), world, is_tile=False)
        return self._finish(surface)

    def grid(self, worlds: Sequence[int] | None = None, columns: int | None = None) -> np.ndarray:
        """Returns a picture of many worlds, row by row, uint8 (rows * tile's height + legend, width, 3).

        Tiles share the picture's width, but are at least 48 wide: many columns make the picture wider.

        Args:
            worlds: Which worlds; all by default.
            columns: How many are side by side; by default as many as there are rows.

        Raises:
            ValueError: There are no worlds or no columns.
        """
        chosen = list(range(self.engine.num_worlds)) if worlds is None else [int(world) for world in worlds]
        columns = math.ceil(math.sqrt(len(chosen))) if columns is None else columns
        if not chosen or columns < 1:
            raise ValueError(f"grid: got {len(chosen)} worlds in {columns} columns, at least one of each is needed")
        wide = max(self.width // columns, _NARROWEST_TILE)
        high = max(wide * self._scene_height // self.width, _SMALLEST)
        rows = math.ceil(len(chosen) / columns)
        strip = self._strip.get_height() // FINE if self._strip else 0
        surface = self._surface(max(self.width, columns * wide), rows * high + strip)
        surface.fill(palette.PANEL)
        for i, world in enumerate(chosen):
            place = (i % columns * wide, i // columns * high, wide - _GRID_GAP, high - _GRID_GAP)
            self._draw(surface.subsurface([FINE * part for part in place]), world, is_tile=True)
        return self._finish(surface)

    def _finish(self, surface: Any) -> np.ndarray:
        """Adds the legend and returns the picture."""
        if self._strip is not None:
            surface.blit(self._strip, (0, surface.get_height() - self._strip.get_height()))
        return downscale(self._pygame.surfarray.pixels2d(surface).T)

    def _draw(self, surface: Any, world: int, is_tile: bool) -> None:
        """Draws a world on a surface."""
        engine = self.engine
        body = engine.bodies[world]
        if self._drawn.get(world) is not body:
            self._change_body(world)
        if body not in self._parts:
            self._parts[body] = make_parts(engine, world)
        parts, points = self._parts[body], engine.simulator.points(world)
        width, height = surface.get_size()
        if (world, is_tile) not in self._cameras:
            self._cameras[world, is_tile] = Camera(_GRID_PADDING if is_tile else _PADDING)
        view = self._cameras[world, is_tile].follow(
            points[:, parts.followed], int(engine.length[world]), width / height
        )
        painter = Painter(surface, view, self.view == "stiffness", self._shown)
        painter.background(getattr(engine.task, "goal_x", None), getattr(engine.task, "goal_y", None))
        painter.squares(parts)
        painter.voxels(parts, points, engine.stiffness[world])
        if width >= FINE * _TEXT_FROM:
            self._write(surface, self._text(world, is_tile))

    def _change_body(self, world: int) -> None:
        """Forgets the view of a world whose body is another one, and bodies that no world holds."""
        self._drawn[world] = self.engine.bodies[world]
        self._cameras = {key: camera for key, camera in self._cameras.items() if key[0] != world}
        if len(self._parts) >= self.engine.num_worlds:
            present = set(self.engine.bodies)
            self._parts = {body: parts for body, parts in self._parts.items() if body in present}

    def _text(self, world: int, is_tile: bool) -> str:
        engine = self.engine
        if is_tile:
            return f"{world}: {engine.returns[world]:.2f}"
        unstable = "   unstable" if engine.unstable[world] else ""
        return f"{engine.task.id}   step {engine.length[world]}   return {engine.returns[world]:.2f}{unstable}"

    def _write(self, surface: Any, text: str) -> None:
        """Writes in the upper left corner, on a panel."""
        label = self._font.render(text, True, palette.INK, palette.PANEL)
        surface.blit(label, (4 * FINE, 4 * FINE))

    def _surface(self, width: int, height: int) -> Any:
        """Returns a surface for a picture of that size, always the same one."""
        if (width, height) not in self._surfaces:
            masks = (0xFF0000, 0x00FF00, 0x0000FF, 0)
            self._surfaces[width, height] = self._pygame.Surface((FINE * width, FINE * height), 0, 32, masks)
        return self._surfaces[width, height]

    def _make_strip(self, height: int) -> Any:
        strip = self._surface(self.width, height).copy()
        legend = Legend(strip, self._font)
        if self.view == "types":
            legend.types()
        else:
            legend.stiffness()
        return strip


def make_renderer(engine: TaskEngine, mode: str | None, options: Mapping[str, Any] | None) -> Renderer | None:
    """Returns what draws for an environment's `render_mode` and `render_options`; None where there is no mode.

    Options are keywords of `Renderer`; those that only EvoGym knows have no effect.

    Raises:
        ImportError: There is a mode, and pygame-ce is not installed.
        ValueError: For an option that neither knows, or as `Renderer`.
    """
    given = dict(options or {})
    unknown = [name for name in given if name not in _OPTIONS + _WITHOUT_EFFECT]
    if unknown:
        raise ValueError(f"render_options: got {unknown}, allowed are {[*_OPTIONS, *_WITHOUT_EFFECT]}")
    if mode is None:
        return None
    return Renderer(engine, **{name: value for name, value in given.items() if name in _OPTIONS})
