"""Pictures and videos as files, through imageio. Files are written completely or not at all."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from evogymcm._extras import load_ffmpeg, load_imageio
from evogymcm.envs.render.renderer import FPS

VIDEOS = (".mp4", ".gif")


def write_video(path: str | Path, frames: Iterable[np.ndarray], fps: float = FPS) -> Path:
    """Writes an MP4 or GIF and returns its path. Frames are taken one by one; they may come from a generator.

    Args:
        path: The file, which ends in ".mp4" or ".gif". An existing file is replaced.
        frames: uint8 (height, width, 3), all of one size. MP4 needs even sizes: a last odd row or column is doubled.
        fps: Frames per second. In a GIF a frame lasts whole hundredths of a second, and viewers show at most 50 a
            second.

    Raises:
        ImportError: imageio is not installed (for MP4 imageio-ffmpeg too).
        ValueError: The suffix is another, a frame is not a picture or differs in size, or there is no frame.
    """
    path = Path(path)
    if path.suffix.lower() not in VIDEOS:
        raise ValueError(f"video: got {path.name!r}, allowed suffixes are {VIDEOS}")
    imageio = load_imageio()
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        with _open(imageio, part, fps) as writer:
            _append(writer, frames, is_even=path.suffix.lower() == ".mp4")
        _publish(part, path)
    finally:
        part.unlink(missing_ok=True)
    return path


def write_picture(path: str | Path, frame: np.ndarray) -> Path:
    """Writes one frame, uint8 (height, width, 3), as a PNG and returns its path. An existing file is replaced.

    Raises:
        ImportError: imageio is not installed.
        ValueError: The suffix is not ".png", or the frame is no picture.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise ValueError(f"picture: got {path.name!r}, the suffix must be .png")
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        load_imageio().imwrite(part, _check(frame, None))
        _publish(part, path)
    finally:
        part.unlink(missing_ok=True)
    return path


def _open(imageio: Any, part: Path, fps: float) -> Any:
    """Returns a writer of frames."""
    if part.suffix.lower() == ".gif":
        return imageio.get_writer(part, mode="I", duration=1000 / fps, loop=0)
    load_ffmpeg()
    return imageio.get_writer(part, format="FFMPEG", mode="I", fps=fps, codec="libx264", macro_block_size=1)


def _append(writer: Any, frames: Iterable[np.ndarray], is_even: bool) -> None:
    shape = None
    for frame in frames:
        frame = _check(frame, shape)
        shape = frame.shape
        if is_even:
            frame = np.pad(frame, ((0, shape[0] % 2), (0, shape[1] % 2), (0, 0)), mode="edge")
        writer.append_data(frame)
    if shape is None:
        raise ValueError("video: got no frame, at least one is needed")


def _check(frame: Any, shape: tuple[int, ...] | None) -> np.ndarray:
    frame = np.asarray(frame)
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3 or shape not in (None, frame.shape):
        raise ValueError(f"frame: got {frame.dtype} {frame.shape}, expected uint8 {shape or '(height, width, 3)'}")
    return frame


def _publish(part: Path, path: Path) -> None:
    """Puts a finished file in its place in one step."""
    with part.open("rb+") as file:
        os.fsync(file.fileno())
    part.replace(path)
