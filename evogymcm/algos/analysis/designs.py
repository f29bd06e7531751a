"""What designs look like: the shape of bodies, their legs, and where they are stiff and soft.

The EvoGymCM paper reports that bodies which evolve with stiffness control become narrower, and that searched stiffness
fields of BridgeWalker-v0 have a soft centre on a stiff base.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from evogymcm.algos.analysis.statistics import bootstrap
from evogymcm.algos.codesign.design import Design
from evogymcm.body import Body

Array = NDArray[np.float64]
Region = Literal["centre", "base"]


@dataclass(frozen=True)
class Shape:
    """The shape of a body, in voxels.

    A leg begins with a foot: a maximal run of voxels side by side, each joined to the next, in the lowest row that has
    voxels, which is the row that touches flat ground as the robot starts. It goes on upwards, row by row, as long as
    the foot's voxels are joined to one run above that is no wider than the foot and is joined to no other run below,
    and so on from that run. So a body that stands on its whole underside has one leg, as wide as that.

    Attributes:
        voxels: number of voxels.
        width, height: columns and rows of the smallest rectangle around them.
        legs: number of legs.
        leg_width: mean width of the legs, where a leg's is the mean of its rows.
        leg_length: mean number of rows of the legs.
    """

    voxels: int
    width: int
    height: int
    legs: int
    leg_width: float
    leg_length: float


def measure_shape(body: Body) -> Shape:
    """Returns the shape of a body."""
    joints = set(map(tuple, body.connections.T.tolist()))
    runs = [_runs(body, row, joints) for row in range(body.rows)]
    lowest = max(row for row in range(body.rows) if runs[row])
    legs = [_leg_widths(foot, runs[lowest::-1], joints) for foot in runs[lowest]]
    rows, columns = np.nonzero(body.occupancy)
    return Shape(
        voxels=body.n_voxels,
        width=int(np.ptp(columns)) + 1,
        height=int(np.ptp(rows)) + 1,
        legs=len(legs),
        leg_width=float(np.mean([np.mean(widths) for widths in legs])),
        leg_length=float(np.mean([len(widths) for widths in legs])),
    )


def _runs(body: Body, row: int, joints: set[tuple[int, ...]]) -> list[list[int]]:
    """Returns the maximal runs of a row, each as the flat indices of its voxels."""
    runs: list[list[int]] = []
    for cell in (row * body.cols + np.flatnonzero(body.occupancy[row])).tolist():
        if runs and (cell - 1, cell) in joints:
            runs[-1].append(cell)
        else:
            runs.append([cell])
    return runs


def _leg_widths(foot: list[int], rows: list[list[list[int]]], joints: set[tuple[int, ...]]) -> list[int]:
    """Returns the widths of a leg, from its foot upwards, given the runs of each row from the foot's upwards."""

    def is_joined(upper: list[int], lower: list[int]) -> bool:
        return any((a, b) in joints for a in upper for b in lower)

    part, widths = foot, [len(foot)]
    for lower, upper in pairwise(rows):
        on_top = [run for run in upper if is_joined(run, part)]
        if len(on_top) != 1 or len(on_top[0]) > len(foot) or sum(is_joined(on_top[0], run) for run in lower) > 1:
            break
        part = on_top[0]
        widths.append(len(part))
    return widths


@dataclass(frozen=True, eq=False)
class StiffnessField:
    """A mean stiffness field, cell by cell of the array; arrays (rows, cols), first row on top.

    Attributes:
        count: number of designs that have a voxel in the cell.
        mean: geometric mean over those designs; NaN where they are too few.
        low, high: 95 % interval of that mean; NaN where they are too few, None where it was not asked for.
    """

    count: NDArray[np.int64]
    mean: Array
    low: Array | None
    high: Array | None


def mean_stiffness(designs: Sequence[Design], least: int = 3, *, with_intervals: bool = True) -> StiffnessField:
    """Returns the mean stiffness field of designs, each counting where it has a voxel.

    Stiffness is a factor, so that means are geometric.

    Args:
        designs: of one array shape. Bodies are compared cell by cell as they lie in it, neither shifted nor mirrored.
        least: how many designs must have a voxel in a cell; in cells with fewer there is no mean.
        with_intervals: whether to bootstrap intervals over the designs; then `least` must be 2 or more.

    Raises:
        ValueError: There is no design, they differ in shape, or `least` is too small.
    """
    shapes = {design.body.shape for design in designs}
    if len(shapes) != 1:
        raise ValueError(f"designs: got {len(designs)} of shapes {sorted(shapes)}, expected one or more of one shape")
    if least < 1 + with_intervals:
        raise ValueError(f"least: got {least}, expected at least {1 + with_intervals}")
    is_there = np.stack([design.body.occupancy for design in designs])
    logs = np.log([design.field for design in designs])
    mean, low, high = np.full((3, *logs.shape[1:]), np.nan)
    for row, column in np.argwhere(is_there.sum(0) >= least):
        values = logs[is_there[:, row, column], row, column]
        mean[row, column] = np.exp(values.mean())
        if with_intervals:
            low[row, column], high[row, column] = np.exp(bootstrap(values))
    return StiffnessField(is_there.sum(0), mean, *((low, high) if with_intervals else (None, None)))


def stiffness_contrast(design: Design, region: Region) -> float | None:
    """Returns the logarithm of how many times as stiff as all other voxels those of a region are; None without either.

    It is the mean logarithm of stiffness over the region's voxels minus that over the others, so below 0 where the
    region is soft. Regions lie in the smallest rectangle around the body: "centre" is its middle cell, the two in the
    middle where its width or height is even, the four where both are; "base" is its lowest row.

    Raises:
        ValueError: There is no such region.
    """
    if region not in get_args(Region):
        raise ValueError(f"region: got {region!r}, allowed are {', '.join(get_args(Region))}")
    is_there = design.body.occupancy
    rows, columns = np.nonzero(is_there)
    row, column = np.indices(is_there.shape)
    if region == "base":
        is_inside = row == rows.max()
    else:
        ends = (row, rows.min() + rows.max()), (column, columns.min() + columns.max())
        is_inside = np.logical_and(*(abs(2 * place - both) <= 1 for place, both in ends))
    within, rest = (np.log(design.field[is_there & part]) for part in (is_inside, ~is_inside))
    return float(within.mean() - rest.mean()) if len(within) and len(rest) else None
