"""Walking in worlds of your own: a task made from a world alone."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from evogymcm.envs.task import Window
from evogymcm.envs.tasks.walking import Walking
from evogymcm.sim.constants import VOXEL
from evogymcm.sim.world import World

_DEFAULTS: dict[str, Any] = {
    "time_limit": 500,
    "observes": ("velocity", "orientation", "relative", "floor"),  # what EvoGym's walkers on terrain observe
    "lowest_y": 0.0,  # below all cells: the robot has fallen out of the world
}


def walking_task(
    world: World | str | os.PathLike[str],
    spawn: tuple[int, int] | None = None,
    *,
    room: tuple[int, int] = (5, 5),
    **fields: Any,
) -> Walking:
    """Returns the task to walk to the right in a world.

    The goal is one cell before the right end of the world's objects and gives a bonus of 1; falling out of the world
    costs 3. Both end the episode, which lasts 500 env-steps at most.

    Args:
        world: The world, the name of one of the package, or a file, see `World.load`. A robot in it is removed.
        spawn: World cell of the lower-left cell of the body array. By default where the world's own robot stands, or
            in column 1, at the lowest height with a voxel right below and room above.
        room: Rows and columns that must be free there.
        fields: Other fields of `Walking`: id, time_limit, observes, floor, ceiling, gain, goal_x, goal_bonus and so on.

    Raises:
        ValueError: The world cannot be read, or has no room for the robot.
    """
    name = "Walking" if isinstance(world, World) else Path(world).stem
    world = world if isinstance(world, World) else World.load(world)
    robot = world.find_robot()
    if robot is not None:
        world = world.without(robot.name)
    if spawn is None:
        spawn = robot.origin if robot is not None else _find_room(world, room)
    given = _DEFAULTS | {"id": name, "floor": Window(tuple(obj.name for obj in world.objects))} | fields
    if world.objects:
        given = {"goal_x": VOXEL * (max(obj.end[0] for obj in world.objects) - 1)} | given
    return Walking(world=world, spawn=spawn, **given)


def _find_room(world: World, room: tuple[int, int]) -> tuple[int, int]:
    """Returns the lowest cell of column 1 with voxels right below and so much free room above."""
    rows, columns = room
    top, right = max((obj.end[1] for obj in world.objects), default=0), 1 + columns
    taken = np.zeros((top + rows, max(world.width, right)), bool)
    for obj in world.objects:
        (x, y), (end_x, end_y) = obj.origin, obj.end
        taken[y:end_y, x:end_x] |= obj.grid[::-1] != 0
    for y in range(1, top + 1):
        if taken[y - 1, 1:right].any() and not taken[y : y + rows, 1:right].any():
            return 1, y
    raise ValueError(f"world: no {rows} x {columns} cells from column 1 on are free above a voxel, give spawn=(x, y)")
