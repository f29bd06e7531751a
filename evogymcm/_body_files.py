"""Bodies from files: EvoGym's arrays, rows of text, and the JSON of the EvoGym Design Tool."""

import re
import zipfile
from pathlib import Path

import numpy as np

from evogymcm._messages import brief, some
from evogymcm.body import FILE_SUFFIXES, Body, is_body_text
from evogymcm.sim.world import World


def read_body(path: Path) -> Body:
    """Returns the body in a file, see `evogymcm.as_body`."""
    readers = dict(zip(FILE_SUFFIXES, (_from_npz, _from_npy, _from_text, _from_json), strict=True))
    read = readers.get(path.suffix.lower())
    name = repr(str(path)) if len(str(path)) < 80 else brief(path.name)
    if read is None:
        raise ValueError(f"body {name}: expected a file that ends with {', '.join(readers)}")
    if not path.is_file():
        raise ValueError(f"body {name}: there is no such file")
    try:
        return read(path)
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"body {name}: {error}") from error


def _from_npz(path: Path) -> Body:
    with np.load(path) as arrays:
        if "arr_0" not in arrays:
            raise ValueError(f"expected arr_0 (and arr_1, the connections) as EvoGym has them, got {some(arrays)}")
        return Body(arrays["arr_0"], arrays.get("arr_1"))


def _from_npy(path: Path) -> Body:
    return Body(np.load(path))


def _from_text(path: Path) -> Body:
    lines = (line.strip() for line in path.read_text(encoding="utf-8").splitlines())
    rows = [line for line in lines if line and not line.startswith("#")]
    parts = [re.split(r"[\s,;]+", row.strip(",; ")) for row in rows]
    if all(len(cells) == 1 for cells in parts) and is_body_text("/".join(rows)):
        return Body("/".join(rows))
    try:
        return Body([[float(cell) for cell in cells] for cells in parts])
    except ValueError as error:
        raise ValueError(f"expected rows of cells such as HHH/V.V, or of codes such as 3 3 3, got {error}") from error


def _from_json(path: Path) -> Body:
    robot = World.from_design_tool(path).find_robot()
    if robot is None:
        raise ValueError("none of its objects has actuators")
    return Body(robot.grid, robot.connections)
