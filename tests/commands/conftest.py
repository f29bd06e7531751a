"""A task whose episodes are so short that whole commands run in a second."""

from dataclasses import dataclass

import gymnasium
import pytest

from evogymcm.envs import Task, register_task
from evogymcm.envs import tasks as task_package


@dataclass(frozen=True)
class Sprint(Task):
    """Get far in a short time."""

    goal: float = 3.0

    def reward(self, before, after):
        return 1000 * (after.x - before.x)  # millimetres: 12 env-steps are not far

    def score_ceiling(self, start):
        return 1000 * (self.goal - start.x)


@pytest.fixture
def sprint(tmp_path, monkeypatch):
    """The task's id, while it is registered; runs go to a folder of the test's own."""
    before, before_gymnasium = dict(task_package._REGISTRY), dict(gymnasium.registry)
    observes = ("velocity", "orientation", "relative")
    register_task(Sprint("Sprint-v0", world="Walker-v0", spawn=(1, 1), time_limit=12, observes=observes))
    monkeypatch.chdir(tmp_path)
    yield "Sprint-v0"
    task_package._REGISTRY.clear()
    task_package._REGISTRY.update(before)
    gymnasium.registry.clear()
    gymnasium.registry.update(before_gymnasium)
