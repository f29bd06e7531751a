"""Scores over seeds with their uncertainty: means, differences, chances of improvement, and mean curves.

Intervals are 95 % percentile-bootstrap intervals with 10,000 resamples. Where several arms or tasks count together,
seeds are resampled within each of them (strata), as in Agarwal et al., "Deep Reinforcement Learning at the Edge of the
Statistical Precipice", 2021. Equal input gives equal intervals. A share of cases has Wilson's interval instead, since
a resample of cases that are all alike has no spread.

Scores are sequences, one number a seed; of several tasks, mappings of task to such a sequence.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "CONFIDENCE",
    "RESAMPLES",
    "Band",
    "Summary",
    "align",
    "band",
    "bootstrap",
    "coverage",
    "difference",
    "improvement",
    "interquartile_mean",
    "interval_note",
    "normalise",
    "resample",
    "share",
    "summarise",
]

Array = NDArray[np.float64]
Curve = Sequence[tuple[float, float]]
Interval = tuple[float, float]
Scores = Mapping[str, Sequence[float]]

CONFIDENCE = 0.95
RESAMPLES = 10_000
_TRIALS, _FEWER = 2_000, 1_000  # simulated comparisons of `coverage`, and the resamples of each


@dataclass(frozen=True)
class Summary:
    """Mean of a score over seeds.

    Attributes:
        n: number of seeds.
        mean: mean score.
        std: standard deviation with n - 1 in the denominator; None for a single seed.
        low, high: 95 % interval of the mean; None for a single seed.
    """

    n: int
    mean: float
    std: float | None
    low: float | None
    high: float | None

    def __str__(self) -> str:
        spread = "" if self.std is None else f" ({self.std:z.2f})"
        return f"{self.mean:z.2f}{spread}"

    @property
    def interval(self) -> str:
        """The interval as text, empty for a single seed."""
        return "" if self.low is None else f"{self.low:z.2f} to {self.high:z.2f}"


@dataclass(frozen=True)
class Band:
    """A mean curve over seeds: arrays (T,); `low` and `high` are None for a single seed."""

    steps: Array
    mean: Array
    low: Array | None
    high: Array | None


def _draws(n: int, rng: np.random.Generator, resamples: int = RESAMPLES) -> Array:
    """Returns (resamples, n) how often each of n values is drawn, with replacement."""
    return rng.multinomial(n, np.full(n, 1 / n), resamples).astype(np.float64)


def _means(values: Array, rng: np.random.Generator, resamples: int = RESAMPLES) -> Array:
    """Returns the means (resamples, ...) of resamples of (n, ...) values."""
    return np.tensordot(_draws(len(values), rng, resamples) / len(values), values, 1)


def _ends(resamples: Array) -> tuple[Array, Array]:
    """Returns the ends of the middle 95 % over the first axis."""
    low, high = np.quantile(resamples, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)
    return low, high


def _interval(resamples: Array) -> Interval:
    low, high = _ends(resamples)
    return float(low), float(high)


def bootstrap(values: ArrayLike, clusters: ArrayLike | None = None) -> tuple[Array, Array]:
    """Returns the ends of the interval of the mean over the first axis.

    For two or three values it is their whole range: the mean of a resample is the smallest value with a probability of
    1/4 or 1/27, which is more than 2.5 %.

    Args:
        values: (n, ...) one row a seed.
        clusters: (n,) names of groups of dependent values, which are drawn together; by default each value by itself.

    Raises:
        ValueError: There are fewer than two values, or clusters.
    """
    values, rng = np.asarray(values, float), np.random.default_rng(0)
    n = len(values) if values.ndim else 0
    if clusters is None:
        if n < 2:
            raise ValueError(f"bootstrap: got {n} values, at least 2 are needed")
        return _ends(_means(values, rng))
    _, group = np.unique(np.asarray(clusters), return_inverse=True)
    if group.shape != (n,) or n == 0 or group.max() < 1:
        raise ValueError(f"clusters: got {np.shape(clusters)} of {n} values, at least 2 are needed, and one a value")
    counts = np.bincount(group)
    sums = np.zeros((len(counts), *values.shape[1:]))
    np.add.at(sums, group, values)
    draws = _draws(len(counts), rng)
    return _ends((np.tensordot(draws, sums, 1).T / (draws @ counts)).T)


def summarise(values: Sequence[float]) -> Summary:
    """Returns the summary of the scores, one for each seed.

    Raises:
        ValueError: There are no scores.
    """
    n = len(values)
    if not n:
        raise ValueError("summarise: got no value, at least one is needed")
    mean = float(np.mean(values))
    if n == 1:
        return Summary(1, mean, None, None, None)
    low, high = bootstrap(values)
    return Summary(n, mean, float(np.std(values, ddof=1)), float(low), float(high))


def difference(
    control: Sequence[float], treated: Sequence[float], *, is_paired: bool = False
) -> tuple[float, Interval | None]:
    """Returns the mean of `treated` minus that of `control`, and its interval; None where an arm has a single seed.

    Args:
        control: one score a seed.
        treated: one score a seed.
        is_paired: whether the scores are pairs, in order, such as of equal seeds, and are resampled as pairs; otherwise
            the arms are treated as independent.

    Raises:
        ValueError: An arm has no score, or pairs are incomplete.
    """
    a, b = _checked("control", control), _checked("treated", treated)
    if is_paired and len(a) != len(b):
        raise ValueError(f"control, treated: got {len(a)} and {len(b)} scores, pairs need as many of both")
    gain = float(b.mean() - a.mean())
    if min(len(a), len(b)) < 2:
        return gain, None
    if is_paired:
        low, high = bootstrap(b - a)
        return gain, (float(low), float(high))
    rng = np.random.default_rng(0)
    return gain, _interval(_means(b, rng) - _means(a, rng))


def interquartile_mean(scores: Scores) -> tuple[float, Interval | None]:
    """Returns the mean of all runs without their lowest and highest quarters, each rounded down, and its interval.

    The interval is None where no task has two seeds.

    Raises:
        ValueError: A task has no score, or there is no task.
    """
    groups = [_checked(task, values) for task, values in scores.items()]
    if not groups:
        raise ValueError("interquartile_mean: got no task, at least one is needed")
    value = float(_middle(np.concatenate(groups)))
    if all(len(group) < 2 for group in groups):
        return value, None
    rng = np.random.default_rng(0)
    resamples = []
    for group in groups:
        draws = _draws(len(group), rng).astype(np.int64)
        numbers = np.broadcast_to(np.arange(len(group)), draws.shape)
        resamples.append(group[np.repeat(numbers.ravel(), draws.ravel())].reshape(draws.shape))
    return value, _interval(_middle(np.concatenate(resamples, axis=1)))


def _middle(values: Array) -> Array:
    """Returns the mean over the last axis without the quarters at its ends."""
    values = np.sort(values, axis=-1)
    n = values.shape[-1]
    return values[..., n // 4 : n - n // 4].mean(-1)


def improvement(control: Scores, treated: Scores) -> tuple[float, Interval | None]:
    """Returns how often a treated run beats a control run of the same task, a mean over the tasks that both have.

    Ties count half. The interval is None where no arm has two seeds.

    Raises:
        ValueError: There is no such task, or one has no score.
    """
    tasks = [task for task in control if task in treated]
    if not tasks:
        raise ValueError(f"improvement: got tasks {list(control)} and {list(treated)}, at least one must be in both")
    rng = np.random.default_rng(0)
    chances, resamples, most = [], [], 0
    for task in tasks:
        a, b = _checked(task, control[task]), _checked(task, treated[task])
        wins = (b > a[:, None]) + 0.5 * (b == a[:, None])  # (control's seeds, treated's)
        chances.append(wins.mean())
        resamples.append(((_draws(len(a), rng) @ wins) * _draws(len(b), rng)).sum(1) / wins.size)
        most = max(most, *wins.shape)
    return float(np.mean(chances)), _interval(np.mean(resamples, axis=0)) if most > 1 else None


def share(cases: int, n: int) -> tuple[float, Interval]:
    """Returns the share of cases among n independent ones, and its interval after Wilson, 1927.

    Raises:
        ValueError: There are none, or more cases than n.
    """
    if not 0 <= cases <= n or n < 1:
        raise ValueError(f"cases, n: got {cases} of {n}, expected 0 to n, and n of at least 1")
    z = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
    found = cases / n
    middle, scale = found + z**2 / (2 * n), 1 + z**2 / n
    half = z * (found * (1 - found) / n + z**2 / (4 * n**2)) ** 0.5
    return found, (max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale))


def normalise(scores: Scores, units: Mapping[str, float]) -> dict[str, list[float]]:
    """Returns the scores of each task divided by the task's unit."""
    return {task: [value / units[task] for value in values] for task, values in scores.items()}


