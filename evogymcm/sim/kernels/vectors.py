"""Vectors for numba kernels: eight numbers in registers, and pairs of numbers.

`Eight` is a vector of eight float64 that numba keeps in registers (one AVX-512, two AVX2 or four SSE2 registers), so
that no kernel depends on what the auto-vectoriser makes of a loop; `Pair` holds the x and y of one point. Points are
stored as pairs, x0 y0 x1 y1 ..., so that what x and y have in common needs no shuffling, and one load brings both.

The operators `+ - * /` and unary `-` work on vectors and on vectors with numbers, and the functions below are all that
kernels need besides. Everything rounds as written, once an operation: EvoGym is compiled without fused multiplication
and addition. Places are indices of numbers in one-dimensional arrays; under NUMBA_BOUNDSCHECK=1 they are checked.
With `NUMBA_DISABLE_JIT=1` the same names run on numpy arrays of eight and of two.
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
_BYTES = 8 * N_LANES  # as many as a cache line has
_I32, _I64 = ir.IntType(32), ir.IntType(64)
_BITS = ir.IntType(N_LANES)
# Which of the eight pairs in memory comes in which lane: what one machine instruction makes of two registers of four.
LANE_SLOTS = (0, 4, 1, 5, 2, 6, 3, 7)
_EVEN, _ODD = [0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15]


class VectorType(types.Type):
    """Numba's type of `n` float64 in registers."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.kind = ir.VectorType(ir.DoubleType(), n)
        super().__init__(name=f"Vector({n})")


EIGHT, PAIR = VectorType(N_LANES), VectorType(2)


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, fe_type.kind)


def _shuffle(builder: Any, one: Any, two: Any, order: list[int]) -> Any:
    return builder.shuffle_vector(one, two, ir.Constant(ir.VectorType(_I32, len(order)), order))


def _spread(builder: Any, value: Any, n: int) -> Any:
    """Returns a vector of `n` times the scalar `value`."""
    empty = ir.Constant(ir.VectorType(ir.DoubleType(), n), ir.Undefined)
    return _shuffle(builder, builder.insert_element(empty, value, ir.Constant(_I32, 0)), empty, [0] * n)


def _as_vector(context: Any, builder: Any, value: Any, kind: Any, n: int) -> Any:
    if isinstance(kind, VectorType):
        return value
    return _spread(builder, context.cast(builder, value, kind, types.float64), n)


def _common(args: Any) -> VectorType | None:
    """Returns the vector type of arguments that are vectors of one size or numbers, None for others."""
    found = {a for a in args if isinstance(a, VectorType)}
    is_fine = all(isinstance(a, VectorType | types.Number) for a in args)
    return found.pop() if len(found) == 1 and is_fine else None


def _binary(op: Any, emit: Any) -> None:
    """Gives `op` a meaning for vectors with vectors and vectors with numbers, in both orders."""

    @infer_global(op)
    class _Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            common = _common(args) if len(args) == 2 else None
            return None if common is None else signature(common, *args)

    for left, right in ((VectorType, VectorType), (VectorType, types.Number), (types.Number, VectorType)):

        @lower_builtin(op, left, right)
        def _lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            n = sig.return_type.n
            return emit(builder, *(_as_vector(context, builder, a, k, n) for a, k in zip(args, sig.args, strict=True)))


_binary(operator.add, lambda b, x, y: b.fadd(x, y))
_binary(operator.sub, lambda b, x, y: b.fsub(x, y))
_binary(operator.mul, lambda b, x, y: b.fmul(x, y))
_binary(operator.truediv, lambda b, x, y: b.fdiv(x, y))


@infer_global(operator.neg)
class _NegTyping(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(args[0], *args) if isinstance(args[0], VectorType) else None


@lower_builtin(operator.neg, VectorType)
def _lower_neg(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0])


