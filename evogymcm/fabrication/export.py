"""Writing a design's sheet: a folder with a drawing, a table, and a mesh of each material."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from evogymcm.body import Body, as_body
from evogymcm.fabrication.calibration import Calibration, read_calibration
from evogymcm.fabrication.meshes import load_trimesh, material_meshes
from evogymcm.fabrication.sheet import Sheet

DRAWING, TABLE = "sheet.svg", "sheet.csv"
_SUFFIXES = (".svg", ".csv", ".stl")


def export_design(
    body: "Body | str | os.PathLike[str] | Sequence[str] | ArrayLike",
    stiffness: ArrayLike | None = None,
    out: str | os.PathLike[str] = "sheet",
    *,
    size: float = 10.0,
    depth: float | None = None,
    classes: int = 5,
    calibration: Calibration | str | os.PathLike[str] | None = None,
    meshes: bool = True,
    overwrite: bool = False,
) -> list[Path]:
    """Writes the sheet of a design into a folder, all of it in one step, and returns the files' paths.

    `sheet.svg` is the drawing at true scale, with a layer for each material; `sheet.csv` the table of voxels; and for
    each material, such as soft voxels of stiffness 1.41, there is a mesh, `soft-S1.41.stl`, in millimetres and at its
    place in the body.

    Args:
        body: The body, in any form that `as_body` takes.
        stiffness: (rows, cols) factors in [0.5, 2]; None for 1 everywhere.
        out: The folder.
        size: Edge of a voxel, mm.
        depth: How far voxels extend out of the plane, mm; by default as much as their edge.
        classes: Number of classes of stiffness, see `Sheet`.
        calibration: What a stiffness means in the workshop, or the file that says it, see `read_calibration`.
        meshes: Whether to write meshes, which need the extra `export`.
        overwrite: Whether to replace an earlier sheet in the folder.

    Raises:
        FileExistsError: The folder exists, and `overwrite` is not set or it holds anything but a sheet.
        ImportError: trimesh is missing.
        ValueError: A value cannot be used, the calibration does not reach the design, or `out` is in no folder.
    """
    sheet = Sheet(as_body(body), stiffness, size=size, depth=depth, classes=classes)
    files = _contents(sheet, calibration, meshes=meshes)
    out = Path(out)
    check_out(out, overwrite=overwrite)
    place = out.resolve()
    part, old = (place.with_name(f".{place.name}.{kind}") for kind in ("part", "old"))
    for folder in (part, old):  # of one that was killed
        shutil.rmtree(folder, ignore_errors=True)
    part.mkdir()
    for name, content in files.items():
        (part / name).write_bytes(content)
    if place.exists():
        place.replace(old)
    part.replace(place)
    shutil.rmtree(old, ignore_errors=True)
    return [out / name for name in files]


def _contents(sheet: Sheet, calibration: Any, *, meshes: bool) -> dict[str, bytes]:
    """Returns the content of each file."""
    if meshes:
        load_trimesh()
    if calibration is not None and not isinstance(calibration, Calibration):
        calibration = read_calibration(calibration)
    files = {DRAWING: sheet.drawing().encode(), TABLE: sheet.table(calibration).encode()}
    solids = material_meshes(sheet) if meshes else {}
    return files | {f"{name}.stl": bytes(solid.export(file_type="stl")) for name, solid in solids.items()}


def check_out(out: Path, *, overwrite: bool) -> None:
    """Raises what `export_design` raises of its folder."""
    if not out.resolve().parent.is_dir():
        raise ValueError(f"out: the folder {out.parent} does not exist")
    if not out.exists():
        return
    if not overwrite:
        raise FileExistsError(f"{out} exists; set overwrite to replace it")
    is_sheet = out.is_dir() and all(file.suffix in _SUFFIXES and file.is_file() for file in out.iterdir())
    if not is_sheet or not ((out / DRAWING).exists() or not any(out.iterdir())):
        raise FileExistsError(f"{out} holds something else than a sheet, which is not replaced")
