"""A scene's tables, and how they lie in memory: a row of whole numbers and one of floats, with their ends in front.

Numbers in the tables: a moving point p is at place 2p of the state's pairs; corner q of a fixed voxel is called ~2q.
A moving surface voxel is c, a fixed one ~d. Each object's points are padded to fours, and its springs to eights.

A kernel that advances many worlds takes a few large arrays and finds each world's tables in their rows: unpacking
dozens of arrays from Python for each world would cost more than a small world's step.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from evogymcm.sim.kernels.vectors import on_lines

# Columns of `objects`: places of its points (with those that fill up), its moving points, its moving surface voxels.
FIRST_POINT, END_POINT, FIRST_CELL, END_CELL, N_OBJECT_COLUMNS = range(5)
_FLOATS = ("rest", "constants", "shares", "initial", "static")  # of all tables


class Layout(NamedTuple):
    """What never changes in a world, besides its `Terrain`: one-dimensional tables."""

    # Springs and points, see `springs.SpringTables`
    ends: np.ndarray
    groups: np.ndarray
    pulls: np.ndarray
    free: np.ndarray
    rigid: np.ndarray
    # Actions. Columns are cells of the padded grid.
    driven: np.ndarray  # rows (spring, column, column) of the springs that actuators drive, MISSING for no second one
    owned: np.ndarray  # rows (spring, column, column) of the robot's springs
    # Contact, see `contact.py`
    objects: np.ndarray  # rows of N_OBJECT_COLUMNS, robot first; points as places
    corners: np.ndarray  # rows of 4: places of TL, TR, BL, BR of the moving surface voxels
    sides: np.ndarray  # rows of 8: places of both ends of top, right, bottom, left; the outside is left of surface ones
    surface: np.ndarray  # masks of the sides that are surface
    cell_object: np.ndarray  # number of the object, of the fixed voxels too
    # Masks of the robot's voxels that are more than a cell apart in the grid: for each voxel, one for each eight of
    # those before it.
    apart: np.ndarray
    uses_start: np.ndarray  # where a moving point's rows in `uses` begin, and the end
    uses: np.ndarray  # rows (surface voxel, corner): those that have the point
    # Order of contacts, see `contact_order.Forest`; the fixed voxels follow the moving ones
    node_start: np.ndarray
    children: np.ndarray  # rows of 2
    node_place: np.ndarray
    node_voxel: np.ndarray
    leaf: np.ndarray
    # Readings
    points: np.ndarray  # places of the robot's points
    voxels: np.ndarray  # rows of 5: each voxel of the robot, its column and the places of its corners
    # Numbers
    rest: np.ndarray  # initial lengths of springs, NaN for those that only fill up
    constants: np.ndarray  # spring constants at stiffness 1
    shares: np.ndarray  # rows of 2, of `owned`: the part of the constant that each owner scales; none: both scale all
    initial: np.ndarray  # pairs: coordinates at reset


class Surface(NamedTuple):
    """What of a `Layout` contact needs: kernels are compiled, and called, the faster the fewer tables they take."""

    objects: np.ndarray
    corners: np.ndarray
    sides: np.ndarray
    surface: np.ndarray
    cell_object: np.ndarray
    apart: np.ndarray
    uses_start: np.ndarray
    uses: np.ndarray
    node_start: np.ndarray
    children: np.ndarray
    node_place: np.ndarray
    node_voxel: np.ndarray
    leaf: np.ndarray


class Terrain(NamedTuple):
    """The fixed surface voxels of a scenery, D of them, and what can be said of them beforehand."""

    static: np.ndarray  # pairs: coordinates of the fixed corners that no moving voxel has
    corners: np.ndarray  # rows of 4, as in `Layout`, as the next ones
    sides: np.ndarray
    surface: np.ndarray
    uses_start: np.ndarray  # of the fixed corners
    uses: np.ndarray
    cell_at: np.ndarray  # fixed surface voxel d at each world cell, MISSING for none, row by row from y = 0 up
    extent: np.ndarray  # height and width of `cell_at`
    points_start: np.ndarray  # where each object's points begin in `points`, and the end; none are the robot's
    points: np.ndarray  # places of all objects' points


def pack(tables: Layout | Terrain) -> tuple[np.ndarray, np.ndarray]:
    """Returns a row of int32 and a row of float64 that hold the tables, with where each begins and ends in front."""
    rows = []
    for is_float in (False, True):
        chosen = [value for name, value in zip(tables._fields, tables, strict=True) if (name in _FLOATS) == is_float]
        start, ends, sizes = on_lines(2 * len(chosen)), [], [value.size for value in chosen]
        starts = []
        for size in sizes:
            starts.append(start)
            ends.append(start + size)
            start = on_lines(start + size)
        row = np.zeros(start, np.float64 if is_float else np.int32)
        row[0 : 2 * len(chosen) : 2], row[1 : 2 * len(chosen) : 2] = starts, ends
        for first, end, value in zip(starts, ends, chosen, strict=True):
            row[first:end] = value
        rows.append(row)
    return rows[0], rows[1]


def _view(context: Any, builder: Any, kind: Any, array_type: Any, array: Any, start: Any, length: Any) -> Any:
    """Returns `length` numbers of a one-dimensional array from `start` on as an array."""
    source = context.make_array(array_type)(context, builder, array)
    out = context.make_array(kind)(context, builder)
    data = builder.gep(source.data, [start], inbounds=True)
    populate_array(out, data=data, shape=[length], strides=[source.itemsize], itemsize=source.itemsize, meminfo=None)
    return out._getvalue()


def _is_row(array: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


@intrinsic
def part(typingctx: Any, array: Any, start: Any, length: Any) -> Any:
    """Returns `array[start : start + length]`, also where kernels may not slice and return arrays."""
    if not _is_row(array):
        return None
    kind = types.Array(array.dtype, 1, "C")

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        numbers = [context.cast(builder, args[k], sig.args[k], types.intp) for k in (1, 2)]
        if config.BOUNDSCHECK:
            one, size = ir.Constant(ir.IntType(64), 1), context.make_array(sig.args[0])(context, builder, args[0]).shape
            places = builder.add(builder.extract_value(size, 0), one)  # the end may be one beyond the last number
            for end in (numbers[0], builder.add(*numbers)):
                cgutils.do_boundscheck(context, builder, end, places)
        return _view(context, builder, kind, sig.args[0], args[0], *numbers)

    return kind(array, start, length), codegen


@intrinsic
def in_two(typingctx: Any, array: Any, width: Any) -> Any:
    """Returns a one-dimensional array's numbers in rows of `width`."""
    if not _is_row(array):
        return None
    kind = types.Array(array.dtype, 2, "C")

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        source = context.make_array(sig.args[0])(context, builder, args[0])
        width = context.cast(builder, args[1], sig.args[1], types.intp)
        out = context.make_array(kind)(context, builder)
        size, length = source.itemsize, builder.extract_value(source.shape, 0)
        shape, strides = [builder.sdiv(length, width), width], [builder.mul(width, size), size]
        populate_array(out, data=source.data, shape=shape, strides=strides, itemsize=size, meminfo=None)
        return out._getvalue()

    return kind(array, width), codegen


