"""The tasks by id. A new one is one module here, or any `Task` given to `register_task`."""

from collections.abc import Mapping
from types import MappingProxyType

from evogymcm.envs.registration import register_gymnasium
from evogymcm.envs.task import Task
from evogymcm.envs.tasks import climbing, manipulation, shape, stunts, walking

_MODULES = (walking, shape, manipulation, climbing, stunts)
_REGISTRY: dict[str, Task] = {}

tasks: Mapping[str, Task] = MappingProxyType(_REGISTRY)


def register_task(task: Task) -> Task:
    """Adds a task under its id, here and as `evogymcm/ID` in Gymnasium, and returns it.

    Raises:
        ValueError: Where the id is taken by a different task.
    """
    if _REGISTRY.get(task.id, task) != task:
        raise ValueError(f"task id {task.id!r} is taken")
    _REGISTRY[task.id] = task
    register_gymnasium(task)
    return task


def as_task(spec: str | Task) -> Task:
    """Returns the task of that id, or the task itself.

    Raises:
        ValueError: For an unknown id.
    """
    if isinstance(spec, Task):
        return spec
    if spec not in _REGISTRY:
        raise ValueError(f"task: got {spec!r}, known are {', '.join(sorted(_REGISTRY))}")
    return _REGISTRY[spec]


for _module in _MODULES:
    for _task in _module.TASKS:
        register_task(_task)

__all__ = ["Task", "as_task", "register_task", "tasks"]
