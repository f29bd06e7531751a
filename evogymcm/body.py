"""Voxel bodies: representation, text form, validation, sampling and mutation.

The rules are EvoGym's; randomness comes from a numpy Generator that the caller owns.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeGuard, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evogymcm._grid import (
    BODY_CHARS,
    EMPTY,
    FIXED,
    H_ACT,
    RIGID,
    SOFT,
    V_ACT,
    Connections,
    Grid,
    as_numbers,
    check_connections,
    check_grid,
    full_connections,
    grid_from_rows,
    grid_rows,
    has_actuator,
    is_connected,
)
from evogymcm._messages import brief, known
from evogymcm._settings import check_array

__all__ = [
    "EMPTY",
    "FIXED",
    "H_ACT",
    "RIGID",
    "SAMPLE_WEIGHTS",
    "SOFT",
    "STIFFNESS_HIGH",
    "STIFFNESS_LOW",
    "V_ACT",
    "Body",
    "as_body",
    "check_stiffness",
    "check_weights",
    "full_connections",
    "has_actuator",
    "is_connected",
    "mutate_body",
    "robot_tasks",
    "robots",
    "sample_body",
]

STIFFNESS_LOW, STIFFNESS_HIGH = 0.5, 2.0
FILE_SUFFIXES = (".npz", ".npy", ".txt", ".json")  # a text that ends with one of them is a path, not a body
_DIGITS = "01234"  # codes written as text
SAMPLE_WEIGHTS = (0.6, 0.2, 0.2, 0.2, 0.2)  # of empty, rigid, soft, horizontal and vertical actuator
_MAX_DRAWS = 100_000


class Body:
    """An immutable robot body: a grid of voxels and the joints between them.

    Two bodies are equal, and hash alike, when grid and connections agree; the order and repetition of
    connections play no part. Empty border rows and columns are kept, since they shift where the robot starts.

    Args:
        grid: Cell codes 0 (empty) to 4 (vertical actuator) of shape (rows, cols), first row on top, in anything that
            numpy reads; or the same as text, see `from_text`; or as a sequence of text rows.
        connections: Pairs of flat row-major cell indices of shape (2, k); each joins two side-adjacent voxels.
            By default all side-adjacent voxels are joined.

    Raises:
        ValueError: The grid is not 2-D or holds other codes, its voxels are not one piece under side adjacency,
            none is an actuator, or a connection does not join two side-adjacent voxels.
    """

    __slots__ = ("_connections", "_grid", "_has_default_connections")

    def __init__(self, grid: "str | Sequence[str] | ArrayLike", connections: ArrayLike | None = None) -> None:
        self._grid = _as_body_grid(grid)
        if not is_connected(self._grid):
            raise ValueError(f"body {brief(self.text)}: its voxels must form one piece, joined side by side")
        if not has_actuator(self._grid):
            raise ValueError(f"body {brief(self.text)}: needs at least one actuator (H or V)")
        full = full_connections(self._grid)
        self._connections = full if connections is None else check_connections(connections, self._grid)
        self._has_default_connections = np.array_equal(self._connections, full)
        self._grid.flags.writeable = False
        self._connections.flags.writeable = False

    @classmethod
    def from_text(cls, text: str) -> "Body":
        """Returns the body written as rows of `. R S H V`, or of the codes `0` to `4`, separated by '/' or newlines.

        The top row comes first.
        """
        return cls(text)

    @property
    def grid(self) -> Grid:
        """Cell codes, int8 of shape (rows, cols), read-only."""
        return self._grid

    @property
    def connections(self) -> Connections:
        """Joined pairs of flat cell indices, int64 of shape (2, k), sorted, read-only."""
        return self._connections

    @property
    def has_default_connections(self) -> bool:
        """Whether all side-adjacent voxels are joined."""
        return self._has_default_connections

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return self.rows, self.cols

    @property
    def rows(self) -> int:
        """Rows of the grid."""
        return self._grid.shape[0]

    @property
    def cols(self) -> int:
        """Columns of the grid."""
        return self._grid.shape[1]

    @property
    def text(self) -> str:
        """The grid as text, such as "HHH/H.H"; `from_text` reads it back."""
        return "/".join(grid_rows(self._grid))

    @property
    def occupancy(self) -> NDArray[np.bool_]:
        """Where there is a voxel, of shape (rows, cols)."""
        return self._grid != EMPTY

    @property
    def n_voxels(self) -> int:
        """Number of occupied cells."""
        return int(np.count_nonzero(self._grid))

    @property
    def actuators(self) -> NDArray[np.int64]:
        """Flat indices of the actuators, row-major: the order of the actions."""
        return np.flatnonzero((self._grid == H_ACT) | (self._grid == V_ACT)).astype(np.int64)

    @property
    def n_actuators(self) -> int:
        """Number of actuators."""
        return len(self.actuators)

    def _key(self) -> tuple[tuple[int, int], bytes, bytes]:
        return self.shape, self._grid.tobytes(), self._connections.tobytes()

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Body) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        connections = "" if self._has_default_connections else f", connections={self._connections.tolist()}"
        return f"Body({self.text!r}{connections})"

    def __reduce__(self) -> tuple[Any, ...]:
        return Body, (self._grid, self._connections)


def as_body(spec: "Body | str | os.PathLike[str] | Sequence[str] | ArrayLike") -> Body:
    """Returns a body from a Body, cell codes, text rows, the name of one of `robots`, or a file.

    A file is a path object, or a text that ends with one of these:

    - `.npz`: as EvoGym saves robots, `arr_0` the cell codes and `arr_1`, where there is one, the connections;
    - `.npy`: the cell codes;
    - `.txt`: rows of codes, with or without blanks or commas between them, or rows of `. R S H V`;
    - `.json`: a robot, or a world with one, saved by the EvoGym Design Tool.

    Raises:
        ValueError: A name is unknown, a file cannot be read, or the result would not be a valid body.
    """
    if isinstance(spec, Body):
        return spec
    if isinstance(spec, os.PathLike) or is_body_file(spec):
        from evogymcm._body_files import read_body  # it knows worlds, and worlds are needed by files only

        return read_body(Path(spec))
    if isinstance(spec, str) and not is_body_text(spec):
        if spec not in robots:
            raise ValueError(
                f"body {brief(spec)}: neither rows of {BODY_CHARS!r}, nor a file ({', '.join(FILE_SUFFIXES)}), nor one "
                f"of {known(spec, robots)}"
            )
        return robots[spec]
    return Body(spec)


def is_body_file(spec: object) -> "TypeGuard[str | os.PathLike[str]]":
    """Returns whether something is the path of a body's file: a path object, or a text with its suffix."""
    return isinstance(spec, os.PathLike) or (isinstance(spec, str) and spec.lower().endswith(FILE_SUFFIXES))


