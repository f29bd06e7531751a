"""Hash sets of whole numbers that are iterated over in the order of C++'s: libstdc++'s `unordered_set<int>`.

A set is a list of values with a size. A value is put before the first one with the same remainder modulo the size, or
at the front where there is none. A set with no room left grows: it takes the next of `SIZES`, and its values are put
anew, in their order. Erasing leaves the size and the order of the others as they are.
"""

from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import MISSING
from evogymcm.sim.kernels._jit import inlined, kernel

# How many values a set has room for, as it grows.
SIZES = np.array([13, 29, 59, 127, 257, 541, 1109, 2357, 5087, 10273, 20753, 42043, 85229, 172933, 351061, 712697])


class Sets(NamedTuple):
    """Hash sets as linked lists in their order of iteration, with a pool of entries in common."""

    head: np.ndarray  # (sets + 1,) first entry of each set, MISSING for none; the last: the first free entry
    size: np.ndarray  # (sets,) room, and the number of remainders that are told apart; 1 for a new set, without room
    held: np.ndarray  # (sets,) how many values
    value: np.ndarray  # (entries,)
    after: np.ndarray  # (entries,) the next entry


def new_sets(n_sets: int, n_entries: int) -> Sets:
    """Returns arrays for sets that hold no more than `n_entries` values together, to be cleared first.

    Nothing checks that they hold no more.
    """
    return Sets(*(np.empty(n, np.int64) for n in (n_sets + 1, n_sets, n_sets, n_entries, n_entries)))


@kernel
def clear(sets: Sets) -> None:
    """Makes all sets new ones."""
    sets.head[:], sets.size[:], sets.held[:] = MISSING, 1, 0
    for entry in range(sets.after.shape[0]):
        _free(sets, entry)


@inlined
def _put(sets: Sets, s: int, entry: int) -> None:
    """Links an entry into set `s`: before the first value with its remainder, at the front where there is none."""
    size = sets.size[s]
    remainder = sets.value[entry] % size
    before, at = MISSING, sets.head[s]
    while at != MISSING and sets.value[at] % size != remainder:
        before, at = at, sets.after[at]
    if before == MISSING or at == MISSING:
        sets.after[entry] = sets.head[s]
        sets.head[s] = entry
    else:
        sets.after[entry] = at
        sets.after[before] = entry


@inlined
def _has(sets: Sets, s: int, value: int) -> bool:
    """Returns whether set `s` has the value."""
    at = sets.head[s]
    while at != MISSING and sets.value[at] != value:
        at = sets.after[at]
    return at != MISSING


@kernel
def _add(sets: Sets, s: int, entry: int) -> None:
    """Takes an entry, which is in no list, into set `s`, which has not got its value."""
    if sets.size[s] == 1 or sets.held[s] == sets.size[s]:  # it grows, and is linked anew
        k = 0
        while SIZES[k] <= sets.size[s]:
            k += 1
        sets.size[s] = SIZES[k]
        at = sets.head[s]
        sets.head[s] = MISSING
        while at != MISSING:
            following = sets.after[at]
            _put(sets, s, at)
            at = following
    _put(sets, s, entry)
    sets.held[s] += 1


@inlined
def _free(sets: Sets, entry: int) -> None:
    """Puts an entry to the free ones."""
    sets.after[entry] = sets.head[-1]
    sets.head[-1] = entry


@inlined
def insert(sets: Sets, s: int, value: int) -> None:
    """Inserts a value into set `s`, if absent."""
    if _has(sets, s, value):
        return
    entry = sets.head[-1]
    sets.head[-1] = sets.after[entry]
    sets.value[entry] = value
    _add(sets, s, entry)


@kernel
def erase(sets: Sets, s: int, value: int) -> None:
    """Takes a value out of set `s`, if present."""
    before, at = MISSING, sets.head[s]
    while at != MISSING and sets.value[at] != value:
        before, at = at, sets.after[at]
    if at == MISSING:
        return
    if before == MISSING:
        sets.head[s] = sets.after[at]
    else:
        sets.after[before] = sets.after[at]
    sets.held[s] -= 1
    _free(sets, at)


@kernel
def move(sets: Sets, s: int, into: int) -> None:
    """Inserts the values of set `s`, in its order, into another, and makes `s` empty."""
    entry = sets.head[s]
    sets.head[s], sets.held[s] = MISSING, 0
    while entry != MISSING:
        following = sets.after[entry]
        if _has(sets, into, sets.value[entry]):
            _free(sets, entry)
        else:
            _add(sets, into, entry)
        entry = following
