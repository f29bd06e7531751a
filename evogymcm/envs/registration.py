"""Gymnasium ids: every task as `evogymcm/ID`. Imports neither torch nor numba."""

import gymnasium

from evogymcm.envs.task import Task

NAMESPACE = "evogymcm"


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
