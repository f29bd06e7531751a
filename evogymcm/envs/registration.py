"""Gymnasium ids: every task as `evogymcm/ID`. Imports neither torch nor numba."""

import copy
from collections.abc import Mapping
from dataclasses import fields
from enum import Enum
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec

from evogymcm.body import Body
from evogymcm.envs.task import Task

NAMESPACE = "evogymcm"


class TaskSpec(EnvSpec):
    """A Gymnasium spec that can be written as JSON where its arguments are bodies, arrays or tasks."""

    @classmethod
    def of(cls, spec: EnvSpec) -> "TaskSpec":
        """Returns the spec as one of these."""
        return cls(**{field.name: getattr(spec, field.name) for field in fields(spec) if field.init})

    def to_json(self) -> str:
        """Returns the spec as JSON; `gymnasium.make(EnvSpec.from_json(text))` makes the same environment again."""
        plain = copy.copy(self)
        plain.kwargs = _plain_arguments(self.kwargs)
        return super(TaskSpec, plain).to_json()


class Described:
    """Keeps an environment's spec, which `gymnasium.make` sets, in a form that can be written as JSON."""

    _spec: TaskSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The arguments to `gymnasium.make` that made the environment; None where its class was called."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = None if spec is None else TaskSpec.of(spec)


def _plain_arguments(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Returns an environment's arguments as plain values that mean the same."""
    plain = {name: _plain(value) for name, value in arguments.items()}
    body = arguments.get("body")
    first = body[0] if isinstance(body, list | tuple) and body else body  # several are equal, or there is no such world
    if isinstance(first, Body) and not first.has_default_connections and arguments.get("connections") is None:
        plain["connections"] = first.connections.tolist()
    return plain


def _plain(value: Any) -> Any:
    if isinstance(value, Body):
        return value.text
    if isinstance(value, Task):
        return value.id
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def register_gymnasium(task: Task) -> None:
    """Registers a task for `gymnasium.make` and `gymnasium.make_vec`; once is enough, again does nothing."""
    name = f"{NAMESPACE}/{task.id}"
    if name not in gymnasium.registry:
        gymnasium.register(
            name,
            entry_point="evogymcm.envs.gymnasium:GymnasiumEnv",
            vector_entry_point="evogymcm.envs.gymnasium:GymnasiumVectorEnv",
            max_episode_steps=task.time_limit,
            kwargs={"task": task},  # not its id, which means nothing in a process that has not registered it
        )
        spec = TaskSpec.of(gymnasium.registry[name])
        if spec.version:
            # Climber-v1 is another task than Climber-v0, as in EvoGym, and not a newer one: were the number a version
            # to Gymnasium, it would warn that v0 is out of date. So it is a part of the name.
            spec.name, spec.version = task.id, None
        gymnasium.registry[name] = spec
