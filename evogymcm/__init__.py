"""2-D voxel soft robots whose bodies, materials and control can be learned and evolved together.

Importing the package registers the tasks with Gymnasium, and imports neither torch nor numba.
"""

from evogymcm.algos.baselines import baseline, baselines
from evogymcm.body import (
    Body,
    as_body,
    check_stiffness,
    mutate_body,
    robot_tasks,
    robots,
    sample_body,
)
from evogymcm.envs.tasks import register_task, tasks

__version__ = "0.2.0"

__all__ = [
    "Body",
    "as_body",
    "baseline",
    "baselines",
    "check_stiffness",
    "mutate_body",
    "register_task",
    "robot_tasks",
    "robots",
    "sample_body",
    "tasks",
]
