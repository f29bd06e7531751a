"""Checks of settings. Each returns the value as Python has it, or says what was given and what is allowed."""

import math
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np

__all__ = ["check_choice", "check_count", "check_flag", "check_number", "check_numbers", "check_pair"]


def check_count(name: str, value: Any, low: int = 1, high: int | None = None) -> int:
    """Returns a whole number, as 1e6 and numpy's are too.

    Raises:
        ValueError: It is none, or out of range.
    """
    is_whole = _is_finite(value) and value == math.floor(value)
    if not is_whole or value < low or (high is not None and value > high):
        bounds = f"of at least {low}" if high is None else f"from {low} to {high}"
        raise ValueError(f"{name}: got {value!r}, expected a whole number {bounds}")
    return int(value)


def check_number(
    name: str,
    value: Any,
    *,
    low: float | None = None,
    high: float | None = None,
    above: float | None = None,
    below: float | None = None,
) -> float:
    """Returns a finite number; `above` and `below` are bounds that it must not reach.

    Raises:
        ValueError: It is none, or out of range.
    """
    bounds = {"at least": low, "above": above, "at most": high, "below": below}
    given = {text: bound for text, bound in bounds.items() if bound is not None}
    if (
        not _is_finite(value)
        or (low is not None and value < low)
        or (above is not None and value <= above)
        or (high is not None and value > high)
        or (below is not None and value >= below)
    ):
        allowed = " and ".join(f"{text} {bound:g}" for text, bound in given.items())
        raise ValueError(f"{name}: got {value!r}, expected a finite number {allowed}".rstrip())
    return float(value)


def check_flag(name: str, value: Any) -> bool:
    """Returns True or False.

    Raises:
        ValueError: It is neither.
    """
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name}: got {value!r}, expected True or False")
    return bool(value)


def check_choice(name: str, value: Any, allowed: Sequence[str]) -> str:
    """Returns one of the values allowed.

    Raises:
        ValueError: It is none of them.
    """
    if not isinstance(value, str) or value not in allowed:
        raise ValueError(f"{name}: got {value!r}, allowed are {', '.join(allowed)}")
    return value


def check_numbers(name: str, value: Any) -> tuple[float, ...]:
    """Returns a sequence of finite numbers as a tuple.

    Raises:
        ValueError: It is none.
    """
    if isinstance(value, str) or np.ndim(value) != 1:
        raise ValueError(f"{name}: got {value!r}, expected a sequence of numbers")
    return tuple(check_number(name, item) for item in value)


def check_pair(name: str, value: Any) -> tuple[Any, Any]:
    """Returns a tuple of two.

    Raises:
        ValueError: There are not two.
    """
    if isinstance(value, str) or np.ndim(value) != 1 or len(value) != 2:
        raise ValueError(f"{name}: got {value!r}, expected two numbers")
    first, second = value
    return first, second


def _is_finite(value: Any) -> bool:
    """Whether it is a finite number; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
