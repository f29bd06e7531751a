"""What leaves the studio of a design: videos, and sheets for fabrication."""

import io
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from evogymcm.body import Body, as_body
from evogymcm.envs import Renderer, write_video
from evogymcm.envs.render.renderer import FPS
from evogymcm.envs.tasks import as_task
from evogymcm.fabrication import export_design
from evogymcm.studio.driving import Driver
from evogymcm.studio.stage import Stage
from evogymcm.studio.watching import Wanted, read_field

WIDTH, HEIGHT = 640, 320
EVERY = 2  # env-steps that a picture stands for


def film(wanted: Wanted, path: Path, *, steps: int = 250, view: str = "types") -> Path:
    """Writes an episode, or its beginning, as a GIF or MP4, and returns the file.

    Args:
        wanted: What is to be seen.
        path: The file, which ends in .gif or .mp4.
        steps: Env-steps at most.
        view: "types" or "stiffness".

    Raises:
        ImportError: A package of the extra `render` is missing.
        ValueError: It cannot be seen, or the suffix is another.
    """
    driver = Driver(wanted.policy, as_task(wanted.task), wanted.material)
    stage = Stage(driver, as_body(wanted.body), read_field(wanted), 0)
    renderer = Renderer(stage.engine, WIDTH, HEIGHT, view)

    def frames() -> Iterator[np.ndarray]:
        for step in range(steps):
            if step % EVERY == 0:
                yield renderer.frame()
            if stage.has_ended:
                return
            stage.advance()

    try:
        return write_video(path, frames(), FPS / EVERY)
    finally:
        stage.engine.close()


def zip_sheet(body: Body, stiffness: np.ndarray, **options: Any) -> bytes:
    """Returns the files of a sheet for fabrication as a ZIP file; options and errors are those of `export_design`."""
    file = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in export_design(body, stiffness, Path(folder) / "sheet", **options):
            archive.write(path, path.name)
    return file.getvalue()
