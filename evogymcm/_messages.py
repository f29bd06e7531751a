"""What error messages quote of what was given: always short, however much it was."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


def brief(value: Any, limit: int = 80) -> str:
    """Returns the value as it is written, on one line and cut to about `limit` characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def some(values: Iterable[Any], limit: int = 5) -> str:
    """Returns the first values, separated by commas, and how many follow."""
    items = list(values)
    shown = ", ".join(brief(item, 40) if not isinstance(item, str) else item for item in items[:limit])
    return shown if len(items) <= limit else f"{shown} and {len(items) - limit} more"


def known(given: Any, names: Iterable[str]) -> str:
    """Returns the names, or of many those that resemble what was given, and how many there are."""
    items = list(names)
    if len(items) <= 12:
        return ", ".join(items)
    alike = get_close_matches(str(given), items, 3, 0.5)
    return some([*alike, *(name for name in items if name not in alike)])