def _unpacker(cls: Any) -> Any:
    """Returns the intrinsic that finds the tables of a `NamedTuple` class in the rows that `pack` made."""
    integers, floats = types.Array(types.int32, 1, "C"), types.Array(types.float64, 1, "C")
    kinds = [floats if name in _FLOATS else integers for name in cls._fields]
    result = types.NamedTuple(kinds, cls)

    def unpack(typingctx: Any, ints: Any, numbers: Any) -> Any:
        if not (_is_row(ints) and _is_row(numbers)):
            return None

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            found, done = [], [0, 0]
            for kind in kinds:
                row = int(kind is floats)
                header = context.make_array(sig.args[row])(context, builder, args[row]).data
                ends = []
                for k in (0, 1):
                    at = builder.gep(header, [ir.Constant(ir.IntType(64), 2 * done[row] + k)], inbounds=True)
                    ends.append(context.cast(builder, builder.load(at), kind.dtype, types.intp))
                done[row] += 1
                length = builder.sub(ends[1], ends[0])
                found.append(_view(context, builder, kind, sig.args[row], args[row], ends[0], length))
            return context.make_tuple(builder, result, found)

        return result(ints, numbers), codegen

    unpack.__doc__ = f"Returns the `{cls.__name__}` in two rows."
    return intrinsic(unpack)


def _numpy_unpacker(cls: Any) -> Any:
    def unpack(ints: np.ndarray, numbers: np.ndarray) -> Any:
        found, done = [], {False: 0, True: 0}
        for name in cls._fields:
            is_float = name in _FLOATS
            row = numbers if is_float else ints
            start, end = row[2 * done[is_float] : 2 * done[is_float] + 2].astype(int)
            done[is_float] += 1
            found.append(row[start:end])
        return cls(*found)

    return unpack


layout_of, terrain_of = _unpacker(Layout), _unpacker(Terrain)
if config.DISABLE_JIT:
    layout_of, terrain_of = _numpy_unpacker(Layout), _numpy_unpacker(Terrain)
    in_two = lambda array, width: array[: array.size // width * width].reshape(-1, width)  # noqa: E731
    part = lambda array, start, length: array[start : start + length]  # noqa: E731
