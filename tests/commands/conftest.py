"""A task whose episodes are so short that whole commands run in a second."""

from dataclasses import dataclass

import pytest

from evogymcm.envs import Task
from tests.registries import registered


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
    monkeypatch.chdir(tmp_path)
    observes = ("velocity", "orientation", "relative")
    task = Sprint("Sprint-v0", world="Walker-v0", spawn=(1, 1), time_limit=12, observes=observes)
    with registered(task) as name:
        yield name
