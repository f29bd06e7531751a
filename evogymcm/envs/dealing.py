"""Designs as they are given: bodies and stiffness fields, checked, and dealt to worlds on the padded grid."""

import os
from collections.abc import Sequence
from operator import index
from typing import Any, get_args

import numpy as np

from evogymcm._messages import brief
from evogymcm._settings import Material
from evogymcm.body import Body, as_body, check_stiffness, is_body_text
from evogymcm.envs import checks
from evogymcm.envs.task import Task
from evogymcm.sim.world import ROBOT, World, WorldObject

MATERIALS = get_args(Material)

BodySpec = Body | str | os.PathLike[str] | np.ndarray | Sequence[Any]


def as_bodies(bodies: Any) -> list[Body]:
    """Returns the bodies of one body or of several.

    One body is anything that `as_body` takes. Whatever is made of rows is one body: a list of texts of one row each,
    or of sequences of codes. Other lists, and arrays of shape (n, rows, cols), are several.

    Raises:
        ValueError: For an empty list, a body that is not valid, and a stream.
    """
    if isinstance(bodies, Body | str | os.PathLike):
        return [as_body(bodies)]
    if callable(bodies) or hasattr(bodies, "__next__"):
        raise ValueError(
            f"bodies: got {brief(bodies)}, a stream, which TaskEngine, SoftRobotEnv and population_env take; a list is "
            "needed here"
        )
    try:
        items = list(np.asarray(bodies) if hasattr(bodies, "__array__") else bodies)
    except TypeError:
        raise ValueError(f"bodies: got {brief(bodies)}, expected a body or a list of bodies") from None
    if not items:
        raise ValueError("bodies: got none, at least one is needed")
    if all(is_row(item) for item in items):
        try:
            return [as_body(items)]
        except ValueError as error:
            raise ValueError(
                f"{error} (a list of rows is one body; one-row bodies are given as Body objects)"
            ) from error
    return [as_body(item) for item in items]


def is_row(item: Any) -> bool:
    """Returns whether something is one row of a body: cells in a text without '/', or codes."""
    if isinstance(item, str):
        return is_body_text(item) and "/" not in item.strip() and "\n" not in item.strip()
    return isinstance(item, list | tuple | np.ndarray) and all(
        _ndim(cell) == 0 and not isinstance(cell, str | Body) for cell in item
    )


def _ndim(value: Any) -> int:
    """Returns how deep sequences are nested, of whatever and however unequal."""
    return np.asarray(value, object).ndim


def check_grid_shape(grid_shape: Any, designs: Sequence[Body] | None = None) -> tuple[int, int]:
    """Returns (rows, columns) of the padded grid: those given, else the smallest that holds all bodies.

    Raises:
        ValueError: They are not two whole numbers of at least 1, hold not every body, or are needed, since bodies are
            not known beforehand (`designs` is None), and not given.
    """
    needed = (1, 1) if designs is None else (max(body.rows for body in designs), max(body.cols for body in designs))
    if grid_shape is None:
        if designs is None:
            raise ValueError("grid_shape: a stream of bodies (an iterator or a callable) needs it: (rows, columns)")
        return needed
    try:
        rows, columns = (index(number) for number in grid_shape)
    except (TypeError, ValueError):
        raise ValueError(f"grid_shape: got {brief(grid_shape)}, expected (rows, columns)") from None
    if rows < needed[0] or columns < needed[1]:
        which = "" if designs is None else " for these bodies"
        raise ValueError(f"grid_shape: got {(rows, columns)}, at least {needed} is needed{which}")
    return rows, columns


class Start:
    """Where bodies start in the world of a task.

    Args:
        task: The task.

    Raises:
        ValueError: The task has mistakes in its fields, or names what its world lacks.
    """

    def __init__(self, task: Task) -> None:
        with checks.blaming(task):
            world = task.world if isinstance(task.world, World) else World.load(task.world)
            checks.check_fields(task, world)
        self._task, self._world = task, world
        self._fitting: set[tuple[int, int]] = set()

    def scenes(self, bodies: Sequence[Body]) -> list[tuple[WorldObject, ...]]:
        """Returns what stands in the world of each body, the robot first; equal bodies share one tuple."""
        others = self._world.simulation_order()
        scenes = {body: (self.robot(body), *others) for body in dict.fromkeys(bodies)}
        return [scenes[body] for body in bodies]

    def robot(self, body: Body) -> WorldObject:
        """Returns a body as it starts; ValueError where it does not fit in, which its shape alone decides."""
        connections = None if body.has_default_connections else body.connections
        robot = WorldObject(ROBOT, body.grid, self._task.spawn, connections)
        if body.shape not in self._fitting:
            try:
                self._world.place(robot)
            except ValueError as error:
                raise ValueError(f"body {brief(body.text)} does not fit in {self._task.id}: {error}") from error
            self._fitting.add(body.shape)
        return robot


def on_grid(values: np.ndarray, grid_shape: tuple[int, int], fill: Any) -> np.ndarray:
    """Returns (V,) a body's (rows, columns) values in the upper left corner of the padded grid, `fill` elsewhere."""
    grid = np.full(grid_shape, fill, values.dtype)
    grid[: values.shape[0], : values.shape[1]] = values
    return grid.ravel()


def deal_fields(
    stiffness: Any, designs: Sequence[Body], material: str, n_worlds: int, grid_shape: tuple[int, int]
) -> np.ndarray | None:
    """Returns (N, V) stiffness fields of the worlds, dealt like the bodies; None for 1 everywhere.

    Args:
        stiffness: None, a field of the one body's shape, or as many fields as bodies: a list, which may hold None, or
            an array of shape (n, rows, cols).
        designs: The bodies.
        material: "invariant" or "reactive".
        n_worlds: N.
        grid_shape: (rows, columns) of the padded grid.

    Raises:
        ValueError: Where fields are given in the reactive setting, are not as many as bodies, or are not valid.
    """
    if stiffness is None:
        return None
    if material == "reactive":
        raise ValueError("stiffness: in the reactive setting it is part of the action and cannot be given here")
    given = _as_fields(stiffness)
    if len(given) != len(designs):
        raise ValueError(
            f"stiffness: got {len(given)} field{'s' * (len(given) != 1)}, {len(designs)} bodies need as many: a list "
            "of fields (or None), or an array (n, rows, cols)"
        )
    fields = [on_grid(check_stiffness(f, body), grid_shape, 1.0) for f, body in zip(given, designs, strict=True)]
    return np.stack([fields[i % len(fields)] for i in range(n_worlds)])


def _as_fields(stiffness: Any) -> list[Any]:
    """Returns the fields of one or of several."""
    values = np.asarray(stiffness) if hasattr(stiffness, "__array__") else stiffness
    several = isinstance(values, list | tuple | np.ndarray) and any(_ndim(part) != 1 for part in values)
    return list(values) if several else [values]
