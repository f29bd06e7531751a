"""Vectors in registers against numpy; the last test runs the others without the JIT, with checks and on a plain CPU."""

import operator
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core import config
from numba.core.errors import TypingError

from evogymcm.sim.kernels import vectors
from evogymcm.sim.kernels._jit import kernel
from evogymcm.sim.kernels.vectors import LANE_SLOTS, load, load_pair, store, store_pair

SPECIAL = np.array([np.nan, -np.inf, np.inf, -0.0, 0.0, 1e-310, 2.5, -3.0])
EDGES = np.array([0.0, 5e-324, 2.0**-1022, 1.5, 1 + 2.0**-52, 4 - 2.0**-51, 1.7976931348623157e308, np.inf, np.nan])
SLOTS = np.array(LANE_SLOTS)


@pytest.fixture(autouse=True)
def _no_warnings():
    with np.errstate(all="ignore"):
        yield


def cases():
    rng = np.random.default_rng(0)
    for _ in range(20):
        yield rng.normal(size=8), rng.normal(size=8)
    for turn in range(8):
        yield SPECIAL, np.roll(SPECIAL, turn)


def same(ours, expected):
    """Equal to the last bit, but for the kind of NaN."""
    np.testing.assert_array_equal(ours, expected)
    is_number = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(ours)[is_number], np.signbit(expected)[is_number])


def bits_of(flags):
    return int(np.packbits(flags, bitorder="little")[0])


@kernel
def _compute(a, b, number, whole, out):
    """Fills `out` with the result of every operation, eight numbers each."""
    x, y = load(a, 0), load(b, 0)
    store(out, 0, x + y)
    store(out, 8, x - y)
    store(out, 16, x * y)
    store(out, 24, x / y)
    store(out, 32, x + number)
    store(out, 40, x - number)
    store(out, 48, x * number)
    store(out, 56, x / number)
    store(out, 64, number + y)
    store(out, 72, number - y)
    store(out, 80, number * y)
    store(out, 88, number / y)
    store(out, 96, -x)
    store(out, 104, x * whole)  # integers become numbers
    store(out, 112, number)
    store(out, 120, vectors.spread(number))
    store(out, 128, vectors.sqrt(x))
    store(out, 136, vectors.absolute(x))
    store(out, 144, vectors.minimum(x, y))
    store(out, 152, vectors.maximum(x, y))
    store(out, 160, vectors.minimum(x, number))
    store(out, 168, vectors.maximum(number, y))
    store(out, 176, x * x + number)
    store(out, 184, vectors.alternating(number, whole))


_ARITHMETIC = (operator.add, operator.sub, operator.mul, operator.truediv)


def _expected(a, b, number, whole):
    return [
        *(op(p, q) for p, q in ((a, b), (a, number), (number, b)) for op in _ARITHMETIC),
        -a,
        a * whole,
        np.full(8, number),
        np.full(8, number),
        np.sqrt(a),
        np.abs(a),
        np.where(a < b, a, b),
        np.where(a > b, a, b),
        np.where(a < number, a, number),
        np.where(number > b, number, b),
        [float(p) * float(p) + number for p in a],  # rounds twice
        [number, whole] * 4,
    ]


@pytest.mark.parametrize("number", [0.3, -2.0, np.nan])
def test_operations_are_numpys(number):
    for a, b in cases():
        out = np.zeros(24 * 8)
        _compute(a, b, number, 3, out)
        same(out, np.concatenate(_expected(a, b, number, 3)))


@kernel
def _roots_and_quotients(a, b, roots, quotients):
    for i in range(0, len(a), 8):
        store(roots, i, vectors.sqrt(load(a, i)))
        store(quotients, i, load(b, i) / load(a, i))


