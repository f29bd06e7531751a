"""Means over seeds, their intervals, and curves brought together."""

import numpy as np
import pytest

from evogymcm.report.intervals import band, bootstrap, interval_note, resample, summarise


@pytest.mark.parametrize("values", [[1.0, 2.0], [1.0, 2.0, 5.0]])
def test_of_three_seeds_or_fewer_the_interval_is_their_range(values):
    low, high = bootstrap(values)
    assert (low, high) == (min(values), max(values))


def test_of_many_values_the_interval_is_that_of_the_normal_distribution():
    values = np.random.default_rng(1).normal(3.0, 2.0, 400)
    low, high = bootstrap(values)
    half = 1.96 * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.02)
    assert high == pytest.approx(values.mean() + half, abs=0.02)
    assert bootstrap(values) == (low, high)


def test_summary():
    summary = summarise([1.0, 2.0, 3.0])
    assert (summary.n, summary.mean, summary.std) == (3, 2.0, 1.0)
    assert (str(summary), summary.interval) == ("2.00 (1.00)", "1.00 to 3.00")
    alone = summarise([-0.001])
    assert (str(alone), alone.interval) == ("0.00", "")
    with pytest.raises(ValueError, match="got no value"):
        summarise([])
    with pytest.raises(ValueError, match="got 1 values"):
        bootstrap([1.0])


def test_resampling():
    curve, steps = [(10, 1.0), (20, 3.0)], np.array([5.0, 10.0, 15.0, 20.0, 25.0])
    nan = np.nan
    np.testing.assert_array_equal(resample(curve, steps, is_stepwise=True), [nan, 1.0, 1.0, 3.0, nan])
    np.testing.assert_array_equal(resample(curve, steps, is_stepwise=False), [nan, 1.0, 2.0, 3.0, nan])


def test_a_band_covers_what_all_seeds_have():
    curves = [[(0, 0.0), (10, 1.0), (30, 3.0)], [(5, 2.0), (20, 5.0)]]
    found = band(curves, is_stepwise=False)
    assert found.steps.tolist() == [5, 10, 20]
    np.testing.assert_allclose(found.mean, [1.25, 2.0, 3.5])
    np.testing.assert_allclose(found.low, [0.5, 1.0, 2.0])
    np.testing.assert_allclose(found.high, [2.0, 3.0, 5.0])
    assert band([[(0, 1.0), (5, 1.0)], [(6, 1.0), (9, 1.0)]], is_stepwise=True) is None
    assert band(curves[:1], is_stepwise=True).low is None


def test_the_note_says_what_few_seeds_mean():
    assert "no interval" in interval_note([1, 1])
    assert "range of the seeds" in interval_note([3])
    assert "range of the seeds" not in interval_note([10])
    assert "1 to 3 seeds" in interval_note([3, 1])