def on_lines(n: int) -> int:
    """Returns `n` rounded up to whole cache lines of eight numbers."""
    return -N_LANES * (-n // N_LANES)


def aligned_zeros(*shape: int) -> np.ndarray:
    """Returns float64 zeros that begin on a cache line: eight numbers across two of them cost half a kernel's speed."""
    size = int(np.prod(shape))
    memory = np.zeros(size + N_LANES)
    start = -memory.ctypes.data % _BYTES // 8
    return memory[start : start + size].reshape(shape)


def _is_array(array: Any, dtype: Any = types.float64) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.dtype == dtype and array.layout == "C"


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, place: Any, n: int) -> Any:
    """Returns the address of the `n` numbers of a one-dimensional array from `place` on."""
    view = context.make_array(array_type)(context, builder, array)
    if config.BOUNDSCHECK:
        length = builder.extract_value(view.shape, 0)
        last = builder.add(place, ir.Constant(_I64, n - 1))
        for end in (place, last):
            cgutils.do_boundscheck(context, builder, end, length)
    return builder.gep(view.data, [place], inbounds=True)


def _place(context: Any, builder: Any, value: Any, kind: Any) -> Any:
    return context.cast(builder, value, kind, types.intp)


def _load(context: Any, builder: Any, array_type: Any, array: Any, place: Any, n: int) -> Any:
    at = _pointer(context, builder, array_type, array, place, n)
    return builder.load(builder.bitcast(at, ir.VectorType(ir.DoubleType(), n).as_pointer()), align=8)


def _store(context: Any, builder: Any, array_type: Any, array: Any, place: Any, value: Any, n: int) -> None:
    at = _pointer(context, builder, array_type, array, place, n)
    builder.store(value, builder.bitcast(at, ir.VectorType(ir.DoubleType(), n).as_pointer()), align=8)


def _loader(vector: VectorType, doc: str) -> Any:
    def load(typingctx: Any, array: Any, place: Any) -> Any:
        if not (_is_array(array) and isinstance(place, types.Integer)):
            return None

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            place = _place(context, builder, args[1], sig.args[1])
            return _load(context, builder, sig.args[0], args[0], place, vector.n)

        return vector(array, place), codegen

    load.__doc__ = doc
    return intrinsic(load)


def _storer(vector: VectorType, doc: str) -> Any:
    def store(typingctx: Any, array: Any, place: Any, value: Any) -> Any:
        is_value = value == vector or isinstance(value, types.Number)
        if not (_is_array(array) and isinstance(place, types.Integer) and is_value):
            return None

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            value = _as_vector(context, builder, args[2], sig.args[2], vector.n)
            place = _place(context, builder, args[1], sig.args[1])
            _store(context, builder, sig.args[0], args[0], place, value, vector.n)
            return context.get_dummy_value()

        return types.void(array, place, value), codegen

    store.__doc__ = doc
    return intrinsic(store)


load = _loader(EIGHT, "Returns the eight numbers of `array` from `place` on.")
store = _storer(EIGHT, "Writes eight numbers (or one number eight times) to `array` from `place` on.")
load_pair = _loader(PAIR, "Returns the two numbers of `array` from `place` on.")
store_pair = _storer(PAIR, "Writes two numbers (or one number twice) to `array` from `place` on.")


def _four_pairs(context: Any, builder: Any, kinds: Any, args: Any, start: Any) -> Any:
    """Loads the four pairs of the array `args[0]` whose places stand in `args[1]` from `start` on into one vector."""
    two = []
    for k in (0, 2):
        at = _pointer(context, builder, kinds[1], args[1], builder.add(start, ir.Constant(_I64, k)), 2)
        both = builder.load(builder.bitcast(at, _I64.as_pointer()), align=4)  # fewer loads than one for each place
        low = builder.zext(builder.trunc(both, _I32), _I64)
        high = builder.lshr(both, ir.Constant(_I64, 32))
        one, other = (_load(context, builder, kinds[0], args[0], place, 2) for place in (low, high))
        two.append(_shuffle(builder, one, other, [0, 1, 2, 3]))
    return _shuffle(builder, two[0], two[1], list(range(8)))


