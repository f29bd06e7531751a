"""Bodies as texts that mean the same wherever and whenever a run is looked at."""

from pathlib import Path
from typing import Any

from evogymcm._messages import brief
from evogymcm.body import Body, as_body, is_body_file, robot_tasks

__all__ = ["STANDARD_BODY", "as_text", "default_body", "written_out"]

STANDARD_BODY = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"


def as_text(body: Any) -> str:
    """Returns anything that `as_body` takes as text: rows of voxels, or a name or path as it is.

    Raises:
        ValueError: It is no body, or its connections cannot be written as rows.
    """
    if isinstance(body, str):
        if not is_body_file(body):
            as_body(body)
        return body
    if is_body_file(body):
        return str(body)
    body = as_body(body)
    if not body.has_default_connections:
        raise ValueError(f"bodies: {brief(body)} has connections of its own; save it as .npz and give the file's path")
    return body.text


def written_out(text: str) -> str:
    """Returns a file's body as rows; other texts, and a file whose connections cannot be written so, as they are.

    Raises:
        ValueError: The file cannot be read.
    """
    if not is_body_file(text):
        return text
    body = as_body(Path(text))
    return body.text if body.has_default_connections else text


def default_body(task: str) -> str:
    """Returns the EvoGymCM paper's robot for a task or that of a world's file, the standard body without either."""
    from evogymcm.sim.world import World, is_world_file  # worlds are needed by files only

    if is_world_file(task) and (robot := World.load(task).find_robot()) is not None:
        body = Body(robot.grid, robot.connections)
        return body.text if body.has_default_connections else task
    return next((robot for robot, own in robot_tasks.items() if own == task), STANDARD_BODY)
