"""What the engine checks: a task's fields, the form of what its methods return, and what a step or a reset is given.

`evogymcm.testing.check_task` says more of a task, and takes longer.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from operator import index
from typing import Any

import numpy as np

from evogymcm._settings import check_count
from evogymcm.envs.task import Snapshot, Task, Window
from evogymcm.sim.constants import H_ACT, V_ACT
from evogymcm.sim.world import ROBOT, World

_KINDS = {"bool": "b", "numbers": "fiub"}  # numpy's codes of the dtypes


@contextmanager
def blaming(task: Task) -> Iterator[None]:
    """Puts the task's id before the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"task {task.id!r}: {error}") from error


def check_fields(task: Task, world: World) -> None:
    """Checks a task's fields, and that its world has what they name.

    Raises:
        ValueError: With the field, what it is, and what is allowed.
    """
    if not isinstance(task.id, str) or not task.id.strip():
        raise ValueError(f"id: got {task.id!r}, expected a name")
    if not isinstance(task.about, str) or "\n" in task.about:
        raise ValueError(f"about: got {task.about!r}, expected a few words in one line")
    _check_whole("time_limit", task.time_limit, 1)
    if not isinstance(task.spawn, tuple | list) or len(task.spawn) != 2:
        raise ValueError(f"spawn: got {task.spawn!r}, expected a world cell (x, y)")
    for number in task.spawn:
        _check_whole("spawn", number, 0)
    names = [obj.name for obj in world.objects]
    for obj in world.objects:
        if obj.name == ROBOT:
            raise ValueError(f"world: it has an object {ROBOT!r}, which is the name of the body; leave it out")
        if H_ACT in obj.grid or V_ACT in obj.grid:
            raise ValueError(
                f"world: object {obj.name!r} has actuators (H or V). EvoGym takes it for a second robot, and here only "
                "the body acts: use S or R cells"
            )
    _check_names("watches", task.watches, [ROBOT, *names])
    _check_names("moves_at_reset", task.moves_at_reset, names)
    for name, window in (("floor", task.floor), ("ceiling", task.ceiling)):
        if window is None:
            continue
        if not isinstance(window, Window):
            raise ValueError(f"{name}: got {window!r}, expected a Window or None")
        _check_names(f"{name}: objects", window.objects, [ROBOT, *names], 1)
        _check_whole(f"{name}: radius", window.radius, 0)
    _check_names("observes", task.observes, None, 1)


def check_windows(task: Task) -> None:
    """Raises ValueError where a window looks at the robot, whose points are others in another body."""
    for name, window in (("floor", task.floor), ("ceiling", task.ceiling)):
        if window is not None and ROBOT in window.objects:
            raise ValueError(f"{name}: objects: a window over the robot itself needs bodies that are and stay equal")


def check_methods(task: Task, start: Snapshot) -> None:
    """Calls a task's methods on the readings at reset, and checks what they return.

    Raises:
        ValueError: With the method or part, what it returned, and what is expected.
    """
    n = len(start.robot.com)
    if type(task).observation is Task.observation:
        parts = task.observation_parts(start)
        for name in task.observes:
            if name not in parts:
                raise ValueError(f"observes: got {name!r}, there is {', '.join(parts)}")
            if parts[name] is None:
                raise ValueError(f"observes: {name!r} is not read; give the task {name}=Window(objects)")
            part = np.asarray(parts[name])
            if part.ndim == 0 or len(part) != n or part.dtype.kind not in "fiub":
                raise ValueError(f"observes: {name!r} is {_form(part)}, expected numbers with {n} rows, one a world")
    with np.errstate(all="ignore"):  # readings at reset may be a case that never comes after a step
        checked_reward(task.reward(start, start), n)
        list(checked_endings(task, start))
        checked_memory(task.remember(start), start.memory)
        ceiling = task.score_ceiling(start)
    if ceiling is not None:
        _rows("score_ceiling", ceiling, n, "numbers")


def checked_reward(reward: Any, n: int) -> np.ndarray:
    """Returns a fresh (N,) float64 of what `Task.reward` returned; ValueError for another form."""
    return _rows("reward", reward, n, "numbers").astype(np.float64)


def checked_endings(task: Task, after: Snapshot) -> Iterator[tuple[np.ndarray, Any, Any]]:
    """Yields each ending: (N,) bool, what it adds to the reward, and whether it is a goal; ValueError for others."""
    n = len(after.robot.com)
    endings = task.endings(after)
    if endings is None:
        raise ValueError("endings: got None, expected (condition, bonus) pairs: `yield` them")
    for ending in endings:
        if not isinstance(ending, tuple) or len(ending) not in (2, 3):
            got = f"a tuple of {len(ending)}" if isinstance(ending, tuple) else type(ending).__name__
            raise ValueError(f"endings: got {got}, expected (condition, bonus) or (condition, bonus, is_goal)")
        condition = _rows("endings: condition", ending[0], n, "bool")
        bonus = ending[1] if isinstance(ending[1], int | float) else _rows("endings: bonus", ending[1], n, "numbers")
        is_goal = bonus > 0 if len(ending) == 2 else ending[2]
        yield condition, bonus, is_goal if isinstance(is_goal, bool) else _rows("endings: is_goal", is_goal, n, "bool")


