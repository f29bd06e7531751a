"""Comparison of arms: differences, interquartile means and probabilities of improvement, with their intervals."""

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def comparison(monkeypatch) -> ModuleType:
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("_comparison")


def test_difference_and_its_interval(comparison):
    gain, (low, high) = comparison.difference([1.0, 2.0, 3.0], [4.0, 5.0, 9.0])
    assert gain == pytest.approx(4.0)
    assert low < gain < high
    assert low >= 4 - 3  # the lowest treated minus the highest control
    assert high <= 9 - 1
    assert comparison.difference([1.0, 2.0, 3.0], [4.0, 5.0, 9.0])[1] == (low, high)


def test_the_interval_has_the_spread_of_both_means(comparison):
    rng = np.random.default_rng(0)
    a, b = rng.normal(0, 1, 200), rng.normal(0.5, 2, 200)
    gain, (low, high) = comparison.difference(a, b)
    error = np.sqrt(a.var() / 200 + b.var() / 200)
    assert high - low == pytest.approx(2 * 1.96 * error, rel=0.05)
    assert (low + high) / 2 == pytest.approx(gain, abs=0.2 * error)


def test_equal_scores_have_no_width(comparison):
    assert comparison.difference([2.0, 2.0], [3.0, 3.0]) == (1.0, (1.0, 1.0))


def test_a_single_seed_has_no_interval(comparison):
    assert comparison.difference([1.0], [2.0, 3.0]) == (1.5, None)
    assert comparison.interquartile_mean({"a": [1.0], "b": [2.0]}) == (1.5, None)
    assert comparison.improvement({"a": [1.0]}, {"a": [2.0]}) == (1.0, None)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 18])
def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end(comparison, n):
    values = np.random.default_rng(n).normal(size=n)
    value, _ = comparison.interquartile_mean({"task": values})
    stats = pytest.importorskip("scipy.stats")
    assert value == pytest.approx(stats.trim_mean(values, 0.25))


def test_one_wild_run_does_not_move_the_interquartile_mean(comparison):
    scores = {"a": [1.0, 1.1, 0.9], "b": [1.0, 1.2, 0.8]}
    value, _ = comparison.interquartile_mean(scores)
    wild, _ = comparison.interquartile_mean(scores | {"b": [1.0, 100.0, 0.8]})
    assert wild == pytest.approx(value)


def test_tasks_are_resampled_for_themselves(comparison):
    """Were runs drawn across tasks, the mean of two tasks whose runs all agree would vary."""
    assert comparison.interquartile_mean({"a": [1.0] * 3, "b": [5.0] * 3}) == (3.0, (3.0, 3.0))


def test_probability_of_improvement(comparison):
    chance, (low, high) = comparison.improvement({"a": [1, 2], "b": [1, 2]}, {"a": [2, 3], "b": [0, 0]})
    assert chance == pytest.approx((3.5 / 4 + 0) / 2)
    assert 0 <= low <= chance <= high <= 0.5
    assert comparison.improvement({"a": [1, 2]}, {"a": [3, 4]}) == (1.0, (1.0, 1.0))


def test_scores_in_units_of_their_task(comparison):
    assert comparison.normalise({"a": [1.0, 3.0]}, {"a": 2.0, "b": 1.0}) == {"a": [0.5, 1.5]}


def test_coverage_grows_with_seeds(comparison):
    few, some, many = (comparison.coverage(n) for n in (3, 10, 40))
    assert 0.7 < few < 0.88 < some < 0.95
    assert many == pytest.approx(0.94, abs=0.02)


@pytest.mark.parametrize("seeds", [2, 3, 5, 10])
def test_the_interval_of_a_mean_holds_it_as_often_as_it_says(comparison, seeds):
    low, high = comparison.mean_interval(np.random.default_rng(seeds).normal(size=(seeds, 20_000)))
    assert ((low <= 0) & (high >= 0)).mean() == pytest.approx(0.95, abs=0.005)
