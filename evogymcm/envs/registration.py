"""Gymnasium ids: every task as `evogymcm/ID`. Imports neither torch nor numba."""

from typing import Any

import gymnasium

from evogymcm.envs.task import Task

NAMESPACE = "evogymcm"


class TaskId(str):
    """An id that brings its task along, into processes that have not registered it; in JSON it is a plain id."""

    __slots__ = ("task",)
    task: Task

    def __new__(cls, task: Task) -> "TaskId":
        """Returns the id of a task."""
        self = super().__new__(cls, task.id)
        self.task = task
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return TaskId, (self.task,)

    def __deepcopy__(self, memo: dict[int, Any]) -> "TaskId":
        return self  # nothing in it changes


def register_gymnasium(task: Task) -> None:
    """Registers a task for `gymnasium.make` and `gymnasium.make_vec`, in the place of what its id stood for."""
    name = f"{NAMESPACE}/{task.id}"
    gymnasium.registry.pop(name, None)  # Gymnasium itself warns of each that is replaced
    gymnasium.register(
        name,
        entry_point="evogymcm.envs.gymnasium:GymnasiumEnv",
        vector_entry_point="evogymcm.envs.gymnasium:GymnasiumVectorEnv",
        max_episode_steps=task.time_limit,
        kwargs={"task": TaskId(task)},
    )
