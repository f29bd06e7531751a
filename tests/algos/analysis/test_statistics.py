"""Scores over seeds: means, differences, chances of improvement, their intervals, and curves brought together."""

import numpy as np
import pytest

from evogymcm.algos.analysis import (
    align,
    band,
    bootstrap,
    coverage,
    difference,
    improvement,
    interquartile_mean,
    interval_note,
    normalise,
    resample,
    share,
    summarise,
)


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


def test_clusters_are_drawn_whole():
    rng = np.random.default_rng(2)
    means = rng.normal(size=50)
    values, clusters = np.repeat(means, 8), np.repeat(np.arange(50), 8)
    assert bootstrap(values, clusters) == pytest.approx(bootstrap(means))  # eight copies tell no more than one
    low, high = bootstrap(values)
    assert high - low < 0.5 * np.subtract(*bootstrap(means)[::-1])
    uneven = bootstrap([0.0, 1.0, 1.0, 1.0], [7, 9, 9, 9])  # by its size a cluster counts in the mean
    assert uneven == (0.0, 1.0)
    columns = bootstrap(np.stack([values, -values], 1), clusters)
    np.testing.assert_allclose(columns[0], [-end for end in columns[1][::-1]], atol=0.05)
    with pytest.raises(ValueError, match="at least 2"):
        bootstrap([1.0, 2.0], [3, 3])
    with pytest.raises(ValueError, match="one a value"):
        bootstrap([1.0, 2.0], [1, 2, 3])


def test_summary():
    summary = summarise([1.0, 2.0, 3.0])
    assert (summary.n, summary.mean, summary.std) == (3, 2.0, 1.0)
    assert (str(summary), summary.interval) == ("2.00 (1.00)", "1.00 to 3.00")
    assert (summary.low, summary.high) == bootstrap([1.0, 2.0, 3.0])
    alone = summarise([-0.001])
    assert (str(alone), alone.interval) == ("0.00", "")
    with pytest.raises(ValueError, match="got no value"):
        summarise([])
    with pytest.raises(ValueError, match="got 1 values"):
        bootstrap([1.0])


def test_difference_and_its_interval():
    gain, (low, high) = difference([1.0, 2.0, 3.0], [4.0, 5.0, 9.0])
    assert gain == pytest.approx(4.0)
    assert 4 - 3 <= low < gain < high <= 9 - 1  # the lowest treated minus the highest control, and the reverse
    assert difference([1.0, 2.0, 3.0], [4.0, 5.0, 9.0])[1] == (low, high)
    assert difference([2.0, 2.0], [3.0, 3.0]) == (1.0, (1.0, 1.0))


def test_the_interval_of_a_difference_has_the_spread_of_both_means():
    rng = np.random.default_rng(0)
    a, b = rng.normal(0, 1, 200), rng.normal(0.5, 2, 200)
    gain, (low, high) = difference(a, b)
    error = np.sqrt(a.var() / 200 + b.var() / 200)
    assert high - low == pytest.approx(2 * 1.96 * error, rel=0.05)
    assert (low + high) / 2 == pytest.approx(gain, abs=0.2 * error)


def test_a_single_seed_has_no_interval():
    assert difference([1.0], [2.0, 3.0]) == (1.5, None)
    assert interquartile_mean({"a": [1.0], "b": [2.0]}) == (1.5, None)
    assert improvement({"a": [1.0]}, {"a": [2.0]}) == (1.0, None)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 18])
def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end(n):
    values = np.random.default_rng(n).normal(size=n)
    stats = pytest.importorskip("scipy.stats")
    assert interquartile_mean({"task": values})[0] == pytest.approx(stats.trim_mean(values, 0.25))


def test_one_wild_run_does_not_move_the_interquartile_mean():
    scores = {"a": [1.0, 1.1, 0.9], "b": [1.0, 1.2, 0.8]}
    value, (low, high) = interquartile_mean(scores)
    wild, _ = interquartile_mean(scores | {"b": [1.0, 100.0, 0.8]})
    assert wild == pytest.approx(value)
    assert low < value < high


def test_tasks_are_resampled_for_themselves():
    """Were runs drawn across tasks, the mean of two tasks whose runs all agree would vary."""
    assert interquartile_mean({"a": [1.0] * 3, "b": [5.0] * 3}) == (3.0, (3.0, 3.0))


def test_probability_of_improvement():
    chance, (low, high) = improvement({"a": [1, 2], "b": [1, 2]}, {"a": [2, 3], "b": [0, 0], "c": [9]})
    assert chance == pytest.approx((3.5 / 4 + 0) / 2)
    assert 0 <= low <= chance <= high <= 0.5
    assert improvement({"a": [1, 2]}, {"a": [3, 4]}) == (1.0, (1.0, 1.0))


def test_pairs_are_resampled_as_pairs():
    control, treated = [1.0, 5.0, 9.0], [2.0, 6.5, 10.0]
    gain, interval = difference(control, treated, is_paired=True)
    assert gain == pytest.approx(3.5 / 3)
    assert interval == (1.0, 1.5)
    assert difference(control, treated)[1][0] < 0  # as independent arms their spread hides the gain
    with pytest.raises(ValueError, match="got 3 and 2 scores, pairs"):
        difference(control, [1.0, 2.0], is_paired=True)


def test_shares_have_wilsons_interval():
    assert share(5, 10) == (0.5, pytest.approx((0.2366, 0.7634), abs=1e-4))
    assert share(0, 10) == (0.0, pytest.approx((0.0, 0.2775), abs=1e-4))
    assert share(3, 3) == (1.0, pytest.approx((0.4385, 1.0), abs=1e-4))
    for cases, n in ((0, 0), (3, 2), (-1, 2)):
        with pytest.raises(ValueError, match=f"got {cases} of {n}"):
            share(cases, n)


def test_scores_that_are_not_there_are_refused():
    with pytest.raises(ValueError, match="control: got scores of shape"):
        difference([], [1.0])
    with pytest.raises(ValueError, match="a: got scores"):
        interquartile_mean({"a": []})
    with pytest.raises(ValueError, match="no task"):
        interquartile_mean({})
    with pytest.raises(ValueError, match="in both"):
        improvement({"a": [1.0]}, {"b": [1.0]})
    with pytest.raises(ValueError, match="points"):
        align([[], [(0, 1.0)]], is_stepwise=True)


def test_scores_in_units_of_their_task():
    assert normalise({"a": [1.0, 3.0]}, {"a": 2.0, "b": 1.0}) == {"a": [0.5, 1.5]}


def test_coverage_grows_with_seeds():
    few, some, many = (coverage(n) for n in (3, 10, 40))
    assert 0.7 < few < 0.88 < some < 0.95
    assert many == pytest.approx(0.94, abs=0.02)


def test_resampling():
    curve, steps = [(10, 1.0), (20, 3.0)], [5.0, 10.0, 15.0, 20.0, 25.0]
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
    assert align(curves, is_stepwise=True)[1].tolist() == [[0.0, 1.0, 1.0], [2.0, 2.0, 5.0]]
    assert band([[(0, 1.0), (5, 1.0)], [(6, 1.0), (9, 1.0)]], is_stepwise=True) is None
    assert band(curves[:1], is_stepwise=True).low is None


def test_the_note_says_what_few_seeds_mean():
    assert "no interval" in interval_note([1, 1])
    assert "range of the seeds" in interval_note([3])
    assert "range of the seeds" not in interval_note([10])
    assert "1 to 3 seeds" in interval_note([3, 1])
