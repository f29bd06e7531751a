"""Eight lanes at once: a vector type for numba kernels.

A lane is one world; eight worlds with the same topology advance together. `Lanes` is a vector of eight float64 that
numba keeps in registers (one AVX-512, two AVX2 or four SSE2 registers), so that no kernel depends on what the
auto-vectoriser makes of a loop. The operators `+ - * /` and unary `-` work on lanes and on lanes with numbers, and the
functions below are all that kernels need besides. Everything rounds as written, once an operation: EvoGym is compiled
without fused multiplication and addition, and following it keeps 120 steps of contact within 1e-6 of it.

Every lane is computed alike whatever the others hold, so a world's result does not depend on its neighbours.
With `NUMBA_DISABLE_JIT=1` the same names run on numpy arrays of eight.
"""

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

N_LANES = 8
_BYTES = 8 * N_LANES  # of eight lanes; as many as a cache line has
_DOUBLES = ir.VectorType(ir.DoubleType(), N_LANES)
_BITS = ir.IntType(N_LANES)


class LanesType(types.Type):
    """Numba's type of eight float64 in a register."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


LANES = LanesType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _DOUBLES)


def _spread(builder: Any, value: Any) -> Any:
    """Returns a vector with the scalar `value` in each lane."""
    first = builder.insert_element(ir.Constant(_DOUBLES, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), N_LANES), [0] * N_LANES)
    return builder.shuffle_vector(first, ir.Constant(_DOUBLES, ir.Undefined), zeros)


def _as_lanes(context: Any, builder: Any, value: Any, kind: Any) -> Any:
    if isinstance(kind, LanesType):
        return value
    return _spread(builder, context.cast(builder, value, kind, types.float64))


def _binary(op: Any, emit: Any) -> None:
    """Gives `op` a meaning for lanes with lanes and lanes with numbers, in both orders."""

    @infer_global(op)
    class _Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            has_lanes = any(isinstance(a, LanesType) for a in args)
            if has_lanes and len(args) == 2 and all(isinstance(a, LanesType | types.Number) for a in args):
                return signature(LANES, *args)
            return None

    for left, right in ((LanesType, LanesType), (LanesType, types.Number), (types.Number, LanesType)):

        @lower_builtin(op, left, right)
        def _lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            values = [_as_lanes(context, builder, a, k) for a, k in zip(args, sig.args, strict=True)]
            return emit(builder, *values)


_binary(operator.add, lambda b, x, y: b.fadd(x, y))
_binary(operator.sub, lambda b, x, y: b.fsub(x, y))
_binary(operator.mul, lambda b, x, y: b.fmul(x, y))
_binary(operator.truediv, lambda b, x, y: b.fdiv(x, y))


@infer_global(operator.neg)
class _NegTyping(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(LANES, *args) if isinstance(args[0], LanesType) else None


@lower_builtin(operator.neg, LanesType)
def _lower_neg(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0])


def _pointer(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Returns the address of the eight numbers `table[row, i]`, for arguments that begin with table, row, i."""
    view = context.make_array(sig.args[0])(context, builder, args[0])
    row, i = (context.cast(builder, args[k], sig.args[k], types.intp) for k in (1, 2))
    if config.BOUNDSCHECK:
        for axis, place in ((0, row), (1, i)):
            cgutils.do_boundscheck(context, builder, place, builder.extract_value(view.shape, axis))
    width = ir.Constant(row.type, _BYTES)
    if sig.args[0].layout == "A":  # of `new_table`
        start = builder.add(builder.mul(i, builder.extract_value(view.strides, 1)), builder.mul(row, width))
    else:
        columns = builder.extract_value(view.shape, 1)
        start = builder.mul(builder.add(builder.mul(row, columns), i), width)
    data = builder.bitcast(view.data, ir.IntType(8).as_pointer())
    return builder.bitcast(builder.gep(data, [start], inbounds=True), _DOUBLES.as_pointer())


def _is_place(table: Any, row: Any, i: Any) -> bool:
    is_table = isinstance(table, types.Array) and table.ndim == 3 and table.dtype == types.float64
    return is_table and table.layout in "AC" and isinstance(row, types.Integer) and isinstance(i, types.Integer)


def aligned_zeros(*shape: int) -> np.ndarray:
    """Returns zeros (..., 8) of which no eight lie across two cache lines."""
    size = int(np.prod(shape))
    memory = np.zeros(size + N_LANES)
    start = -memory.ctypes.data % _BYTES // 8
    return memory[start : start + size].reshape(shape)


def new_table(rows: int, n: int) -> np.ndarray:
    """Returns zeros (rows, n, 8) whose memory is (n, rows, 8): what belongs to one point or spring stands together.

    Numbers of rows then become constant offsets. With the alignment it is worth a sixth of a step's speed (Zen 4).
    """
    return aligned_zeros(n, rows, N_LANES).transpose(1, 0, 2)


@intrinsic
def load(typingctx: Any, table: Any, row: Any, i: Any) -> Any:
    """Returns `table[row, i]` as lanes, of `new_table` or C-contiguous (rows, n, 8).

    Indices are checked where numba checks its own: with `NUMBA_BOUNDSCHECK=1`.
    """
    if not _is_place(table, row, i):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_pointer(context, builder, sig, args), align=8)

    return LANES(table, row, i), codegen