def _takes_places(pairs: Any, places: Any, first: Any) -> bool:
    return _is_array(pairs) and _is_array(places, types.int32) and isinstance(first, types.Integer)


@intrinsic
def gather(typingctx: Any, pairs: Any, places: Any, first: Any) -> Any:
    """Returns the four pairs whose places stand in `places` from `first` on."""
    if not _takes_places(pairs, places, first):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        start = _place(context, builder, args[2], sig.args[2])
        return _four_pairs(context, builder, sig.args, args, start)

    return EIGHT(pairs, places, first), codegen


@intrinsic
def differences(typingctx: Any, pairs: Any, ends: Any, first: Any) -> Any:
    """Returns x and y (two Eights) of eight pairs minus eight others.

    The places of the pairs stand in `ends` from `first` on: those of the first ones, then those of the others, each in
    the order LANE_SLOTS of the lanes.
    """
    if not _takes_places(pairs, ends, first):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        start = _place(context, builder, args[2], sig.args[2])
        starts = (builder.add(start, ir.Constant(_I64, k)) for k in (0, 4, 8, 12))
        a0, a1, b0, b1 = (_four_pairs(context, builder, sig.args, args, first) for first in starts)
        low, high = builder.fsub(a0, b0), builder.fsub(a1, b1)
        result = [_shuffle(builder, low, high, order) for order in (_EVEN, _ODD)]
        return context.make_tuple(builder, sig.return_type, result)

    return types.UniTuple(EIGHT, 2)(pairs, ends, first), codegen


@intrinsic
def store_pairs(typingctx: Any, array: Any, place: Any, x: Any, y: Any) -> Any:
    """Writes eight pairs to `array` from `place` on, in the order that LANE_SLOTS says."""
    if not (_is_array(array) and isinstance(place, types.Integer) and x == EIGHT and y == EIGHT):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _place(context, builder, args[1], sig.args[1])
        for k, order in enumerate((_EVEN, _ODD)):
            at = builder.add(place, ir.Constant(_I64, k * N_LANES))
            _store(context, builder, sig.args[0], args[0], at, _shuffle(builder, args[2], args[3], order), N_LANES)
        return context.get_dummy_value()

    return types.void(array, place, x, y), codegen


@intrinsic
def alternating(typingctx: Any, x: Any, y: Any) -> Any:
    """Returns the Eight x y x y x y x y of two numbers."""
    if not all(isinstance(value, types.Number) for value in (x, y)):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        numbers = (context.cast(builder, a, k, types.float64) for a, k in zip(args, sig.args, strict=True))
        one, other = (_spread(builder, value, N_LANES) for value in numbers)
        return _shuffle(builder, one, other, [0, 8] * 4)

    return EIGHT(x, y), codegen


def _pure(n_args: int, emit: Any, result: Any, doc: str) -> Any:
    """Returns an intrinsic of one or two Eights (numbers are spread) that `emit` turns into instructions."""

    def match(*args: Any) -> Any:
        is_fine = all(a == EIGHT or isinstance(a, types.Number) for a in args)
        return (result(*args), generate) if is_fine else None

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, *(_as_vector(context, builder, a, k, 8) for a, k in zip(args, sig.args, strict=True)))

    def of_one(typingctx: Any, a: Any) -> Any:
        return match(a)

    def of_two(typingctx: Any, a: Any, b: Any) -> Any:
        return match(a, b)

    typer: Any = of_one if n_args == 1 else of_two
    typer.__doc__ = doc
    return intrinsic(typer)


def _call(name: str, n_args: int) -> Any:
    def emit(builder: Any, *args: Any) -> Any:
        kind = ir.FunctionType(EIGHT.kind, [EIGHT.kind] * n_args)
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"{name}.v{N_LANES}f64"), args)

    return emit


def _mask(op: str) -> Any:
    def emit(builder: Any, a: Any, b: Any) -> Any:
        return builder.zext(builder.bitcast(builder.fcmp_ordered(op, a, b), _BITS), _I64)

    return emit


