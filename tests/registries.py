"""Tasks of the tests' own, which other tests must not see: some walk the registries."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import gymnasium

from evogymcm import register_task
from evogymcm.envs import Task
from evogymcm.envs import tasks as task_package


@contextmanager
def own_registries() -> Iterator[None]:
    """Puts back what is registered, here and with Gymnasium, as it was before."""
    kept = [(registry, dict(registry)) for registry in (task_package._REGISTRY, gymnasium.registry)]
    try:
        yield
    finally:
        for registry, before in kept:
            registry.clear()
            registry.update(before)


@contextmanager
def registered(task) -> Iterator[str]:
    """Registers a task for a while, and gives its id."""
    with own_registries():
        register_task(task)
        yield task.id


def shorten(name: str, time_limit: int) -> None:
    """Shortens a task of the package where it is meant by its id, for tests with registries of their own."""
    task_package._REGISTRY[name] = replace(task_package.tasks[name], time_limit=time_limit)


@dataclass(frozen=True)
class Sprint(Task):
    """Get far in a time so short that whole runs take a second."""

    goal: float = 3.0

    def reward(self, before, after):
        return 1000 * (after.x - before.x)  # millimetres: 12 env-steps are not far

    def score_ceiling(self, start):
        return 1000 * (self.goal - start.x)
