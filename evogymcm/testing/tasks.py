"""The contract of tasks."""

import pickle
from typing import Any

import numpy as np

from evogymcm.envs.core import TaskEngine
from evogymcm.envs.dealing import BodySpec
from evogymcm.envs.task import Task
from evogymcm.envs.tasks import as_task
from evogymcm.testing._generators import global_generators

_N_WORLDS, _ALL = 3, slice(None)
_SHOWN = ("flat", "features", "reward", "score", "returns", "length", "terminated", "truncated", "unstable", "reached")


def check_task(task: str | Task, body: BodySpec = "HVH/S.R", *, steps: int = 8, seed: int = 0) -> None:
    """Raises an error for mistakes in a task that would otherwise show late, or only as wrong numbers.

    It checks the task's fields (time limit, spawn place, names of objects, windows and observations); that its methods
    return finite numbers with one row for each world; that episodes draw from the given generator only, and equally
    from equal seeds; that a world behaves the same alone and beside others, some of which restart in between; and that
    a restored state continues like the original. Making an environment already checks parts of the first two.

    Args:
        task: A task or its id.
        body: A body that fits into the world; the more of the task it meets in a few env-steps, the better.
        steps: Number of env-steps, with random actions.
        seed: Seed of the actions and of the task's random draws.

    Raises:
        ValueError: The task has a mistake; the message says which.
    """
    task = as_task(task)
    batch = TaskEngine(task, body, _N_WORLDS, material="reactive", num_threads=1, seed=seed)
    _check_draws(task, seed)
    singles = [
        TaskEngine(task, body, 1, material="reactive", num_threads=1, seed=seed + world) for world in range(_N_WORLDS)
    ]
    resumed, halfway = TaskEngine(task, body, _N_WORLDS, material="reactive", num_threads=1, seed=seed + 99), steps // 2
    others: dict[str, tuple[TaskEngine, Any]] = {f"world {i} alone": (one, [i]) for i, one in enumerate(singles)}
    rng = np.random.default_rng(seed)
    for step in range(steps):
        if step == halfway:
            resumed.set_state(pickle.loads(pickle.dumps(batch.state())))
            _compare(task, "a saved state", resumed, batch, _ALL, step)
            others["a world that goes on from a saved state"] = resumed, _ALL
        shape = batch.occupancy.shape
        actions = rng.uniform(0.6, 1.6, shape), rng.uniform(0.5, 2.0, shape)
        batch.step(*actions)
        for what, (engine, rows) in others.items():
            engine.step(*(values[rows] for values in actions))
            _compare(task, what, engine, batch, rows, step)
        _check_finite(task, batch, step)
        again = batch.terminated | batch.truncated | (np.arange(_N_WORLDS) == step % (_N_WORLDS + 1))
        batch.reset(again)
        for what, (engine, rows) in others.items():
            engine.reset(again[rows])
            _compare(task, what, engine, batch, rows, step)


def _check_draws(task: Task, seed: int) -> None:
    """Checks that draws depend on their generator alone."""
    before = global_generators()
    first, again = (task.draw(np.random.default_rng(seed)) for _ in range(2))
    if before != global_generators():
        raise ValueError(f"task {task.id!r}: draw: it uses a global generator; draw from `rng` only")
    for name, value in first.items():
        if not np.array_equal(value, again[name]):
            raise ValueError(
                f"task {task.id!r}: draw: {name!r} is {value!r}, then {again[name]!r} from the same seed; "
                "draw from `rng` only"
            )


def _compare(task: Task, what: str, got: TaskEngine, batch: TaskEngine, rows: Any, step: int) -> None:
    for name in _SHOWN:
        one, other = np.asarray(getattr(got, name)), np.asarray(getattr(batch, name))[rows]
        if not np.array_equal(one, other, equal_nan=True):
            got_and_expected = f"{one.tolist()}, the batch of {_N_WORLDS} {other.tolist()}"
            raise ValueError(
                f"task {task.id!r}: {name!r} differs in env-step {step + 1}: {what} shows {got_and_expected}. "
                "What a method returns must depend on its arguments alone, and each row on the world's own"
            )


def _check_finite(task: Task, engine: TaskEngine, step: int) -> None:
    values = {"reward": engine.reward} | task.observation(engine.snapshot)
    for name, value in values.items():
        if not np.isfinite(value).all():
            raise ValueError(f"task {task.id!r}: {name!r} is {value.tolist()} in env-step {step + 1}, not finite")