def test_roots_and_quotients_are_the_processors_to_the_last_bit():
    """Also where a root lies next to the middle of two numbers, and of numbers of any size."""
    rng = np.random.default_rng(0)
    n = 1 << (10 if config.DISABLE_JIT else 20)
    mantissas, others = rng.uniform(1, 2, (2, n))
    squares = rng.uniform(1, 2, n).astype(np.float32).astype(float) ** 2
    near = np.concatenate([squares, np.nextafter(squares, 0), np.nextafter(squares, 4)])
    edges = np.concatenate([EDGES, -EDGES])
    a = np.concatenate([np.ldexp(mantissas, rng.integers(-1074, 1024, n)), near, np.repeat(edges, len(edges))])
    b = np.concatenate([np.ldexp(others, rng.integers(-1074, 1024, n)), np.resize(others, 3 * n), np.tile(edges, 18)])
    a, b = (np.append(values, np.ones(-len(values) % 8)) for values in (a, b))
    roots, quotients = np.zeros((2, len(a)))
    _roots_and_quotients(a, b, roots, quotients)
    same(roots, np.sqrt(a))
    same(quotients, b / a)


@kernel
def _compare(a, b, number, masks):
    x, y = load(a, 0), load(b, 0)
    masks[0] = vectors.less(x, y)
    masks[1] = vectors.less_equal(x, y)
    masks[2] = vectors.less(x, number)
    masks[3] = vectors.less_equal(number, y)


@pytest.mark.parametrize("number", [0.3, np.nan])
def test_masks_have_one_bit_a_lane_and_none_for_nan(number):
    for a, b in cases():
        masks = np.zeros(4, np.int64)
        _compare(a, b, number, masks)
        assert masks.tolist() == [bits_of(flags) for flags in (a < b, a <= b, a < number, number <= b)]


@kernel
def _choose(mask, a, b, number, out):
    x, y = load(a, 0), load(b, 0)
    store(out, 0, vectors.select(mask, x, y))
    store(out, 8, vectors.select(mask, x, number))
    store(out, 16, vectors.select(mask, number, y))


@pytest.mark.parametrize("mask", [0, 1, 0x80, 0xA5, 0xFF])
def test_select_takes_the_first_where_the_bit_is_set(mask):
    a, b = SPECIAL, np.arange(8.0)
    out = np.zeros(24)
    _choose(mask, a, b, 7.5, out)
    flags = np.array([mask >> lane & 1 for lane in range(8)], bool)
    same(out, np.concatenate([np.where(flags, *both) for both in ((a, b), (a, 7.5), (7.5, b))]))


@kernel
def _move(numbers, source, target, out):
    store(out, target, load(numbers, source))


@kernel
def _move_pair(numbers, source, target, out):
    store_pair(out, target, 2.0 * load_pair(numbers, source) - (vectors.no_pair() + load_pair(numbers, source) / 4))
    store_pair(out, target + 2, 0.5)


@kernel
def _gather(pairs, places, first, out):
    store(out, 1, vectors.gather(pairs, places, first))


@kernel
def _store_differences(pairs, ends, first, x_and_y, out):
    dx, dy = vectors.differences(pairs, ends, first)
    store(x_and_y, 0, dx)
    store(x_and_y, 8, dy)
    vectors.store_pairs(out, 1, dx, dy)


def test_loads_and_stores_meet_the_places_named_and_no_others():
    numbers = np.random.default_rng(0).normal(size=40)
    for kind in (int, np.int32):
        for source, target in ((0, 32), (32, 0), (5, 3)):
            out = np.zeros(40)
            _move(numbers, kind(source), kind(target), out)
            expected = np.zeros(40)
            expected[target : target + 8] = numbers[source : source + 8]
            same(out, expected)
            _move_pair(numbers, kind(source), kind(target), out)
            expected[target : target + 4] = *(1.75 * numbers[source : source + 2]), 0.5, 0.5
            np.testing.assert_allclose(out, expected, rtol=1e-15)