def _checked(name: str, values: Sequence[float]) -> Array:
    array = np.asarray(values, float)
    if array.ndim != 1 or not len(array):
        raise ValueError(f"{name}: got scores of shape {array.shape}, expected one a seed, and at least one")
    return array


@functools.cache
def coverage(seeds: int) -> float:
    """Returns how often the interval of `difference` holds the true one: simulated, normal scores, equal spreads."""
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, seeds, _TRIALS))
    low, high = _ends(_means(b, rng, _FEWER) - _means(a, rng, _FEWER))
    return np.count_nonzero((low <= 0) & (high >= 0)) / _TRIALS


def resample(curve: Curve, steps: ArrayLike, *, is_stepwise: bool) -> Array:
    """Returns a curve's values at other env-steps, NaN before its first point and after its last.

    Args:
        curve: (env-steps, value), in order.
        steps: (T,) where it is wanted.
        is_stepwise: whether a value holds until the next (the best so far), instead of changing linearly.
    """
    at, values = np.array(curve, float).T
    wanted = np.asarray(steps, float)
    if is_stepwise:
        place = np.searchsorted(at, wanted, side="right") - 1
        found = values[place.clip(0)]
    else:
        found = np.interp(wanted, at, values)
    return np.where((wanted >= at[0]) & (wanted <= at[-1]), found, np.nan)


