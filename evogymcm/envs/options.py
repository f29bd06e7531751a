"""The options that environments take by name: one list, with one default each, for all constructors."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any, TypedDict, TypeVar, get_args

import numpy as np

from evogymcm._messages import brief
from evogymcm._settings import WorkWeight, check_choice, check_count
from evogymcm.envs.dealing import MATERIALS
from evogymcm.sim.constants import Physics

Constructor = TypeVar("Constructor", bound=Callable[..., None])


class WorldOptions(TypedDict, total=False):
    """Options that every environment takes by name.

    Attributes:
        material: "invariant" (stiffness belongs to the body; the default) or "reactive" (stiffness is part of every
            action).
        stiffness: Invariant setting only: a field in [0.5, 2] of the body's shape, or one for each body, as a list
            (None for a body without one) or as an array (n, rows, cols). None, the default, is 1 everywhere: plain
            EvoGym. A stream of bodies returns it with each body.
        edge_rule: How stiffness acts on shared edges: "mean_factor" (the paper's equation; the default) or
            "mean_stiffness" (the reference code of the invariant setting), see `evogymcm.sim.Scenery`.
        physics: Constants of the simulator, or a mapping of those that differ from the benchmark's; the benchmark's by
            default.
        num_threads: Threads of the simulator, without effect on any result; all cores by default.
        grid_shape: (rows, columns) of the padded grid; the smallest that holds all bodies by default. Required
            with a stream; a larger grid leaves room for later bodies.
        work_weight: What a unit of supplied work costs in reward: a number for the work of actuation and of stiffness
            alike, or a pair of numbers; 0 has it measured only. None, the default, does not measure work. Scores and
            returns remain those of the task.
    """

    material: str
    stiffness: np.ndarray | Sequence[Any] | None
    edge_rule: str
    physics: Physics | Mapping[str, float] | None
    num_threads: int | None
    grid_shape: tuple[int, int] | None
    work_weight: WorkWeight


class EngineOptions(WorldOptions, total=False):
    """Options that `TaskEngine` and its environments take by name.

    Gymnasium's environments take all but the seed, which they take in `reset`.

    Attributes:
        seed: Seed of random resets and of streams: one for each world, or the first, from which the others count up (0
            by default). None takes seeds from the operating system.
    """

    seed: int | Sequence[int | None] | None


DEFAULTS: EngineOptions = {
    "material": "invariant",
    "stiffness": None,
    "edge_rule": "mean_factor",
    "physics": None,
    "num_threads": None,
    "grid_shape": None,
    "work_weight": None,
    "seed": 0,
}


def complete(options: EngineOptions) -> EngineOptions:
    """Returns options with the defaults of those that were not given.

    Raises:
        TypeError: There is no option of that name.
        ValueError: There is no such material.
    """
    unknown = [name for name in options if name not in DEFAULTS]
    if unknown:
        raise TypeError(f"got an unexpected keyword argument {unknown[0]!r}, the options are {list(DEFAULTS)}")
    chosen = DEFAULTS | options
    check_choice("material", chosen["material"], MATERIALS)
    if chosen["num_threads"] is not None:
        chosen["num_threads"] = check_count("num_threads", chosen["num_threads"])
    return chosen


def as_physics(physics: Physics | Mapping[str, float] | None) -> Physics | None:
    """Returns constants that may be given by name, those that differ; ValueError for an unknown one."""
    if physics is None or isinstance(physics, Physics):
        return physics
    if not isinstance(physics, Mapping):
        raise ValueError(f"physics: got {brief(physics)}, expected Physics, or those constants that differ by name")
    known = [field.name for field in fields(Physics)]
    unknown = [name for name in physics if name not in known]
    if unknown:
        raise ValueError(f"physics: got {brief(unknown)}, known are {known}")
    return Physics(**physics)


def lists_options(init: Constructor) -> Constructor:
    """Shows in a constructor's signature what it takes as `**options`, with the defaults: for `help` and completion."""
    signature = inspect.signature(init)
    *own, rest = signature.parameters.values()
    (options,) = get_args(rest.annotation)
    by_name = inspect.Parameter.KEYWORD_ONLY
    listed = [
        inspect.Parameter(name, by_name, default=default, annotation=options.__annotations__[name])
        for name, default in DEFAULTS.items()
        if name in options.__annotations__
    ]
    first = [parameter for parameter in own if parameter.kind is not by_name]
    vars(init)["__signature__"] = signature.replace(parameters=[*first, *listed, *own[len(first) :]])
    return init
