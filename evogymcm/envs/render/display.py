"""A window that shows pictures."""

import logging
import os
import sys
from typing import Any

import numpy as np

from evogymcm._extras import load_pygame

_logger = logging.getLogger("evogymcm")


def has_display() -> bool:
    """Whether there is a display to open a window on (or SDL_VIDEODRIVER names where else to draw)."""
    if os.environ.get("SDL_VIDEODRIVER"):
        return True
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class Display:
    """A window, opened with the first picture. Once its user closes it, it stays closed.

    Args:
        title: What its frame says.
        fps: Pictures in a second: `show` waits until it is time.
    """

    def __init__(self, title: str, fps: float) -> None:
        self._title, self._fps = title, fps
        self._pygame = load_pygame()
        self._clock = self._pygame.time.Clock()
        self._is_open = self.is_closed = False

    def __getstate__(self) -> dict[str, Any]:
        """A copy opens the window anew: what pygame made can be neither copied nor pickled."""
        return {"_title": self._title, "_fps": self._fps, "is_closed": self.is_closed, "_is_open": False}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._pygame = load_pygame()
        self._clock = self._pygame.time.Clock()

    def show(self, picture: np.ndarray) -> bool:
        """Shows a picture, uint8 (height, width, 3), and returns whether the window is still open."""
        if self.is_closed:
            return False
        pygame, size = self._pygame, (picture.shape[1], picture.shape[0])
        if not self._is_open and not has_display():
            _logger.warning("there is no display: the window cannot be seen")
        screen = pygame.display.get_surface()  # there is one in a process, which a copy may have opened or closed
        if screen is None or not self._is_open or screen.get_size() != size:
            pygame.display.init()
            screen = pygame.display.set_mode(size)
            pygame.display.set_caption(self._title)
            self._is_open = True
        screen.blit(pygame.image.frombuffer(picture.tobytes(), size, "RGB"), (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
        return not self.is_closed

    def close(self) -> None:
        """Closes the window; a second time does nothing."""
        if self._is_open:
            self._pygame.display.quit()
        self._is_open, self.is_closed = False, True
