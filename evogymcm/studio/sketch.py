"""Grids of cells that are drawn: strokes, filling, mirroring, moving, undo and redo."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evogymcm._grid import CELL_CHARS, EMPTY, Grid, check_grid, grid_from_rows, grid_rows
from evogymcm._messages import brief, some

HISTORY = 50  # changes that can be taken back
Cells = tuple[slice, slice]


class Sketch:
    """A grid of cells that is drawn, and need not be anything valid yet.

    Every method that changes something is one step of undo, and so is everything within one `stroke`. What changes
    nothing is no step.

    Args:
        grid: Cell codes of shape (rows, cols), first row on top.

    Raises:
        ValueError: The grid holds other codes, or has more cells than 10 x 10 (30 x 100 for terrain).
    """

    _chars = CELL_CHARS  # of the codes that may be drawn, from 0 on
    _smallest, _largest = (1, 1), (10, 10)  # rows and columns

    def __init__(self, grid: ArrayLike) -> None:
        cells = check_grid(grid, len(self._chars))
        self._check_shape(cells.shape)
        self._check_codes(cells)
        self._layers: list[NDArray[Any]] = self._make_layers(cells)
        self._past: list[list[NDArray[Any]]] = []
        self._future: list[list[NDArray[Any]]] = []
        self._in_stroke = False

    def _make_layers(self, cells: Grid) -> list[NDArray[Any]]:
        """Returns what is drawn on the cells: arrays of the grid's shape, of which the first holds the codes."""
        return [cells]

    @classmethod
    def _check_shape(cls, shape: tuple[int, ...]) -> tuple[int, int]:
        (low_rows, low_cols), (rows, cols) = cls._smallest, cls._largest
        if not (low_rows <= shape[0] <= rows and low_cols <= shape[1] <= cols):
            raise ValueError(
                f"size: got {shape[0]} rows, {shape[1]} columns, allowed are {low_rows} to {rows} rows, "
                f"{low_cols} to {cols} columns"
            )
        return int(shape[0]), int(shape[1])

    @classmethod
    def _check_codes(cls, cells: Grid) -> None:
        """Raises a ValueError where some codes may not be drawn."""

    @property
    def grid(self) -> Grid:
        """Cell codes, int8 of shape (rows, cols), first row on top; a copy."""
        return self._layers[0].copy()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self._layers[0].shape
        return rows, cols

    @property
    def occupancy(self) -> NDArray[np.bool_]:
        """Where something is drawn, of shape (rows, cols)."""
        return self._layers[0] != EMPTY

    @property
    def text(self) -> str:
        """The grid as rows of characters, top row first, separated by '/'."""
        return "/".join(grid_rows(self._layers[0]))

    def write(self, text: str) -> None:
        """Replaces the cells by those of a text, rows of characters separated by '/' or newlines.

        Raises:
            ValueError: The rows differ in length, hold other characters, or are too many or too long.
        """
        rows = [row.strip() for row in text.strip().replace("/", "\n").split("\n")]
        cells = grid_from_rows(rows, self._chars)
        self._check_shape(cells.shape)
        self._check_codes(cells)
        with self.stroke():
            self._layers = self._refit(cells)

    def _refit(self, cells: Grid) -> list[NDArray[Any]]:
        """Returns layers for new cells, which keep what the old ones say of cells that stay occupied."""
        return self._make_layers(cells)

    @contextmanager
    def stroke(self) -> Iterator[None]:
        """Makes everything within one step of undo."""
        if self._in_stroke:  # it is part of the one outside
            yield
            return
        self.begin()
        try:
            yield
        finally:
            self.end()

    def begin(self) -> None:
        """Begins a stroke, which `end` ends; for strokes that last longer than a call."""
        self.end()
        self._before = [layer.copy() for layer in self._layers]
        self._in_stroke = True

    def end(self) -> None:
        """Ends a stroke, where there is one."""
        if not self._in_stroke:
            return
        self._in_stroke = False
        if not _same(self._before, self._layers):
            self._past = [*self._past, self._before][-HISTORY:]
            self._future = []

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to take back."""
        return bool(self._past) or (self._in_stroke and not _same(self._before, self._layers))

    @property
    def can_redo(self) -> bool:
        """Whether there is a change to bring back."""
        return bool(self._future)

    def undo(self) -> bool:
        """Takes the last change back, of up to 50; returns whether there was one."""
        self.end()
        return self._turn(self._past, self._future)

    def redo(self) -> bool:
        """Brings back what `undo` took; returns whether there was something."""
        self.end()
        return self._turn(self._future, self._past)

    def _turn(self, source: list[list[NDArray[Any]]], target: list[list[NDArray[Any]]]) -> bool:
        if not source:
            return False
        target.append(self._layers)
        self._layers = source.pop()
        return True

    def _check_cell(self, row: int, col: int) -> tuple[int, int]:
        """Returns the cell; ValueError where it is outside the grid."""
        rows, cols = self.shape
        if not (0 <= row < rows and 0 <= col < cols):
            raise ValueError(f"cell: got row {row}, column {col}, expected one of {rows} rows and {cols} columns")
        return int(row), int(col)

    def _check_code(self, code: int) -> int:
        """Returns the cell code; ValueError where it may not be drawn."""
        if not 0 <= code < len(self._chars):
            raise ValueError(f"cell code: got {code}, allowed are 0 to {len(self._chars) - 1}")
        return int(code)

    def paint(self, row: int, col: int, code: int) -> None:
        """Draws one cell; code 0 erases it.

        Raises:
            ValueError: The cell is outside the grid, or the code is none of the sketch's.
        """
        self._put(np.zeros(self.shape, bool), self._check_cell(row, col), self._check_code(code))

    def _put(self, cells: NDArray[np.bool_], cell: tuple[int, int], code: int) -> None:
        cells[cell] = True
        with self.stroke():
            grid = self.grid
            grid[cells] = code
            self._layers = self._refit(grid)

    def fill(self, row: int, col: int, code: int) -> None:
        """Draws the cell and all cells of its kind that it is joined with side by side.

        Raises:
            ValueError: As `paint`.
        """
        cell, code = self._check_cell(row, col), self._check_code(code)
        patches = label_pieces(self._layers[0] == self._layers[0][cell])
        self._put(patches == patches[cell], cell, code)

    def mirror(self, *, upside_down: bool = False) -> None:
        """Swaps left and right, or top and bottom."""
        with self.stroke():
            self._layers = [np.flip(layer, 0 if upside_down else 1).copy() for layer in self._layers]

    def shift(self, down: int, right: int) -> None:
        """Moves everything by so many cells, but no further than to the edge: nothing is lost."""
        rows, cols = np.nonzero(self.occupancy)
        if not len(rows):
            return
        down = int(np.clip(down, -rows.min(), self.shape[0] - 1 - rows.max()))
        right = int(np.clip(right, -cols.min(), self.shape[1] - 1 - cols.max()))
        with self.stroke():
            self._layers = [np.roll(layer, (down, right), (0, 1)) for layer in self._layers]

    def resize(self, rows: int, cols: int) -> None:
        """Adds or cuts rows on top and columns on the right; what is cut is lost, but for undo.

        Raises:
            ValueError: The size is not allowed.
        """
        rows, cols = self._check_shape((int(rows), int(cols)))
        before = self._layers
        kept = min(rows, self.shape[0]), min(cols, self.shape[1])
        with self.stroke():
            layers = self._make_layers(np.zeros((rows, cols), np.int8))
            for new, old in zip(layers, before, strict=True):
                new[rows - kept[0] :, : kept[1]] = old[old.shape[0] - kept[0] :, : kept[1]]
            self._layers = layers

    def clear(self) -> None:
        """Erases all cells."""
        with self.stroke():
            self._layers = self._make_layers(np.zeros(self.shape, np.int8))


def _same(one: Sequence[NDArray[Any]], other: Sequence[NDArray[Any]]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def label_pieces(occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Returns for each cell the number of its piece, from 1 on in reading order, 0 where nothing is occupied."""
    rows, cols = occupied.shape
    labels = np.zeros((rows, cols), np.int64)
    for start in zip(*np.nonzero(occupied), strict=True):
        if labels[start]:
            continue
        number, edge = labels.max() + 1, [start]
        labels[start] = number
        while edge:
            row, col = edge.pop()
            for near in ((row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)):
                inside = 0 <= near[0] < rows and 0 <= near[1] < cols
                if inside and occupied[near] and not labels[near]:
                    labels[near] = number
                    edge.append(near)
    return labels


def check_text(name: str, text: object, longest: int) -> str:
    """Returns a text of at most `longest` characters; ValueError where it is something else."""
    if not isinstance(text, str) or len(text) > longest:
        raise ValueError(f"{name}: got {brief(text)}, expected a text of at most {longest} characters")
    return text


def check_keys(what: str, record: object, allowed: Sequence[str]) -> dict[str, Any]:
    """Returns a record with no other keys; ValueError where it is something else."""
    if not isinstance(record, dict) or set(record) - set(allowed):
        given = some(map(str, record)) if isinstance(record, dict) else brief(record)
        raise ValueError(f"{what}: got {given}, expected an object with {', '.join(allowed)}")
    return record
