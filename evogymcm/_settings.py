"""Checks of settings: each returns the value as Python has it, or its ValueError says what is allowed instead."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from numbers import Real
from operator import ge, gt, le, lt
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from evogymcm._messages import brief

# What several settings allow, for type checkers, the command line and the checks alike.
Material = Literal["invariant", "reactive"]
EdgeRule = Literal["mean_factor", "mean_stiffness"]
# Of an episode, as infos and tables call it: what commands supplied, and less what came back.
WORK = ("actuation_work", "stiffness_work", "net_actuation_work", "net_stiffness_work")
WorkWeight = float | tuple[float, float] | None


def check_fields(config: Any, bounds: Mapping[str, Mapping[str, Any]]) -> None:
    """Sets the fields of a frozen dataclass to their values as Python has them, each by its type.

    Texts that are one of several, flags, whole and other numbers are checked, and may be None where the type says so;
    fields of other types are left as they are.

    Args:
        config: The dataclass, in its `__post_init__`.
        bounds: By field, what `check_count` or `check_number` takes; a count is at least 1 by default.
    """
    types = get_type_hints(type(config))
    for field in fields(config):
        value, kind = getattr(config, field.name), types[field.name]
        allowed = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
        checks: dict[Any, Callable[..., Any]] = {bool: check_flag, int: check_count, float: check_number}
        known = [one for one in allowed if one in checks or get_origin(one) is Literal]
        is_other = len(known) < len(set(allowed) - {NoneType}) and not isinstance(value, Real)
        if is_other or (value is None and NoneType in allowed):
            continue
        for one in known:
            if one in checks:
                value = checks[one](field.name, value, **bounds.get(field.name, {}))
            else:
                value = check_choice(field.name, value, get_args(one))
        object.__setattr__(config, field.name, value)


def check_count(name: str, value: Any, low: int = 1) -> int:
    """Returns a whole number, as 1e6 and numpy's are too."""
    if not _is_finite(value) or value != math.floor(value) or value < low:
        raise ValueError(f"{name}: got {brief(value)}, expected a whole number of at least {low}")
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
    """Returns a finite number; `above` and `below` are bounds that it must not reach."""
    bounds = (("at least", ge, low), ("above", gt, above), ("at most", le, high), ("below", lt, below))
    given = [(text, fits, bound) for text, fits, bound in bounds if bound is not None]
    if not _is_finite(value) or not all(fits(value, bound) for _, fits, bound in given):
        allowed = " and ".join(f"{text} {bound:g}" for text, _, bound in given)
        raise ValueError(f"{name}: got {brief(value)}, expected a finite number {allowed}".rstrip())
    return float(value)


def check_flag(name: str, value: Any) -> bool:
    """Returns True or False."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name}: got {brief(value)}, expected True or False")
    return bool(value)


def check_choice(name: str, value: Any, allowed: Sequence[str]) -> str:
    """Returns one of the values allowed."""
    if not isinstance(value, str) or value not in allowed:
        raise ValueError(f"{name}: got {brief(value)}, allowed are {', '.join(allowed)}")
    return value


def check_numbers(name: str, value: Any) -> tuple[float, ...]:
    """Returns a sequence of finite numbers as a tuple."""
    if _length(value) is None:
        raise ValueError(f"{name}: got {brief(value)}, expected a sequence of numbers")
    return tuple(check_number(name, item) for item in value)


def check_array(name: str, value: Any) -> np.ndarray:
    """Returns numbers as a new float64 array of their shape; they may be infinite or NaN."""
    try:
        return np.array(value, np.float64, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name}: got {brief(value)}, expected an array of numbers") from error


def check_work_weight(value: Any) -> tuple[float, float] | None:
    """Returns what work of actuation and of stiffness costs, see `WorldOptions`; None where it is not measured."""
    if value is None:
        return None
    first, second = (value, value) if isinstance(value, Real) else check_pair("work_weight", value)
    return check_number("work_weight", first, low=0), check_number("work_weight", second, low=0)


def check_pair(name: str, value: Any) -> tuple[Any, Any]:
    """Returns a tuple of two."""
    if _length(value) != 2:
        raise ValueError(f"{name}: got {brief(value)}, expected two numbers")
    first, second = value
    return first, second


def _length(value: Any) -> int | None:
    """Returns how long a sequence of single values is, None for everything else."""
    if isinstance(value, str | bytes):
        return None
    try:
        items = np.asarray(value, object)
    except ValueError:  # arrays of unlike shapes
        return None
    return len(items) if items.ndim == 1 else None


def _is_finite(value: Any) -> bool:
    """Whether it is a finite number, as floats have them; True and False are none."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False
