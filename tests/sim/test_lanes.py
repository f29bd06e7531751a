"""Operations on eight lanes against numpy."""

import operator
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evogymcm.sim import lanes
from evogymcm.sim._jit import kernel

SPECIAL = np.array([np.nan, -np.inf, np.inf, -0.0, 0.0, 1e-310, 2.5, -3.0])


@kernel
def _compute(a, b, number, whole, out):
    """Fills `out` with the result of every operation, one a row; a, b: (1, 1, 8), out: (1, n, 8)."""
    x, y = lanes.load(a, 0, 0), lanes.load(b, 0, 0)
    lanes.store(out, 0, 0, x + y)
    lanes.store(out, 0, 1, x - y)
    lanes.store(out, 0, 2, x * y)
    lanes.store(out, 0, 3, x / y)
    lanes.store(out, 0, 4, x + number)
    lanes.store(out, 0, 5, x - number)
    lanes.store(out, 0, 6, x * number)
    lanes.store(out, 0, 7, x / number)
    lanes.store(out, 0, 8, number + y)
    lanes.store(out, 0, 9, number - y)
    lanes.store(out, 0, 10, number * y)
    lanes.store(out, 0, 11, number / y)
    lanes.store(out, 0, 12, -x)
    lanes.store(out, 0, 13, x * whole)  # integers become numbers
    lanes.store(out, 0, 14, number)
    lanes.store(out, 0, 15, lanes.spread(number))
    lanes.store(out, 0, 16, lanes.sqrt(lanes.absolute(y)))
    lanes.store(out, 0, 17, lanes.absolute(x))
    lanes.store(out, 0, 18, lanes.minimum(x, y))
    lanes.store(out, 0, 19, lanes.maximum(x, y))
    lanes.store(out, 0, 20, lanes.minimum(x, number))
    lanes.store(out, 0, 21, lanes.maximum(number, y))
    lanes.store(out, 0, 22, x * y + number)  # rounds twice


def _expected(a, b, number, whole):
    both = [op(p, q) for p, q in ((a, b), (a, number), (number, b)) for op in _ARITHMETIC]
    return np.array(
        [
            *both,
            -a,
            a * whole,
            np.full(8, number),
            np.full(8, number),
            np.sqrt(np.abs(b)),
            np.abs(a),
            np.where(a < b, a, b),
            np.where(a > b, a, b),
            np.where(a < number, a, number),
            np.where(number > b, number, b),
            np.array([float(p) * float(q) + number for p, q in zip(a, b, strict=True)]),
        ]
    )


_ARITHMETIC = (operator.add, operator.sub, operator.mul, operator.truediv)


@kernel
def _compare(a, b, number, masks):
    x, y = lanes.load(a, 0, 0), lanes.load(b, 0, 0)
    masks[0] = lanes.less(x, y)
    masks[1] = lanes.less_equal(x, y)
    masks[2] = lanes.less(x, number)
    masks[3] = lanes.less_equal(number, y)


@kernel
def _choose(mask, a, b, number, out):
    x, y = lanes.load(a, 0, 0), lanes.load(b, 0, 0)
    lanes.store(out, 0, 0, lanes.select(mask, x, y))
    lanes.store(out, 0, 1, lanes.select(mask, x, number))
    lanes.store(out, 0, 2, lanes.select(mask, number, y))


@kernel
def _shift(table, out):
    """Moves every entry of a table to the next row and place."""
    for row in range(table.shape[0] - 1):
        for i in range(table.shape[1] - 1):
            lanes.store(out, row + 1, i + 1, lanes.load(table, row, i))


def pairs():
    rng = np.random.default_rng(0)
    for _ in range(20):
        yield rng.normal(size=8), rng.normal(size=8)
    for turn in range(8):
        yield SPECIAL, np.roll(SPECIAL, turn)


def bits_of(flags):
    return int(np.packbits(flags, bitorder="little")[0])


@pytest.mark.parametrize("number", [0.3, -2.0, np.nan])
def test_arithmetic(number):
    for a, b in pairs():
        out = np.zeros((1, 23, 8))
        _compute(a[None, None], b[None, None], number, 3, out)
        with np.errstate(all="ignore"):
            expected = _expected(a, b, number, 3)
        np.testing.assert_array_equal(out[0], expected)
        number_rows = ~np.isnan(expected)
        np.testing.assert_array_equal(np.signbit(out[0])[number_rows], np.signbit(expected)[number_rows])


@pytest.mark.parametrize("number", [0.3, np.nan])
def test_masks(number):
    """One bit a lane, the first lane lowest; a comparison with NaN is never true."""
    for a, b in pairs():
        masks = np.zeros(4, np.int64)
        _compare(a[None, None], b[None, None], number, masks)
        assert masks.tolist() == [bits_of(f) for f in (a < b, a <= b, a < number, number <= b)]


@pytest.mark.parametrize("mask", [0, 1, 0x80, 0xA5, 0xFF])
def test_select(mask):
    a, b = SPECIAL, np.arange(8.0)
    out = np.zeros((1, 3, 8))
    _choose(mask, a[None, None], b[None, None], 7.5, out)
    flags = np.array([mask >> lane & 1 for lane in range(8)], bool)
    np.testing.assert_array_equal(out[0], [np.where(flags, *both) for both in ((a, b), (a, 7.5), (7.5, b))])


@pytest.mark.parametrize("n", [1, 5])
@pytest.mark.parametrize("new", [lanes.new_table, lambda rows, n: np.zeros((rows, n, 8))], ids=["table", "array"])
def test_load_and_store_address_rows_and_places(new, n):
    table, out = new(3, n), new(3, n)
    table[:] = np.random.default_rng(0).normal(size=table.shape)
    _shift(table, out)
    np.testing.assert_array_equal(out[1:, 1:], table[:-1, :-1])
    assert not out[0].any()
    assert not out[:, 0].any()


def test_new_tables_are_aligned():
    for n in range(1, 20):
        table = lanes.new_table(3, n)
        assert table.shape == (3, n, 8)
        assert table[0, 0].ctypes.data % 64 == 0
        assert table[1, 0].ctypes.data - table[0, 0].ctypes.data == 64
        assert not table.any()


def test_load_takes_tables_of_lanes_only():
    if hasattr(_shift, "py_func"):
        with pytest.raises(Exception, match="load"):
            _shift(np.zeros((3, 5)), np.zeros((3, 5, 8)))


CHECKED = """
import numpy as np
from evogymcm.sim import lanes
from evogymcm.sim._jit import kernel

@kernel
def copy(table, row, i):
    lanes.store(table, row, i, lanes.load(table, row, i))

table = lanes.new_table(3, 4)[:2, :3]  # what lies just beyond is ours, too
copy(table, 1, 2)
for place in ((2, 0), (0, 3), (-1, 0), (0, -1)):
    try:
        copy(table, *place)
    except IndexError:
        continue
    raise SystemExit(f"{place} was not found")
"""


@pytest.mark.slow
def test_indices_are_checked_where_numba_checks_its_own(tmp_path):
    variables = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_DISABLE_JIT": "0"}
    script = tmp_path / "checked.py"  # a kernel needs a file
    script.write_text(CHECKED)
    variables["PYTHONPATH"] = str(Path(__file__).parents[2])
    subprocess.run([sys.executable, script], env=variables, check=True, timeout=300)
