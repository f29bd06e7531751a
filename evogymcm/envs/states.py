"""What of a saved state is checked, before any of it is taken up."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def checked_part(state: Any, name: str) -> Any:
    """Returns what a state holds under a name; ValueError where it holds nothing."""
    if not isinstance(state, Mapping) or name not in state:
        raise ValueError(f"state: it has no {name!r}; is it of an engine made with the same arguments?")
    return state[name]


def checked_arrays(state: Any, known: Mapping[str, np.ndarray], part: str = "") -> dict[str, np.ndarray]:
    """Returns copies of a state's arrays.

    Args:
        state: The state.
        known: The present arrays.
        part: Where in the state they are, and nothing else.

    Raises:
        ValueError: One is missing, or has another shape or kind than the present one.
    """
    given = checked_part(state, part) if part else state
    if part and (not isinstance(given, Mapping) or given.keys() != known.keys()):
        raise ValueError(f"state: {part!r} holds {list(given)}, expected {list(known)}")
    checked = {}
    for name, values in known.items():
        array = np.asarray(checked_part(given, name))
        if array.shape != values.shape:
            raise ValueError(f"state: {name!r} has shape {array.shape}, expected {values.shape}")
        if not np.can_cast(array.dtype, values.dtype, "same_kind"):
            raise ValueError(f"state: {name!r} is {array.dtype}, expected {values.dtype}")
        checked[name] = np.array(array, values.dtype, order="C")
    return checked


def checked_rngs(state: Any, rngs: Sequence[np.random.Generator]) -> list[np.random.Generator]:
    """Returns new generators in the saved states; ValueError for others, or for more or fewer of them."""
    saved = checked_part(state, "rngs")
    if len(saved) != len(rngs):
        raise ValueError(f"state: 'rngs' are {len(saved)}, expected {len(rngs)}")
    made = []
    for rng, one in zip(rngs, saved, strict=True):
        bits = type(rng.bit_generator)(0)
        try:
            bits.state = one
        except (TypeError, ValueError, KeyError) as error:
            raise ValueError(f"state: 'rngs' hold one that is no {type(bits).__name__}'s: {error}") from error
        made.append(np.random.Generator(bits))
    return made
