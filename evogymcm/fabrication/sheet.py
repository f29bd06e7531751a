"""A sheet for fabrication: which voxel is made of which material, how large and where, as a drawing and as a table."""

import csv
import io
from collections.abc import Iterable, Sequence
from functools import cached_property
from html import escape
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evogymcm._settings import check_count, check_number
from evogymcm.body import H_ACT, RIGID, SOFT, STIFFNESS_HIGH, STIFFNESS_LOW, V_ACT, Body, check_stiffness
from evogymcm.envs.render import palette
from evogymcm.fabrication.calibration import Calibration

TYPES = {RIGID: "rigid", SOFT: "soft", H_ACT: "horizontal", V_ACT: "vertical"}
MOST_CLASSES = 50  # so that names, with two decimals, differ
_COLUMNS = ("row", "column", "type", "stiffness", "material", "class_stiffness", "x_mm", "y_mm")
_INKSCAPE = "http://www.inkscape.org/namespaces/inkscape"
_LINE, _MARK = 0.01, 0.6  # of a voxel: width of lines, length of an actuator's stroke
_DARK = 110  # brightness below which labels are white


class Material(NamedTuple):
    """What voxels of one type and one class of stiffness are made of."""

    code: int
    stiffness: float

    @property
    def name(self) -> str:
        """Such as "soft-S1.41"."""
        return f"{TYPES[self.code]}-S{self.stiffness:.2f}"