@intrinsic
def store(typingctx: Any, table: Any, row: Any, i: Any, value: Any) -> Any:
    """Writes lanes (or one number into all eight) to `table[row, i]`. Indices are checked as in `load`."""
    if not (_is_place(table, row, i) and isinstance(value, LanesType | types.Number)):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value = _as_lanes(context, builder, args[3], sig.args[3])
        builder.store(value, _pointer(context, builder, sig, args), align=8)
        return context.get_dummy_value()

    return types.void(table, row, i, value), codegen


def _pure(n_args: int, emit: Any, result: Any, doc: str) -> Any:
    """Returns an intrinsic of one or two lanes (numbers are spread) that `emit` turns into instructions."""

    def match(*args: Any) -> Any:
        return (result(*args), generate) if all(isinstance(a, LanesType | types.Number) for a in args) else None

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, *(_as_lanes(context, builder, a, k) for a, k in zip(args, sig.args, strict=True)))

    def of_one(typingctx: Any, a: Any) -> Any:
        return match(a)

    def of_two(typingctx: Any, a: Any, b: Any) -> Any:
        return match(a, b)

    typer: Any = of_one if n_args == 1 else of_two
    typer.__doc__ = doc
    return intrinsic(typer)


def _call(name: str, n_args: int) -> Any:
    def emit(builder: Any, *args: Any) -> Any:
        kind = ir.FunctionType(_DOUBLES, [_DOUBLES] * n_args)
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"{name}.v{N_LANES}f64"), args)

    return emit


def _mask(op: str) -> Any:
    def emit(builder: Any, a: Any, b: Any) -> Any:
        bits = builder.bitcast(builder.fcmp_ordered(op, a, b), _BITS)
        return builder.zext(bits, ir.IntType(64))

    return emit


def _emit_pick(op: str) -> Any:
    # Like the machine's own min and max: where a comparison with NaN fails, the second operand is taken.
    return lambda builder, a, b: builder.select(builder.fcmp_ordered(op, a, b), a, b)


spread = _pure(1, lambda b, x: x, LANES, "Returns lanes that all hold one number.")
sqrt = _pure(1, _call("llvm.sqrt", 1), LANES, "Returns the square roots.")
absolute = _pure(1, _call("llvm.fabs", 1), LANES, "Returns the absolute values.")
minimum = _pure(2, _emit_pick("<"), LANES, "Returns `a` where a < b, else `b`.")
maximum = _pure(2, _emit_pick(">"), LANES, "Returns `a` where a > b, else `b`.")
less = _pure(2, _mask("<"), types.int64, "Returns a bit mask of the lanes where a < b (never for NaN).")
less_equal = _pure(2, _mask("<="), types.int64, "Returns a bit mask of the lanes where a <= b (never for NaN).")


@intrinsic
def select(typingctx: Any, mask: Any, a: Any, b: Any) -> Any:
    """Returns `a` in the lanes whose bit of the integer `mask` is set, `b` in the others."""
    if not (isinstance(mask, types.Integer) and all(isinstance(v, LanesType | types.Number) for v in (a, b))):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.trunc(context.cast(builder, args[0], sig.args[0], types.int64), _BITS)
        flags = builder.bitcast(bits, ir.VectorType(ir.IntType(1), N_LANES))
        return builder.select(flags, *(_as_lanes(context, builder, args[k], sig.args[k]) for k in (1, 2)))

    return LANES(mask, a, b), codegen


def _numpy_load(table: np.ndarray, row: int, i: int) -> np.ndarray:
    return table[row, i].copy()


def _numpy_store(table: np.ndarray, row: int, i: int, value: Any) -> None:
    table[row, i] = value


def _numpy_bits(flags: Any) -> int:
    return int(np.packbits(np.broadcast_to(flags, N_LANES), bitorder="little")[0])


def _numpy_select(mask: int, a: Any, b: Any) -> np.ndarray:
    flags = np.unpackbits(np.array([mask], np.uint8), bitorder="little").astype(bool)
    return np.where(flags, a, b)


if config.DISABLE_JIT:
    load, store, select = _numpy_load, _numpy_store, _numpy_select
    sqrt, absolute = np.sqrt, np.abs

    def spread(x: float) -> np.ndarray:
        """Returns an array of eight of the number."""
        return np.full(N_LANES, float(x))

    def minimum(a: Any, b: Any) -> np.ndarray:
        """Returns `a` where a < b, else `b`."""
        return np.where(np.less(a, b), a, b)

    def maximum(a: Any, b: Any) -> np.ndarray:
        """Returns `a` where a > b, else `b`."""
        return np.where(np.greater(a, b), a, b)

    def less(a: Any, b: Any) -> int:
        """Returns a bit mask of the lanes where a < b."""
        return _numpy_bits(np.less(a, b))

    def less_equal(a: Any, b: Any) -> int:
        """Returns a bit mask of the lanes where a <= b."""
        return _numpy_bits(np.less_equal(a, b))