def is_body_text(text: str) -> bool:
    """Returns whether a text consists of cells, in one row or several, and so is neither a name nor a path."""
    cells = set("".join(text.split())) - {"/"}
    return cells <= set(BODY_CHARS) or cells <= set(_DIGITS)


def check_stiffness(stiffness: ArrayLike | None, body: Body) -> NDArray[np.float64]:
    """Returns a new stiffness field of the body's shape, with ones on its empty cells.

    Args:
        stiffness: Factors in [0.5, 2] of shape (rows, cols), first row on top. Values on empty cells are ignored.
            None means one everywhere.
        body: The body that it belongs to.

    Raises:
        ValueError: The shape is not the body's, or a voxel's factor is outside [0.5, 2] or not a number.
    """
    return check_field(stiffness, body.occupancy)


def check_field(stiffness: ArrayLike | None, occupancy: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Returns a new stiffness field for voxels that need not form a body, see `check_stiffness`."""
    if stiffness is None:
        return np.ones(occupancy.shape)
    try:
        field = as_numbers(stiffness)
    except (TypeError, ValueError) as error:
        raise ValueError(f"stiffness: expected equally long rows of numbers, got {brief(stiffness)}") from error
    if field.shape != occupancy.shape:
        raise ValueError(f"stiffness: got shape {field.shape}, expected the body's {occupancy.shape}")
    field[~occupancy] = 1.0
    if not np.all((field >= STIFFNESS_LOW) & (field <= STIFFNESS_HIGH)):
        raise ValueError(
            f"stiffness: got values from {field.min()} to {field.max()}, "
            f"allowed are {STIFFNESS_LOW} to {STIFFNESS_HIGH}"
        )
    return field


def _as_body_grid(grid: "str | Sequence[str] | ArrayLike") -> Grid:
    """Returns the cell codes of any form of grid that `Body` takes."""
    if isinstance(grid, str):
        grid = grid.strip().replace("\n", "/").split("/")
    elif hasattr(grid, "__array__"):
        grid = np.asarray(grid)
        grid = list(grid) if grid.dtype.kind in "OU" else grid  # rows of text, or arrays, as data frames hold them
    if isinstance(grid, list | tuple) and grid and all(isinstance(row, str) for row in grid):
        rows = [row.strip() for row in grid]
        if set("".join(rows)) <= set(_DIGITS):
            rows = [row.translate(str.maketrans(_DIGITS, BODY_CHARS)) for row in rows]
        return grid_from_rows(rows, BODY_CHARS)
    return check_grid(grid, len(BODY_CHARS))


def _as_rng(rng: np.random.Generator | int) -> np.random.Generator:
    """Returns the generator, or a new one of a seed."""
    if isinstance(rng, np.random.Generator):
        return rng
    if isinstance(rng, int | np.integer) and rng >= 0:
        return np.random.default_rng(int(rng))
    raise ValueError(f"rng: got {brief(rng)}, expected a numpy Generator or a seed (an integer of at least 0)")


def sample_body(
    shape: tuple[int, int], rng: np.random.Generator | int, weights: Sequence[float] = SAMPLE_WEIGHTS
) -> Body:
    """Returns a random valid body: all cells are drawn independently, repeatedly until valid (as in EvoGym).

    Args:
        shape: Rows and columns.
        rng: Random generator, or a seed for a new one.
        weights: Relative frequencies of the codes 0 to 4.


    Raises:
        ValueError: The weights are not five numbers >= 0 with one above 0 for an actuator, `rng` is neither a generator
            nor a seed, or no valid body was found in very many draws.
    """
    rng = _as_rng(rng)
    if len(shape) != 2 or min(shape) < 1:
        raise ValueError(f"shape: got {shape}, expected (rows, cols), both at least 1")
    thresholds = _thresholds(weights)
    for _ in range(_MAX_DRAWS):
        grid = _draw(thresholds, rng, shape)
        if _is_valid(grid):
            return Body(grid)
    raise ValueError(f"weights {tuple(weights)}: none of {_MAX_DRAWS} draws of shape {shape} was a valid body")


def mutate_body(
    body: "Body | str | os.PathLike[str] | Sequence[str] | ArrayLike",
    rng: np.random.Generator | int,
    rate: float = 0.1,
    attempts: int = 50,
    weights: Sequence[float] = SAMPLE_WEIGHTS,
) -> Body | None:
    """Returns a mutated body with full connections, or None if no attempt was valid (as in EvoGym).

    Each attempt redraws each cell with probability `rate`; it may get its old value again. Attempts
    accumulate, as in EvoGym: after an invalid one, the next mutates the invalid grid further.

    Args:
        body: The parent, in any form that `as_body` takes.
        rng: Random generator, or a seed for a new one.
        rate: Probability that a cell is redrawn in an attempt.
        attempts: Largest number of attempts.
        weights: Relative frequencies of the codes 0 to 4 among redrawn cells.

    Raises:
        ValueError: The rate is not a probability, `attempts` is below 1, the weights or `rng` are not as for
            `sample_body`, or the parent is not a valid body.
    """
    if not 0.0 <= rate <= 1.0 or attempts < 1:
        raise ValueError(f"got rate={rate}, attempts={attempts}; expected a rate from 0 to 1, at least 1 attempt")
    thresholds, rng = _thresholds(weights), _as_rng(rng)
    grid = as_body(body).grid
    for _ in range(attempts):
        is_redrawn = rng.random(grid.shape) < rate
        grid = np.where(is_redrawn, _draw(thresholds, rng, grid.shape), grid)
        if _is_valid(grid):
            return Body(grid)
    return None


def _is_valid(grid: Grid) -> bool:
    return has_actuator(grid) and is_connected(grid)


def check_weights(weights: Sequence[float]) -> tuple[float, ...]:
    """Returns the relative frequencies of the codes 0 to 4 in random cells.

    Raises:
        ValueError: They are not five numbers >= 0 with one above 0 for an actuator.
    """
    values = check_array("weights", weights)
    if values.shape != (5,) or not np.all(np.isfinite(values) & (values >= 0.0)):
        raise ValueError(f"weights: got {brief(weights)}, expected five finite numbers >= 0")
    if not values[[H_ACT, V_ACT]].any():
        raise ValueError(f"weights: got {brief(weights)}, expected one of the last two (the actuators) above 0")
    return tuple(values.tolist())


def _thresholds(weights: Sequence[float]) -> NDArray[np.float64]:
    """Returns the cumulated probabilities of the five body codes."""
    cumulated = np.cumsum(check_weights(weights))
    return cumulated / cumulated[-1]


def _draw(thresholds: NDArray[np.float64], rng: np.random.Generator, shape: tuple[int, int]) -> Grid:
    """Returns independent random codes: the first code whose threshold reaches a uniform number."""
    return np.searchsorted(thresholds, rng.random(shape)).astype(np.int8)


@cache
def _read_robots() -> dict[str, tuple[Body, str | None]]:
    """Returns body and task of each robot in robots.txt."""
    entries = {}
    text = (Path(__file__).parent / "robots.txt").read_text(encoding="utf-8")
    for block in text.split("\n\n")[1:]:  # the first one is the file's own description
        lines = block.split("\n")
        fields = dict(line.split(": ", 1) for line in lines if ": " in line)
        body = Body([line for line in lines if line and ": " not in line])
        entries[fields["name"]] = body, fields.get("task")
    return entries


Value = TypeVar("Value")


class _LazyMapping(Mapping[str, Value], Generic[Value]):
    """A read-only mapping whose content is loaded at first use."""

    def __init__(self, load: Callable[[], Mapping[str, Value]]) -> None:
        self._load = load

    def __getitem__(self, key: str) -> Value:
        return self._load()[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._load())

    def __len__(self) -> int:
        return len(self._load())


robots: Mapping[str, Body] = _LazyMapping(lambda: {name: body for name, (body, _) in _read_robots().items()})
robot_tasks: Mapping[str, str] = _LazyMapping(
    lambda: {name: task for name, (_, task) in _read_robots().items() if task}
)