def test_pairs_come_from_any_places_and_go_back_in_the_order_of_the_slots():
    rng = np.random.default_rng(0)
    pairs = rng.normal(size=64)
    for first in range(4):
        places = rng.integers(0, 63, 16 + first + 2).astype(np.int32)
        out, x_and_y, stored = np.zeros(10), np.zeros(16), np.zeros(18)
        _gather(pairs, places, first, out)
        same(out, np.concatenate([[0], *(pairs[p : p + 2] for p in places[first : first + 4]), [0]]))
        _store_differences(pairs, places, first, x_and_y, stored)
        begins, ends = places[first : first + 8], places[first + 8 : first + 16]
        moved = np.stack([pairs[begins] - pairs[ends], pairs[begins + 1] - pairs[ends + 1]])
        same(x_and_y, moved[:, SLOTS].ravel())
        same(stored, np.concatenate([[0], moved.T.ravel(), [0]]))


def test_aligned_arrays_begin_on_a_cache_line():
    for shape in ((1,), (13,), (3, 8), (2, 5, 16)):
        array = vectors.aligned_zeros(*shape)
        assert array.shape == shape
        assert array.dtype == np.float64
        assert array.ctypes.data % 64 == 0
        assert array.flags.c_contiguous
        assert not array.any()
    assert [vectors.on_lines(n) for n in (0, 1, 8, 9)] == [0, 8, 8, 16]


@pytest.mark.skipif(config.DISABLE_JIT, reason="numpy takes any array")
@pytest.mark.parametrize("numbers", [np.zeros((4, 8)), np.zeros(32, np.float32), np.zeros(32)[::2]])
def test_only_contiguous_rows_of_float64_are_loaded(numbers):
    with pytest.raises(TypingError, match="load"):
        _move(numbers, 0, 0, np.zeros(32))


@pytest.mark.skipif(not config.BOUNDSCHECK, reason="places are checked under NUMBA_BOUNDSCHECK=1")
def test_places_outside_an_array_are_refused():
    numbers, places, inner = np.zeros(32), np.zeros(16, np.int32), np.zeros(16)
    for place in (-1, 25):
        with pytest.raises(IndexError):
            _move(numbers, place, 0, np.zeros(32))
        with pytest.raises(IndexError):
            _move(numbers, 0, place, np.zeros(32))
    for place in (-1, 31):
        with pytest.raises(IndexError):
            _move_pair(numbers, place, 0, np.zeros(32))
        with pytest.raises(IndexError):
            _move_pair(numbers, 0, place, np.zeros(32))
        with pytest.raises(IndexError):
            _gather(numbers, np.array([0, 0, 0, place], np.int32), 0, np.zeros(16))
        with pytest.raises(IndexError):
            _store_differences(numbers, np.array([0] * 15 + [place], np.int32), 0, inner, np.zeros(32))
    for first in (-1, 13):
        with pytest.raises(IndexError):
            _gather(numbers, places, first, np.zeros(16))
    with pytest.raises(IndexError):
        _store_differences(numbers, places, 1, inner, np.zeros(32))
    with pytest.raises(IndexError):
        _store_differences(numbers, places, 0, inner, np.zeros(16))


_INSIDE = "VECTORS_TESTED_WITHIN"


@pytest.mark.skipif(_INSIDE in os.environ or config.DISABLE_JIT, reason="runs in a process that this test has started")
@pytest.mark.parametrize(
    "settings",
    [
        pytest.param({"NUMBA_DISABLE_JIT": "1"}, id="no JIT"),
        pytest.param({"NUMBA_BOUNDSCHECK": "1"}, id="checked places", marks=pytest.mark.slow),
        pytest.param({"NUMBA_CPU_NAME": "generic"}, id="plain processor", marks=pytest.mark.slow),
    ],
)
def test_all_of_it_holds_under_other_settings_of_numba(settings, tmp_path):
    root = Path(__file__).resolve().parents[2]
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), _INSIDE: "1"} | settings
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(Path(__file__))]
    run = subprocess.run(command, cwd=root, env=env, timeout=600, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
