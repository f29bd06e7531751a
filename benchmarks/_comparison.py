"""Comparison of two arms over few seeds: differences, interquartile means, probability of improvement, with intervals.

Scores are lists, one number a seed; where several tasks count together, a mapping of task to such a list. Intervals are
percentile bootstrap intervals; seeds are resampled within each arm and task (strata), as in Agarwal et al., "Deep
Reinforcement Learning at the Edge of the Statistical Precipice", 2021. Equal input gives equal intervals.
"""

import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Scores = Mapping[str, Sequence[float]]
Interval = tuple[float, float]
Array = NDArray[np.float64]

LEVEL = 0.95
_T = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262)  # 97.5 % quantiles for 1 to 9 degrees of freedom
_RESAMPLES = 5_000
_TRIALS = 2_000  # simulated comparisons of `coverage`


def difference(control: Sequence[float], treated: Sequence[float]) -> tuple[float, Interval | None]:
    """Returns the mean of `treated` minus that of `control`, and its interval; None where an arm has a single seed."""
    rng = np.random.default_rng(0)
    a, b = np.asarray(control, float), np.asarray(treated, float)
    gain = float(b.mean() - a.mean())
    if min(len(a), len(b)) < 2:
        return gain, None
    return gain, _interval(_resample(b, rng).mean(1) - _resample(a, rng).mean(1))


def mean_interval(values: Array) -> tuple[Array, Array]:
    """Returns the ends of Student's 95 % interval of the mean over the first axis, whose length is 2 at least.

    It holds the true mean of few seeds as often as it says if their scores are normal; beyond 10 seeds it is a little
    too wide.
    """
    n = len(values)
    half = _T[min(n - 2, len(_T) - 1)] * values.std(0, ddof=1) / np.sqrt(n)
    return values.mean(0) - half, values.mean(0) + half


def trimmed_mean(values: Array) -> Array:
    """Returns the mean over the last axis without its lowest and highest quarters, each rounded down."""
    values = np.sort(values, axis=-1)
    n = values.shape[-1]
    return values[..., n // 4 : n - n // 4].mean(-1)


def interquartile_mean(scores: Scores) -> tuple[float, Interval | None]:
    """Returns the interquartile mean over tasks and seeds, and its interval; None where no task has two seeds."""

    def pool(groups: Sequence[Array]) -> Array:
        return trimmed_mean(np.concatenate(groups, axis=-1))

    return _stratified(pool, [np.asarray(values, float) for values in scores.values()])


def improvement(control: Scores, treated: Scores) -> tuple[float, Interval | None]:
    """Returns how often a treated run beats a control run of the same task, a mean over tasks; ties count half."""
    tasks = [task for task in control if task in treated]
    groups = [np.asarray(arm[task], float) for task in tasks for arm in (control, treated)]

    def chance(samples: Sequence[Array]) -> Array:
        won = []
        for a, b in zip(samples[::2], samples[1::2], strict=True):
            a, b = a[..., :, None], b[..., None, :]
            won.append(((b > a) + 0.5 * (b == a)).mean((-2, -1)))
        return np.mean(won, axis=0)

    return _stratified(chance, groups)


def normalise(scores: Scores, units: Mapping[str, float]) -> dict[str, list[float]]:
    """Returns the scores of each task divided by the task's unit."""
    return {task: [value / units[task] for value in values] for task, values in scores.items()}


@functools.cache
def coverage(seeds: int) -> float:
    """Returns how often the interval of `difference` holds the true one: simulated, normal scores, equal spreads."""
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(_TRIALS):
        a, b = rng.normal(size=(2, seeds))
        picks = rng.integers(seeds, size=(2, 500, seeds))
        low, high = _interval(b[picks[0]].mean(1) - a[picks[1]].mean(1))
        held += low <= 0 <= high
    return held / _TRIALS


def _stratified(
    statistic: Callable[[Sequence[Array]], Array], groups: Sequence[Array]
) -> tuple[float, Interval | None]:
    """Returns a statistic of groups and its interval, with each group resampled for itself."""
    rng = np.random.default_rng(0)
    value = float(statistic(groups))
    if all(len(group) < 2 for group in groups):
        return value, None
    return value, _interval(statistic([_resample(group, rng) for group in groups]))


def _resample(values: Array, rng: np.random.Generator) -> Array:
    """Returns (resamples, n) values drawn with replacement."""
    return values[rng.integers(len(values), size=(_RESAMPLES, len(values)))]


def _interval(samples: Array) -> Interval:
    low, high = np.quantile(samples, ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return float(low), float(high)
