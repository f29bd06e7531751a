"""Which of many designs or policies no other beats, where more than the score counts."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def pareto_front(gains: ArrayLike, costs: ArrayLike) -> NDArray[np.bool_]:
    """Returns which points are on the Pareto front: no other gains as much at no more cost and is better in one.

    Equal points are on it together.

    Args:
        gains: (n,) or (n, k) numbers of which more is better, such as scores.
        costs: (n,) or (n, m) numbers of which less is better, such as supplied work.

    Returns:
        (n,) bool.

    Raises:
        ValueError: Both are not of the same n points, or a number is NaN.
    """
    parts = [np.asarray(values, np.float64) for values in (gains, costs)]
    shapes = [part.shape for part in parts]
    if any(part.ndim not in (1, 2) for part in parts) or shapes[0][:1] != shapes[1][:1]:
        raise ValueError(f"gains, costs: got shapes {shapes[0]} and {shapes[1]}, expected a row for each of n points")
    if any(np.isnan(part).any() for part in parts):
        raise ValueError("gains, costs: got NaN, expected numbers")
    gain, cost = (part if part.ndim == 2 else part[:, None] for part in parts)
    points = np.concatenate([gain, -cost], axis=1)
    return np.array([not ((points >= own).all(1) & (points > own).any(1)).any() for own in points], bool)