def _emit_pick(op: str) -> Any:
    # Like the machine's own min and max: where a comparison with NaN fails, the second operand is taken.
    return lambda builder, a, b: builder.select(builder.fcmp_ordered(op, a, b), a, b)


spread = _pure(1, lambda b, x: x, EIGHT, "Returns an Eight of one number.")
sqrt = _pure(1, _call("llvm.sqrt", 1), EIGHT, "Returns the square roots.")
absolute = _pure(1, _call("llvm.fabs", 1), EIGHT, "Returns the absolute values.")
minimum = _pure(2, _emit_pick("<"), EIGHT, "Returns `a` where a < b, else `b`.")
maximum = _pure(2, _emit_pick(">"), EIGHT, "Returns `a` where a > b, else `b`.")
less = _pure(2, _mask("<"), types.int64, "Returns a bit mask of the lanes where a < b (never for NaN).")
less_equal = _pure(2, _mask("<="), types.int64, "Returns a bit mask of the lanes where a <= b (never for NaN).")


@intrinsic
def no_pair(typingctx: Any) -> Any:
    """Returns a Pair of zeros."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return ir.Constant(PAIR.kind, [0.0, 0.0])

    return PAIR(), codegen


@intrinsic
def select(typingctx: Any, mask: Any, a: Any, b: Any) -> Any:
    """Returns `a` in the lanes whose bit of the integer `mask` is set, `b` in the others."""
    if not (isinstance(mask, types.Integer) and all(v == EIGHT or isinstance(v, types.Number) for v in (a, b))):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.trunc(context.cast(builder, args[0], sig.args[0], types.int64), _BITS)
        flags = builder.bitcast(bits, ir.VectorType(ir.IntType(1), N_LANES))
        return builder.select(flags, *(_as_vector(context, builder, args[k], sig.args[k], 8) for k in (1, 2)))

    return EIGHT(mask, a, b), codegen


def _bits(flags: Any) -> int:
    return int(np.packbits(np.broadcast_to(flags, N_LANES), bitorder="little")[0])


def _numpy_differences(pairs: np.ndarray, ends: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    slots = first + np.array(LANE_SLOTS)
    a, b = ends[slots], ends[slots + N_LANES]
    return pairs[a] - pairs[b], pairs[a + 1] - pairs[b + 1]


def _numpy_gather(pairs: np.ndarray, places: np.ndarray, first: int) -> np.ndarray:
    chosen = places[first : first + 4]
    return np.stack([pairs[chosen], pairs[chosen + 1]], axis=1).ravel()


def _numpy_store_pairs(array: np.ndarray, place: int, x: np.ndarray, y: np.ndarray) -> None:
    slots = place + 2 * np.array(LANE_SLOTS)
    array[slots], array[slots + 1] = x, y


def _numpy_select(mask: int, a: Any, b: Any) -> np.ndarray:
    return np.where(np.unpackbits(np.array([mask], np.uint8), bitorder="little").astype(bool), a, b)


def _numpy_store(n: int) -> Any:
    def store(array: np.ndarray, place: int, value: Any) -> None:
        array[place : place + n] = value

    return store


if config.DISABLE_JIT:
    load, store = lambda array, place: array[place : place + N_LANES].copy(), _numpy_store(N_LANES)
    load_pair, store_pair = lambda array, place: array[place : place + 2].copy(), _numpy_store(2)
    differences, gather = _numpy_differences, _numpy_gather
    store_pairs, select = _numpy_store_pairs, _numpy_select
    sqrt, absolute = np.sqrt, np.abs
    spread, no_pair = lambda x: np.full(N_LANES, float(x)), lambda: np.zeros(2)
    alternating = lambda x, y: np.tile([float(x), float(y)], N_LANES // 2)  # noqa: E731
    minimum, maximum = lambda a, b: np.where(np.less(a, b), a, b), lambda a, b: np.where(np.greater(a, b), a, b)
    less, less_equal = lambda a, b: _bits(np.less(a, b)), lambda a, b: _bits(np.less_equal(a, b))
