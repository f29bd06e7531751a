"""The optional packages that pictures and videos need, imported when they are first used."""

import os
from importlib import import_module
from typing import Any

_INSTALL = "pip install evogymcm[render]"


def load_pygame() -> Any:
    """Returns pygame, kept from printing its greeting.

    Raises:
        ImportError: It is not installed.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    return _load("pygame", "pygame-ce")


def load_imageio() -> Any:
    """Returns imageio.

    Raises:
        ImportError: It is not installed.
    """
    return _load("imageio.v2", "imageio")


def _load(module: str, package: str) -> Any:
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(f"rendering needs {package}, which cannot be imported: {_INSTALL}") from error
