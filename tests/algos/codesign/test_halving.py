"""Successive halving of training budgets."""

import numpy as np
import pytest

from evogymcm.algos.codesign import HalvingSchedule


def test_the_share_kept_is_rounded_up_but_not_for_rounding_errors():
    assert HalvingSchedule((0.25, 0.5), (0.5, 0.4)).count(0, 5) == 3
    assert HalvingSchedule((0.25, 0.5), (0.5, 0.4)).count(1, 3) == 2
    # 0.07 * 100 is above 7 by a rounding error
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
