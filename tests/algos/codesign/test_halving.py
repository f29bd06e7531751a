"""Successive halving of training budgets."""

import numpy as np
import pytest

from evogymcm.algos.codesign import HalvingSchedule


def test_the_better_half_goes_on():
    schedule = HalvingSchedule(rungs=(0.25, 0.5), keep=(0.5, 0.4))
    fitness = {4: 1.0, 7: 3.0, 9: 2.0, 11: 5.0, 12: -1.0}
    assert schedule.promote(fitness, 0) == [11, 7, 9]  # half of five, rounded up
    assert schedule.promote({index: fitness[index] for index in (11, 7, 9)}, 1) == [11, 7]
    assert schedule.promote({3: 0.5}, 0) == [3]
    assert schedule.promote({}, 0) == []


def test_of_equals_the_first_go_on():
    assert HalvingSchedule().promote({5: 0.0, 2: 0.0, 9: 0.0, 1: 0.0}, 0) == [5, 2]
    assert HalvingSchedule().promote({5: 0.0, 2: 1.0, 9: 1.0, 1: 0.0}, 0) == [2, 9]
    assert HalvingSchedule(keep=(0.75, 0.5)).promote({5: 0.0, 2: 1.0, 9: 1.0, 1: 0.0}, 0) == [2, 9, 5]


def test_counts_are_not_raised_by_rounding_errors():
    assert 0.07 * 100 > 7.0
    assert HalvingSchedule((0.5,), (0.07,)).count(0, 100) == 7
    assert HalvingSchedule((0.5,), (0.071,)).count(0, 100) == 8


def test_cost_by_hand():
    # 16 bodies for a quarter, 8 for another, 4 for the rest.
    assert HalvingSchedule().cost(16) == pytest.approx(16 / 4 + 8 / 4 + 4 / 2)
    assert HalvingSchedule((), ()).cost(16) == 16.0


@pytest.mark.parametrize(
    ("rungs", "keep", "message"),
    [
        ((0.5, 0.25), (0.5, 0.5), "rungs"),
        ((0.0, 0.5), (0.5, 0.5), "rungs"),
        ((0.5, 1.0), (0.5, 0.5), "rungs"),
        ((0.5, np.nan), (0.5, 0.5), "rungs"),
        (0.5, 0.5, "rungs: got 0.5, expected a sequence of numbers"),
        ((0.5,), (0.5, 0.5), "expected 1 shares"),
        ((0.5,), (0.0,), "keep"),
        ((0.5,), (1.1,), "keep"),
    ],
)
def test_bad_schedules_are_refused(rungs, keep, message):
    with pytest.raises(ValueError, match=message):
        HalvingSchedule(rungs, keep)


def test_bad_promotions_are_refused():
    schedule = HalvingSchedule()
    with pytest.raises(ValueError, match="rung: got 2, expected 0 to 1"):
        schedule.promote({0: 1.0}, 2)
    with pytest.raises(ValueError, match="finite"):
        schedule.promote({0: np.nan}, 0)