class Sheet:
    """A design as it is to be made: its voxels, each of a material.

    Stiffness is put into classes, spread evenly in its logarithm from 0.5 to 2, each voxel into the nearest one: what
    is printed or cast comes in so many mixtures. An odd number has stiffness 1 among them.

    Args:
        body: The body.
        stiffness: (rows, cols) factors in [0.5, 2]; None for 1 everywhere.
        size: Edge of a voxel, mm.
        depth: How far voxels extend out of the plane, mm; by default as much as their edge.
        classes: Number of classes of stiffness.

    Attributes:
        stiffness: (rows, cols) the factors of the design.
        class_stiffness: (rows, cols) those of their classes.

    Raises:
        ValueError: The stiffness does not fit the body, or a number is out of range.
    """

    def __init__(
        self,
        body: Body,
        stiffness: ArrayLike | None = None,
        *,
        size: float = 10.0,
        depth: float | None = None,
        classes: int = 5,
    ) -> None:
        self.body, self.stiffness = body, check_stiffness(stiffness, body)
        self.size = check_number("size", size, above=0)
        self.depth = self.size if depth is None else check_number("depth", depth, above=0)
        self.classes = check_count("classes", classes, low=2)
        if self.classes > MOST_CLASSES:
            raise ValueError(f"classes: got {classes}, at most {MOST_CLASSES} can be told apart")
        steps = (self.classes - 1) / np.log(STIFFNESS_HIGH / STIFFNESS_LOW)
        places = np.rint(np.log(self.stiffness / STIFFNESS_LOW) * steps)
        self.class_stiffness: NDArray[np.float64] = STIFFNESS_LOW * np.exp(places / steps)

    def material(self, row: int, column: int) -> Material:
        """Returns what a voxel is made of."""
        return Material(int(self.body.grid[row, column]), round(float(self.class_stiffness[row, column]), 9))

    @cached_property
    def cells(self) -> dict[Material, list[tuple[int, int]]]:
        """The voxels of each material, by its type and stiffness, as (row, column), row by row."""
        cells: dict[Material, list[tuple[int, int]]] = {}
        for row, column in np.argwhere(self.body.occupancy).tolist():
            cells.setdefault(self.material(row, column), []).append((row, column))
        return dict(sorted(cells.items()))

    def corner(self, row: int, column: int) -> tuple[float, float]:
        """Returns x and y of a cell's lower left corner, mm from that of the grid."""
        return column * self.size, (self.body.rows - 1 - row) * self.size

    def table(self, calibration: Calibration | None = None) -> str:
        """Returns the voxels as CSV, one a line, with the calibration's columns for the class of each.

        Raises:
            ValueError: The calibration does not reach a type or stiffness of the design.
        """
        told = {} if calibration is None else {m: calibration.of(TYPES[m.code], m.stiffness) for m in self.cells}
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([*_COLUMNS, *(() if calibration is None else calibration.columns)])
        for row, column in np.argwhere(self.body.occupancy).tolist():
            material, own = self.material(row, column), self.stiffness[row, column]
            numbers = (own, material.stiffness, *self.corner(row, column), *told.get(material, ()))
            stiffness, class_stiffness, x, y, *rest = (f"{number:.6g}" for number in numbers)
            kind = TYPES[material.code]
            writer.writerow([row, column, kind, stiffness, material.name, class_stiffness, x, y, *rest])
        return text.getvalue()

    def drawing(self) -> str:
        """Returns the sheet as SVG in millimetres, at true scale.

        Layers, as Inkscape shows them: one for each material, then marks of the directions of actuators, cuts between
        neighbours that are not joined, and labels.
        """
        width, height = self.body.cols * self.size, self.body.rows * self.size
        parts = [self._layer(m.name, self._squares(cells), self._fill(m)) for m, cells in self.cells.items()]
        line = f'fill="none" stroke-width="{2 * _LINE * self.size:g}" stroke='
        parts.append(self._layer("marks", [self._path(self._marks())], line + '"black"'))
        parts.append(self._layer("cuts", [self._path(self._cuts())], line + '"red"'))
        font = f'font-family="sans-serif" font-size="{0.22 * self.size:g}" text-anchor="middle" fill="black"'
        parts.append(self._layer("labels", self._labels(), font))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="{_INKSCAPE}" width="{width:g}mm" '
            f'height="{height:g}mm" viewBox="0 0 {width:g} {height:g}">\n<title>{escape(self.body.text)}</title>\n'
            + "\n".join(parts)
            + "\n</svg>\n"
        )

    def _layer(self, name: str, shapes: Iterable[str], look: str) -> str:
        label = f'id="{name}" inkscape:groupmode="layer" inkscape:label="{name}"'
        return "\n".join([f"<g {label} {look}>", *(shape for shape in shapes if shape), "</g>"])

    def _colour(self, material: Material) -> palette.Color:
        return palette.type_color(material.code, stiffness=material.stiffness)

    def _fill(self, material: Material) -> str:
        red, green, blue = self._colour(material)
        return f'fill="#{red:02x}{green:02x}{blue:02x}" stroke="black" stroke-width="{_LINE * self.size:g}"'

    def _squares(self, cells: Sequence[tuple[int, int]]) -> list[str]:
        side = f'width="{self.size:g}" height="{self.size:g}"'
        return [f'<rect x="{column * self.size:g}" y="{row * self.size:g}" {side}/>' for row, column in cells]

    def _path(self, strokes: Iterable[tuple[float, float, float, float]]) -> str:
        """Returns strokes (x, y, and how far right and down), in voxels, as a path."""
        numbers = ([f"{number * self.size:g}" for number in stroke] for stroke in strokes)
        path = "".join(f"M{x} {y}l{right} {down}" for x, y, right, down in numbers)
        return f'<path d="{path}"/>' if path else ""

    def _marks(self) -> Iterable[tuple[float, float, float, float]]:
        margin = (1 - _MARK) / 2
        for row, column in np.argwhere(self.body.grid == H_ACT).tolist():
            yield column + margin, row + 0.75, _MARK, 0.0
        for row, column in np.argwhere(self.body.grid == V_ACT).tolist():
            yield column + 0.85, row + margin, 0.0, _MARK

    def _cuts(self) -> Iterable[tuple[float, float, float, float]]:
        joined, grid = {tuple(pair) for pair in self.body.connections.T.tolist()}, self.body.occupancy
        for row, column in np.argwhere(grid).tolist():
            cell, columns = row * self.body.cols + column, self.body.cols
            if column + 1 < columns and grid[row, column + 1] and (cell, cell + 1) not in joined:
                yield column + 1.0, float(row), 0.0, 1.0
            if row + 1 < self.body.rows and grid[row + 1, column] and (cell, cell + columns) not in joined:
                yield float(column), row + 1.0, 1.0, 0.0

    def _labels(self) -> Iterable[str]:
        for material, cells in self.cells.items():
            is_dark = np.dot(self._colour(material), (0.299, 0.587, 0.114)) < _DARK
            ink = ' fill="white"' if is_dark else ""
            for row, column in cells:
                x, y = (column + 0.5) * self.size, (row + 0.55) * self.size
                yield f'<text x="{x:g}" y="{y:g}"{ink}>{material.stiffness:.2f}</text>'