def align(curves: Sequence[Curve], *, is_stepwise: bool) -> tuple[Array, Array] | None:
    """Returns all env-steps (T,) at which every curve has a value, and the (n, T) values; None where there are none.

    Args:
        curves: n curves, see `resample`.
        is_stepwise: see `resample`.

    Raises:
        ValueError: There is no curve, or one without a point.
    """
    if not curves or not all(len(curve) for curve in curves):
        raise ValueError(f"curves: got {[len(curve) for curve in curves]} points, expected one at least in each")
    begin, end = max(curve[0][0] for curve in curves), min(curve[-1][0] for curve in curves)
    if begin > end:
        return None
    points = {step for curve in curves for step, _ in curve if begin <= step <= end} | {begin, end}
    steps = np.array(sorted(points), float)
    return steps, np.stack([resample(curve, steps, is_stepwise=is_stepwise) for curve in curves])


def band(curves: Sequence[Curve], *, is_stepwise: bool) -> Band | None:
    """Returns the mean curve and its intervals where all seeds have values, see `align`; None where there are none."""
    aligned = align(curves, is_stepwise=is_stepwise)
    if aligned is None:
        return None
    steps, values = aligned
    if len(values) == 1:
        return Band(steps, values[0], None, None)
    return Band(steps, values.mean(0), *bootstrap(values))


def interval_note(counts: Sequence[int]) -> str:
    """Returns a sentence on the intervals of means over so many seeds."""
    present = sorted(set(counts))
    if not present or present[-1] < 2:
        return "One seed each: there is no interval, and differences may be chance."
    seeds = f"{present[0]} to {present[-1]}" if len(present) > 1 else f"{present[-1]}"
    note = f"Intervals: 95 % bootstrap intervals of the mean over {seeds} seeds ({RESAMPLES:,} resamples)."
    if any(2 <= count <= 3 for count in present):
        note += " With 3 seeds or fewer such an interval is just the range of the seeds: read it as a rough guide."
    if present[0] == 1:
        note += " Where there is one seed there is no interval."
    return note
