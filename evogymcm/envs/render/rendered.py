"""What an environment's `render_mode` asks for: pictures, or a window that shows every step."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from evogymcm.envs.core import TaskEngine
from evogymcm.envs.render.display import Display
from evogymcm.envs.render.renderer import FPS, Renderer, make_renderer

_IN_A_WINDOW = ("human", "screen")


def check_render_mode(mode: str | None, metadata: Mapping[str, Any]) -> str | None:
    """Returns a mode that is among an environment's `render_modes`, or None; ValueError for another."""
    if mode is not None and mode not in metadata["render_modes"]:
        raise ValueError(f"render_mode: got {mode!r}, allowed are None and {metadata['render_modes']}")
    return mode


class Rendered:
    """An environment that is drawn as its `render_mode` says; its window opens with the first step.

    Attributes:
        engine: The task engine.
        render_mode: As it was given.
    """

    engine: TaskEngine
    render_mode: str | None
    _renderer: Renderer | None = None
    _window: Display | None = None

    def _draw(self, options: Mapping[str, Any] | None) -> None:
        """Makes what draws the engine, by keywords of `Renderer`, and the window where there is none yet."""
        self._renderer = make_renderer(self.engine, self.render_mode, options)
        if self.render_mode in _IN_A_WINDOW and self._window is None:
            self._window = Display(self.engine.task.id, FPS)

    def _picture(self, renderer: Renderer) -> np.ndarray:
        """Returns the picture that is shown, uint8 (height, width, 3)."""
        return renderer.frame()

    def render(self) -> np.ndarray | None:
        """Returns a picture, uint8 (height, width, 3), where `render_mode` asks for one; see `Renderer`."""
        return self._picture(self._renderer) if self._renderer and not self._window else None

    def _show(self) -> None:
        if self._renderer and self._window and not self._window.is_closed:
            self._window.show(self._picture(self._renderer))

    def close(self) -> None:
        """Closes the window, where there is one, and ends the simulator's threads; a later step starts them again."""
        self.engine.close()
        if self._window:
            self._window.close()
