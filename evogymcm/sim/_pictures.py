"""Worlds as text, and those that come with the package in that form."""

import re
from collections.abc import Iterator
from pathlib import Path

from evogymcm._grid import Grid, grid_from_rows
from evogymcm._messages import brief, known

WORLD_DIR = Path(__file__).parent / "worlds"
PREFAB_DIR = WORLD_DIR / "prefabs"
_HEADER = re.compile(r"(?P<name>.+) at (?P<x>-?\d+) (?P<y>-?\d+)(?: is (?P<prefab>\S+))?$")


def world_names() -> tuple[str, ...]:
    """Returns the names of the worlds that come with the package."""
    return _names(WORLD_DIR)


def prefab_names() -> tuple[str, ...]:
    """Returns the names of the prefabs: objects without a place."""
    return _names(PREFAB_DIR)


def load_prefab(name: str) -> Grid:
    """Returns the cells of a prefab, int8 of shape (rows, cols).

    Raises:
        ValueError: There is no prefab of that name.
    """
    return grid_from_rows(_read(PREFAB_DIR, name).split())


def load_picture(name: str) -> str:
    """Returns the picture of one of the package's worlds; ValueError where there is none of that name."""
    return _read(WORLD_DIR, name)


def _names(folder: Path) -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in folder.glob("*.txt")))


def _read(folder: Path, name: str) -> str:
    """Returns the text of a file of package data."""
    if name not in _names(folder):
        raise ValueError(f"{brief(name)}: there is only {known(name, _names(folder))}")
    return (folder / f"{name}.txt").read_text(encoding="utf-8")


def read_picture(text: str, name: str) -> tuple[tuple[int, int] | None, Iterator[tuple[str, Grid, tuple[int, int]]]]:
    """Returns the size that a picture gives, if any, and its objects: each one's name, cells and place.

    Args:
        text: The picture, see `World.from_picture`.
        name: The name of the object of a picture without headers.

    Raises:
        ValueError: It has no cells, or a size, a header or a row cannot be read.
    """
    size = None
    blocks: list[tuple[str, list[str]]] = []
    for line in (raw.strip() for raw in text.split("\n")):  # names may hold what else ends lines elsewhere
        if line.startswith("size "):
            size = _read_size(line)
        elif line.startswith("object "):
            blocks.append((line.removeprefix("object "), []))
        elif line and not line.startswith("#"):
            if not blocks:
                blocks.append((f"{name} at 0 0", []))
            blocks[-1][1].append(line)
    if not blocks:
        raise ValueError("picture: it has no cells")
    return size, (_read_block(header, rows) for header, rows in blocks)


def _read_size(line: str) -> tuple[int, int]:
    """Returns the width and height in a line "size WIDTH HEIGHT"."""
    match = re.fullmatch(r"size (\d+) (\d+)", line)
    if match is None:
        raise ValueError(f"picture: got the line {brief(line)}, expected 'size WIDTH HEIGHT'")
    return int(match[1]), int(match[2])


def _read_block(header: str, rows: list[str]) -> tuple[str, Grid, tuple[int, int]]:
    """Returns the object of a header "NAME at X Y" with rows, or "NAME at X Y is PREFAB" without."""
    match = _HEADER.fullmatch(header)
    if match is None or bool(match["prefab"]) == bool(rows):
        raise ValueError(
            f"picture: got the header {brief('object ' + header)} with {len(rows)} rows, "
            "expected 'object NAME at X Y' and rows, or 'object NAME at X Y is PREFAB' and none"
        )
    grid = load_prefab(match["prefab"]) if match["prefab"] else grid_from_rows(rows)
    return match["name"], grid, (int(match["x"]), int(match["y"]))
