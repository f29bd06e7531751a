"""A robot as it is drawn: voxels and their stiffness, which need not be a valid body yet."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evogymcm._grid import BODY_CHARS, EMPTY, Grid
from evogymcm._messages import brief
from evogymcm.body import (
    STIFFNESS_HIGH,
    STIFFNESS_LOW,
    Body,
    as_body,
    check_field,
    full_connections,
    has_actuator,
    mutate_body,
    sample_body,
)
from evogymcm.studio.sketch import Sketch, label_pieces

Field = NDArray[np.float64]


class Drawing(Sketch):
    """A grid of up to 10 x 10 voxels with a stiffness each, see `Sketch` for strokes and undo.

    Args:
        grid: Cell codes 0 to 4 of shape (rows, cols), first row on top.
        stiffness: Factors in [0.5, 2] of the same shape; None is 1 everywhere.

    Raises:
        ValueError: Codes or factors are others, the shapes differ, or the grid is larger.
    """

    _chars = BODY_CHARS

    def __init__(self, grid: ArrayLike, stiffness: ArrayLike | None = None) -> None:
        super().__init__(grid)
        if stiffness is not None:
            self._layers[1] = check_field(stiffness, self.occupancy)

    @classmethod
    def blank(cls, rows: int = 5, cols: int = 5) -> "Drawing":
        """Returns an empty grid."""
        return cls(np.zeros(cls._check_shape((rows, cols)), np.int8))

    @classmethod
    def of(
        cls, body: "Body | str | os.PathLike[str] | Sequence[str] | ArrayLike", stiffness: ArrayLike | None = None
    ) -> "Drawing":
        """Returns the drawing of a body, in any form that `as_body` takes.

        Raises:
            ValueError: It is no body, larger than 10 x 10, or has joints cut, which a drawing cannot show.
        """
        body = as_body(body)
        if not body.has_default_connections:
            cut = len(full_connections(body.grid).T) - len(body.connections.T)
            raise ValueError(f"body {brief(body.text)}: {cut} of its joints are cut, which a drawing cannot show")
        return cls(body.grid, stiffness)

    def _make_layers(self, cells: Grid) -> list[NDArray[Any]]:
        return [cells, np.ones(cells.shape)]

    def _refit(self, cells: Grid) -> list[NDArray[Any]]:
        layers = self._make_layers(cells)
        if cells.shape == self.shape:
            layers[1] = np.where(cells != EMPTY, self._layers[1], 1.0)
        return layers

    @property
    def stiffness(self) -> Field:
        """Factors of shape (rows, cols), 1 on empty cells; a copy."""
        return self._layers[1].copy()

    @property
    def has_stiffness(self) -> bool:
        """Whether some voxel's factor differs from 1."""
        return bool((self._layers[1] != 1.0).any())

    @property
    def stiffness_text(self) -> str:
        """The factors as text: numbers separated by ',' in rows separated by '/'."""
        return "/".join(",".join(f"{value:.4g}" for value in row) for row in self._layers[1])

    def write_stiffness(self, text: str) -> None:
        """Replaces the factors by one number for all voxels, or by rows as `stiffness_text` has them.

        Raises:
            ValueError: They are no numbers in [0.5, 2], or not of the grid's shape.
        """
        try:
            rows = [[float(number) for number in row.split(",")] for row in text.strip().replace("\n", "/").split("/")]
        except ValueError:
            raise ValueError(f"stiffness: got {brief(text)}, expected a number, or rows such as 1,2/0.5,1") from None
        field = np.full(self.shape, rows[0][0]) if len(rows) == len(rows[0]) == 1 else rows
        self._set_field(check_field(field, self.occupancy))

    def _set_field(self, field: Field) -> None:
        with self.stroke():
            self._layers = [self._layers[0], np.where(self.occupancy, field, 1.0)]

    def paint_stiffness(self, row: int, col: int, value: float) -> None:
        """Sets the factor of a voxel; an empty cell stays as it is.

        Raises:
            ValueError: The cell is outside the grid, or the value outside [0.5, 2].
        """
        field = self.stiffness
        field[self._check_cell(row, col)] = check_factor(value)
        self._set_field(field)

    def fill_stiffness(self, row: int, col: int, value: float) -> None:
        """Sets the factor of all voxels of the piece at a cell.

        Raises:
            ValueError: As `paint_stiffness`.
        """
        cell, value = self._check_cell(row, col), check_factor(value)
        pieces = self.pieces()
        self._set_field(np.where((pieces == pieces[cell]) & (pieces > 0), value, self._layers[1]))

    def gradient(self, start: tuple[int, int], end: tuple[int, int], low: float, high: float) -> None:
        """Sets all factors to a ramp from one cell to another, even in ratio, and constant beyond both.

        Args:
            start: Row and column where the factor is `low`.
            end: Row and column where it is `high`; the same as `start` makes all factors `low`.
            low: A factor.
            high: A factor.

        Raises:
            ValueError: A cell is outside the grid, or a factor outside [0.5, 2].
        """
        first, last = np.array(self._check_cell(*start)), np.array(self._check_cell(*end))
        low, high = check_factor(low), check_factor(high)
        way = (last - first).astype(float)
        places = np.moveaxis(np.indices(self.shape), 0, -1) - first
        along = np.clip(places @ way / max(way @ way, 1.0), 0.0, 1.0)
        self._set_field(np.round(low * (high / low) ** along, 3))

    def replace(self, body: Body, stiffness: ArrayLike | None = None) -> None:
        """Draws a body in place of what is there, as one step of undo; ValueError as `of`."""
        layers = Drawing.of(body, stiffness)._layers
        with self.stroke():
            self._layers = layers

    def randomize(self, rng: np.random.Generator) -> None:
        """Draws a random valid body of the grid's shape, see `sample_body`."""
        self.replace(sample_body(self.shape, rng))

    def mutate(self, rng: np.random.Generator, rate: float = 0.1) -> bool:
        """Redraws some cells, see `mutate_body`; voxels that stay keep their stiffness. Returns whether it worked.

        Raises:
            ValueError: What is drawn is no valid body.
        """
        before = self.body()
        for _ in range(20):  # a mutation may redraw cells as they were
            body = mutate_body(before, rng, rate)
            if body is not None and body != before:
                with self.stroke():
                    self._layers = self._refit(body.grid.copy())
                return True
        return False

    def pieces(self) -> NDArray[np.int64]:
        """Returns for each cell the number of its piece, from 1 on, 0 where it is empty."""
        return label_pieces(self.occupancy)

    def body(self) -> Body:
        """Returns the body that is drawn.

        Raises:
            ValueError: It is not in one piece, or has no actuator.
        """
        return Body(self._layers[0])

    def problem(self) -> str | None:
        """Returns in words why this is no body, None where it is one."""
        if not self.occupancy.any():
            return "Nothing is drawn yet."
        parts = []
        if (count := self.pieces().max()) > 1:
            parts.append(f"It falls apart: {count} pieces, voxels must be joined side by side.")
        if not has_actuator(self._layers[0]):
            parts.append("It cannot move: it needs an actuator (H or V).")
        if not parts:
            self.body()
        return " ".join(parts) or None

    def summary(self) -> str:
        """Returns in words what is drawn: voxels, actuators, and stiffness where it varies."""
        body = self.body()
        words = f"{body.n_voxels} voxels, {body.n_actuators} actuators"
        field = self._layers[1][body.occupancy]
        if self.has_stiffness:
            low, high = field.min(), field.max()
            words += f", stiffness {low:g}" if low == high else f", stiffness {low:g} to {high:g}"
        return words

    def record(self) -> dict[str, Any]:
        """Returns the drawing as JSON has it; `from_record` reads it back."""
        return {"body": self.text, "stiffness": self.stiffness_text if self.has_stiffness else None}

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> "Drawing":
        """Returns what `record` wrote; ValueError where it is something else."""
        drawing = cls.blank(1, 1)
        drawing.write(str(record.get("body", "")))
        if record.get("stiffness") is not None:
            drawing.write_stiffness(str(record["stiffness"]))
        drawing._past.clear()
        return drawing


def check_factor(value: float) -> float:
    """Returns a stiffness factor; ValueError where it is outside [0.5, 2]."""
    if not STIFFNESS_LOW <= value <= STIFFNESS_HIGH:
        raise ValueError(f"stiffness: got {value}, allowed are {STIFFNESS_LOW} to {STIFFNESS_HIGH}")
    return float(value)
