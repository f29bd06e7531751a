"""The tasks by id. A new one is one module here, or any `Task` given to `register_task`."""

import os
import warnings
from collections.abc import Mapping
from types import MappingProxyType

import gymnasium

from evogymcm._messages import brief, known
from evogymcm.envs.registration import NAMESPACE, register_gymnasium
from evogymcm.envs.task import Task
from evogymcm.envs.tasks import climbing, manipulation, shape, stunts, walking
from evogymcm.sim.world import is_world_file

_MODULES = (walking, shape, manipulation, climbing, stunts)
_REGISTRY: dict[str, Task] = {}

tasks: Mapping[str, Task] = MappingProxyType(_REGISTRY)


def register_task(task: Task, *, replace: bool = False) -> Task:
    """Adds a task under its id, here and as `evogymcm/ID` in Gymnasium, and returns it.

    A task of your own replaces an earlier one of the same class (module and name), with a warning, so that a notebook's
    cell may be run again.

    Args:
        task: The task.
        replace: Whether it may replace any other task, without a warning.

    Raises:
        ValueError: The id belongs to a task of the package or of another class, and `replace` is not set.
    """
    former = _REGISTRY.get(task.id)
    if former == task:
        return task
    if former is not None and not replace:
        if task.id in _OWN or _class_of(former) != _class_of(task):
            raise ValueError(
                f"task id {brief(task.id)} is taken by a {_class_of(former)}; choose another, or give replace=True"
            )
        warnings.warn(f"task {brief(task.id)}: its former definition is replaced", stacklevel=2)
    _REGISTRY[task.id] = task
    gymnasium.registry.pop(f"{NAMESPACE}/{task.id}", None)
    register_gymnasium(task)
    return task


def _class_of(task: Task) -> str:
    return f"{type(task).__module__}.{type(task).__qualname__}"


def as_task(spec: str | os.PathLike[str] | Task) -> Task:
    """Returns the task of that id, the task itself, or the one to walk in the world of a file, see `walking_task`.

    Raises:
        ValueError: For an unknown id, or a file that cannot be read.
    """
    if isinstance(spec, Task):
        return spec
    if isinstance(spec, str) and spec in _REGISTRY:
        return _REGISTRY[spec]
    if is_world_file(spec):
        from evogymcm.envs.terrain import walking_task  # which is made of tasks itself

        return walking_task(spec)
    raise ValueError(
        f"task: got {brief(spec)}, known are {known(spec, _REGISTRY)}; a task of your own is known in the process "
        "that registers it, give others the task itself in place of its id"
    )


def own_tasks() -> dict[str, Task]:
    """Returns the package's own tasks by id."""
    return {task.id: task for module in _MODULES for task in module.TASKS}


_OWN: set[str] = set()
for _task in own_tasks().values():
    register_task(_task)
    _OWN.add(_task.id)

__all__ = ["Task", "as_task", "own_tasks", "register_task", "tasks"]
