"""The optional packages, imported when they are first used."""

import os
from importlib import import_module
from typing import Any


def load_extra(module: str, need: str, extra: str) -> Any:
    """Returns a module of an optional package.

    Raises:
        ImportError: It cannot be imported; `need` says what needs it, and the extra is named.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(f"{need}: pip install evogymcm[{extra}]") from error


def load_pygame() -> Any:
    """Returns pygame, kept from printing its greeting; an ImportError where it is missing."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    return load_extra("pygame", "rendering needs pygame-ce, which cannot be imported", "render")


def load_imageio() -> Any:
    """Returns imageio; an ImportError where it is missing."""
    return load_extra("imageio.v2", "rendering needs imageio, which cannot be imported", "render")


def load_ffmpeg() -> Any:
    """Returns imageio's FFMPEG; an ImportError where it is missing."""
    return load_extra("imageio_ffmpeg", "MP4 needs imageio-ffmpeg", "render")


def load_plotly() -> Any:
    """Returns `plotly.graph_objects`; an ImportError where it is missing."""
    return load_extra("plotly.graph_objects", "reports need plotly, which cannot be imported", "report")


def load_cma() -> Any:
    """Returns the package for CMA-ES; an ImportError where it is missing."""
    return load_extra("cma", "CMA-ES (proposal 'cma', gaits) needs the package cma", "cma")
