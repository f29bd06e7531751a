"""Environments: one batched task engine, and thin adapters to TorchRL, Gymnasium and PettingZoo.

The names below are imported when they are first used, so that Gymnasium users need no torch.
"""

from importlib import import_module
from typing import Any

_HOME = {
    "SoftRobotEnv": "evogymcm.envs.torchrl",
    "TaskEngine": "evogymcm.envs.core",
    "PopulationEnv": "evogymcm.envs.population",
    "population_env": "evogymcm.envs.population",
    "BodiesParallelEnv": "evogymcm.envs.pettingzoo",
    "parallel_env": "evogymcm.envs.pettingzoo",
    "Renderer": "evogymcm.envs.render",
    "sine_gait": "evogymcm.envs.gaits",
    "write_picture": "evogymcm.envs.video",
    "write_video": "evogymcm.envs.video",
    "GymnasiumEnv": "evogymcm.envs.gymnasium",
    "GymnasiumVectorEnv": "evogymcm.envs.gymnasium",
    "SB3VecEnv": "evogymcm.envs.sb3",
    "Task": "evogymcm.envs.task",
    "Window": "evogymcm.envs.task",
    "Snapshot": "evogymcm.envs.task",
    "as_task": "evogymcm.envs.tasks",
    "register_task": "evogymcm.envs.tasks",
    "walking_task": "evogymcm.envs.terrain",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
