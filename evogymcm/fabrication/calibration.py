"""A calibration: what a stiffness factor means in a workshop, from a table that its user has measured."""

import csv
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from evogymcm._messages import brief

_STIFFNESS, _TYPE, _KINDS = "stiffness", "type", ("rigid", "soft", "horizontal", "vertical")


class Calibration:
    """Numbers such as modulus, infill or mixing ratio against stiffness, interpolated linearly between its rows.

    Args:
        columns: Names of the numbers.
        rows: By type of voxel ("rigid", "soft", "horizontal", "vertical"; "" for those not named): rows of stiffness
            and the numbers, in rising order.

    Raises:
        ValueError: Stiffness does not rise, or a type is unknown.
    """

    def __init__(self, columns: Sequence[str], rows: Mapping[str, Sequence[Sequence[float]]]) -> None:
        self.columns = tuple(columns)
        self._rows = {kind: np.array(lines, np.float64) for kind, lines in rows.items()}
        for kind, lines in self._rows.items():
            if kind not in ("", *_KINDS):
                raise ValueError(f"calibration: got type {kind!r}, allowed are {', '.join(_KINDS)}, or none")
            if not (np.diff(lines[:, 0]) > 0).all():
                listed = ", ".join(f"{value:g}" for value in lines[:, 0])
                raise ValueError(f"calibration: stiffness{_of(kind)} must rise from row to row, got {listed}")

    def of(self, kind: str, stiffness: float) -> tuple[float, ...]:
        """Returns the numbers for a type of voxel and a stiffness.

        Raises:
            ValueError: The table has no row for the type, or does not reach the stiffness: it isn't extrapolated.
        """
        lines = self._rows.get(kind, self._rows.get(""))
        if lines is None:
            raise ValueError(f"calibration: it has no row for type {kind!r}, which the design has")
        low, high = lines[0, 0], lines[-1, 0]
        if not low - 1e-9 <= stiffness <= high + 1e-9:
            got = f"the design has {stiffness:g}, which calls for rows on both sides of it"
            raise ValueError(f"calibration: stiffness{_of(kind)} reaches from {low:g} to {high:g}; {got}")
        return tuple(float(np.interp(stiffness, lines[:, 0], column)) for column in lines.T[1:])


def _of(kind: str) -> str:
    return f" of {kind}" if kind else ""


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Returns the calibration in a CSV file.

    The first line names the columns: `stiffness`, then any others of numbers, such as `modulus_kpa` and
    `infill_percent`. With a column `type` there are rows for each type of voxel. Lines that begin with # are comments.

    Raises:
        ValueError: There is no such file, it lacks a column or a row, or holds what is no number.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"calibration: {path} cannot be read: {error}") from error
    table = list(csv.reader(line for line in lines if line.strip() and not line.startswith("#")))
    head = [name.strip() for name in table[0]] if table else []
    numbers = [name for name in head if name != _TYPE]
    if _STIFFNESS not in numbers or len(numbers) < 2 or len(set(head)) < len(head):
        raise ValueError(
            f"calibration: {path} has the columns {brief(head)}, expected 'stiffness' and others, once each"
        )
    if len(table) < 2:
        raise ValueError(f"calibration: {path} has no rows")
    columns = [name for name in numbers if name != _STIFFNESS]
    rows: dict[str, list[list[float]]] = {}
    for cells in table[1:]:
        row = dict(zip(head, (cell.strip() for cell in cells), strict=False))
        try:
            if len(cells) != len(head):
                raise ValueError
            values = [float(row[name]) for name in (_STIFFNESS, *columns)]
            if not all(map(math.isfinite, values)):
                raise ValueError
        except ValueError:
            raise ValueError(
                f"calibration: {path}: got {brief(','.join(cells))}, expected numbers for {numbers}"
            ) from None
        rows.setdefault(row.get(_TYPE, ""), []).append(values)
    return Calibration(columns, rows)