def checked_memory(values: Any, known: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns what `Task.remember` returned as arrays; ValueError where it is not of the form that was drawn."""
    if not isinstance(values, Mapping):
        raise ValueError(f"remember: got {type(values).__name__}, expected a dict of arrays")
    result = {name: np.asarray(value) for name, value in values.items()}
    for name, value in result.items():
        if name not in known:
            raise ValueError(f"remember: got {name!r}, `draw` has given {', '.join(known) or 'nothing'}")
        if value.shape != known[name].shape:
            raise ValueError(f"remember: {name!r} is {_form(value)}, expected {_form(known[name])}")
    return result


def checked_draw(task: Task, row: Any, known: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns what `Task.draw` drew for one world as arrays.

    Args:
        task: The task.
        row: What it drew.
        known: The memory of all worlds, empty before the first draw.

    Raises:
        ValueError: Where it is no dict of arrays, or not of the form of earlier draws.
    """
    if not isinstance(row, Mapping):
        raise ValueError(f"draw: got {type(row).__name__}, expected a dict of arrays")
    result = {name: np.asarray(value) for name, value in row.items()}
    if known and result.keys() != known.keys():
        raise ValueError(f"draw: got {list(result)}, an earlier draw {list(known)}: every draw needs the same names")
    for name, value in result.items():
        if value.dtype.kind not in "fiub":
            raise ValueError(f"draw: {name!r} is {_form(value)}, expected numbers")
        before = known[name][0] if known else value
        if value.shape != before.shape or not np.can_cast(value.dtype, before.dtype, "same_kind"):
            raise ValueError(f"draw: {name!r} is {_form(value)}, in an earlier draw {_form(before)}")
    if task.moves_at_reset:
        offset = result.get("offset")
        if offset is None or offset.shape != (2,) or (offset != np.round(offset)).any():
            raise ValueError(f"draw: 'offset' is {offset!r}, moves_at_reset needs two whole numbers of voxels")
    return result


def checked_mask(mask: Any, n: int) -> np.ndarray:
    """Returns a mask as (N,) bool; ValueError for other numbers of worlds, and for indices."""
    mask = np.asarray(mask)
    if mask.dtype != bool or mask.size != n:
        raise ValueError(f"mask: got {_form(mask)}, expected bool of shape ({n},)")
    return mask.reshape(n)


def checked_seeds(seed: int | Sequence[int | None] | None, n: int) -> Sequence[int | None]:
    """Returns a seed for each world, one number counted up from; ValueError for another number of seeds."""
    if seed is None:
        return [None] * n
    if isinstance(seed, str | bytes) or not (
        isinstance(seed, Sequence) or (isinstance(seed, np.ndarray) and seed.ndim)
    ):
        first = check_count("seed", seed, 0)
        return [first + world for world in range(n)]
    if len(seed) != n:
        raise ValueError(f"seed: got {len(seed)} seeds, expected one for each of {n} worlds")
    return [None if one is None else check_count("seed", one, 0) for one in seed]


def _rows(name: str, values: Any, n: int, kind: str) -> np.ndarray:
    """Returns values as an array of one number (or bool) a world."""
    result = np.asarray(values)
    if result.shape != (n,) or result.dtype.kind not in _KINDS[kind]:
        got = "None" if values is None else _form(result)
        raise ValueError(f"{name}: got {got}, expected {kind} of shape ({n},), one a world")
    return result


def _form(values: np.ndarray) -> str:
    return f"{values.dtype} of shape {values.shape}"


def _check_whole(name: str, value: Any, least: int) -> None:
    try:
        is_allowed = index(value) >= least
    except TypeError:
        is_allowed = False
    if not is_allowed:
        raise ValueError(f"{name}: got {value!r}, expected a whole number of at least {least}")


def _check_names(field: str, given: Any, allowed: list[str] | None, least: int = 0) -> None:
    """Checks a tuple of names, each there once and among those allowed."""
    if not isinstance(given, tuple | list) or not all(isinstance(name, str) for name in given):
        raise ValueError(f"{field}: got {given!r}, expected a tuple of names")
    if len(given) < least:
        raise ValueError(f"{field}: got none, at least {least} is needed")
    for i, name in enumerate(given):
        if allowed is not None and name not in allowed:
            raise ValueError(f"{field}: got {name!r}, this world has {', '.join(allowed)}")
        if name in given[:i]:
            raise ValueError(f"{field}: got {name!r} twice")
