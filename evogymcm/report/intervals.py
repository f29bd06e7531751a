"""Means over seeds and how sure they are: bootstrap intervals, and curves brought to common env-steps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Band", "Summary", "band", "bootstrap", "interval_note", "resample", "summarise"]

Curve = Sequence[tuple[float, float]]
CONFIDENCE, RESAMPLES = 0.95, 10_000


@dataclass(frozen=True)
class Summary:
    """Mean of a score over seeds.

    Attributes:
        n: number of seeds.
        mean: over them.
        std: with n - 1 in the denominator; None of one seed.
        low, high: 95 % interval of the mean; None of one seed.
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
        """The interval as text, empty of one seed."""
        return "" if self.low is None else f"{self.low:z.2f} to {self.high:z.2f}"


@dataclass(frozen=True)
class Band:
    """A mean curve over seeds: arrays (T,), where `low` and `high` are None of one seed."""

    steps: NDArray[np.float64]
    mean: NDArray[np.float64]
    low: NDArray[np.float64] | None
    high: NDArray[np.float64] | None


def bootstrap(values: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the ends of the 95 % percentile-bootstrap interval of the mean over the first axis (n, ...).

    Always the same for the same values. Of two or three seeds it is their whole range: the mean of a resample is the
    smallest value with a probability of 1/4 or 1/27, which is more than 2.5 %.

    Raises:
        ValueError: There are fewer than two values.
    """
    values = np.asarray(values, float)
    n = values.shape[0] if values.ndim else 0
    if n < 2:
        raise ValueError(f"bootstrap: got {n} values, at least 2 are needed")
    draws = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), RESAMPLES)  # how often each is drawn
    means = np.tensordot(draws / n, values, 1)
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)
    return low, high


def summarise(values: Sequence[float]) -> Summary:
    """Returns the summary of one score of each seed.

    Raises:
        ValueError: There is none.
    """
    if not values:
        raise ValueError("summarise: got no value, at least one is needed")
    mean = float(np.mean(values))
    if len(values) == 1:
        return Summary(1, mean, None, None, None)
    low, high = bootstrap(values)
    return Summary(len(values), mean, float(np.std(values, ddof=1)), float(low), float(high))


def resample(curve: Curve, steps: NDArray[np.float64], *, is_stepwise: bool) -> NDArray[np.float64]:
    """Returns a curve's values at other env-steps, NaN before its first point and after its last.

    Args:
        curve: (env-steps, value), in order.
        steps: (T,) where it is wanted.
        is_stepwise: whether a value holds until the next (the best so far), instead of changing linearly.
    """
    at, values = np.array(curve, float).T
    if is_stepwise:
        place = np.searchsorted(at, steps, side="right") - 1
        found = values[place.clip(0)]
    else:
        found = np.interp(steps, at, values)
    return np.where((steps >= at[0]) & (steps <= at[-1]), found, np.nan)


def band(curves: Sequence[Curve], *, is_stepwise: bool) -> Band | None:
    """Returns the mean curve where all seeds have values; None where there is no such place."""
    begin, end = max(curve[0][0] for curve in curves), min(curve[-1][0] for curve in curves)
    if begin > end:
        return None
    points = {step for curve in curves for step, _ in curve if begin <= step <= end} | {begin, end}
    steps = np.array(sorted(points), float)
    values = np.stack([resample(curve, steps, is_stepwise=is_stepwise) for curve in curves])
    if len(curves) == 1:
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
