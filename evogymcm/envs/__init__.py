"""Environments: one batched task engine, and thin adapters to TorchRL, Gymnasium and PettingZoo.

The names below are imported when they are first used, so that Gymnasium users need no torch.
"""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "benchmarl": ["BenchMARLTask"],
        "core": ["TaskEngine"],
        "gaits": ["sine_gait"],
        "gymnasium": ["GymnasiumEnv", "GymnasiumVectorEnv"],
        "options": ["EngineOptions", "WorldOptions"],
        "pettingzoo": ["BodiesParallelEnv", "parallel_env"],
        "population": ["PopulationEnv", "population_env"],
        "render.renderer": ["Renderer"],
        "render.video": ["write_picture", "write_video"],
        "sb3": ["SB3VecEnv"],
        "task": ["Snapshot", "Task", "Window"],
        "tasks": ["as_task"],
        "terrain": ["walking_task"],
        "torchrl": ["SoftRobotEnv"],
    },
)
