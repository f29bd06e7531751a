"""Bodies that policies are trained on: texts that mean the same wherever a run is looked at, and random ones."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from evogymcm._messages import brief
from evogymcm.body import Body, as_body, is_body_file, robot_tasks, sample_body
from evogymcm.envs.dealing import as_bodies

N_HELD_OUT = 64  # bodies that tell what a policy is worth on those that it has not seen
_HELD_OUT_SEED = 987_654_321
_POOL_SEED = 123_456_789
STANDARD_BODY = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"


def as_texts(bodies: Any) -> tuple[str, ...]:
    """Returns a body or several as texts: each rows of voxels, or a name or path as it is.

    Args:
        bodies: What `as_bodies` takes, or nothing; of texts each is a body.

    Raises:
        ValueError: One is no body, or its connections cannot be written as rows.
    """
    if is_body_file(bodies) or isinstance(bodies, str):
        bodies = [bodies]
    is_plain = isinstance(bodies, list | tuple) and all(isinstance(body, str) or is_body_file(body) for body in bodies)
    return tuple(map(_as_text, bodies if is_plain else as_bodies(bodies)))


def _as_text(body: str | os.PathLike[str] | Body) -> str:
    if not isinstance(body, Body):
        text = os.fspath(body)
        if not is_body_file(text):
            as_body(text)  # is there such a robot?
        return text
    if not body.has_default_connections:
        raise ValueError(f"bodies: {brief(body)} has connections of its own; save it as .npz and give the file's path")
    return body.text


def written_out(text: str) -> str:
    """Returns a file's body as rows; other texts, and a file whose connections cannot be written so, as they are."""
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


@dataclass(frozen=True)
class RandomBodies:
    """A stream of random bodies: what `bodies=` of an environment takes as a function that draws one.

    Attributes:
        shape: Rows and columns.
        stiffness: That of all voxels; None for 1, or where the policy sets it.
        pool: How many different bodies there are, the same in every run, those of smaller pools among them; None for a
            fresh one each time.
    """

    shape: tuple[int, int]
    stiffness: float | None = None
    pool: int | None = None

    @cached_property
    def _bodies(self) -> list[Body]:
        rng = np.random.default_rng(_POOL_SEED)
        return [sample_body(self.shape, rng) for _ in range(self.pool or 0)]

    def __call__(self, rng: np.random.Generator) -> Body | tuple[Body, np.ndarray]:
        """Returns a body, with its stiffness field where there is one."""
        body = sample_body(self.shape, rng) if self.pool is None else self._bodies[rng.integers(self.pool)]
        return body if self.stiffness is None else (body, np.where(body.occupancy, self.stiffness, 1.0))


def held_out_bodies(shape: tuple[int, int], count: int = N_HELD_OUT) -> list[Body]:
    """Returns random bodies that are the same in every run, drawn from a seed that no training uses."""
    rng = np.random.default_rng(_HELD_OUT_SEED)
    return [sample_body(shape, rng) for _ in range(count)]
