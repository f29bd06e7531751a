"""What moves a robot: a gait, random actions, or a policy of a run, each as a function of the engine."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import evogymcm
from evogymcm._messages import brief
from evogymcm.body import Body
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.gaits import sine_gait
from evogymcm.envs.task import Task
from evogymcm.sim.constants import ACTUATION_HIGH, ACTUATION_LOW, STIFFNESS_HIGH, STIFFNESS_LOW

if TYPE_CHECKING:  # robots move without torch
    from evogymcm.algos.learning.playing import Gait
    from evogymcm.algos.runs.policies import SavedPolicy

BASELINE, SINE, RANDOM, STILL = "baseline", "sine", "random", "still"
Made = tuple[TaskEngine, "Gait"]


class RandomActions:
    """A gait of independent random numbers, each from its whole range.

    Args:
        seed: Where they come from.
    """

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def __call__(self, engine: TaskEngine) -> tuple[np.ndarray, np.ndarray | None]:
        """Returns (N, V) actuation, and stiffness in the reactive setting."""
        shape = engine.occupancy.shape
        actuation = self._rng.uniform(ACTUATION_LOW, ACTUATION_HIGH, shape)
        if engine.material != "reactive":
            return actuation, None
        return actuation, self._rng.uniform(STIFFNESS_LOW, STIFFNESS_HIGH, shape)


def stand_still(engine: TaskEngine) -> tuple[np.ndarray, np.ndarray | None]:
    """Returns neutral actions."""
    ones = np.ones(engine.occupancy.shape)
    return ones, ones if engine.material == "reactive" else None


class Driver:
    """What moves robots in a task, whatever they are.

    Args:
        policy: "sine", "random", "still", "baseline", the folder of a run, one of its files, a file of gaits (.json)
            with one in it or the folder of an evolution, or a `SavedPolicy`.
        task: The task.
        material: "invariant" or "reactive".

    Attributes:
        saved: The policy, where it is one of a run.

    Raises:
        ValueError: There is no such policy, or it was trained in the other setting.
    """

    def __init__(self, policy: Any, task: Task, material: str) -> None:
        from evogymcm.algos.gaits.stored import gaits_in

        self.task, self.material = task, material
        self.saved: SavedPolicy | None = None
        self._gait: Callable[[int], Gait] | None = None
        if policy == BASELINE:
            self._baseline = _find_baseline(task, material)
        elif isinstance(policy, str) and policy in _GAITS:
            self._gait = _GAITS[policy]
        elif isinstance(policy, str | os.PathLike) and (gaits := gaits_in(policy)) and gaits.is_file():
            self._gait = _load_gait(gaits, material)
        else:
            self.saved = _load(policy, material)

    def make(self, body: Body, stiffness: np.ndarray | None, seed: int) -> Made:
        """Returns one world with a design in it, before its first episode, and what moves it.

        Args:
            body: The body.
            stiffness: (rows, columns) its field; None for 1, and in the reactive setting.
            seed: Of all that the world and the gait draw.

        Raises:
            ValueError: The design is not valid or does not fit, or the policy takes other observations.
        """
        field = None if stiffness is None else [stiffness]
        options: dict[str, Any] = {"num_threads": 1, "seed": seed}
        if self._gait is not None:
            options |= {"material": self.material, "stiffness": field, "with_voxels": False}
            return TaskEngine(self.task, [body], **options), self._gait(seed)
        from evogymcm.algos.learning.playing import as_gait

        if self.saved is not None:
            env = self.saved.make_env(1, task=self.task, bodies=[body], stiffness=field, **options)
            module = self.saved.module(env)
        else:
            from evogymcm.envs import SoftRobotEnv

            env = SoftRobotEnv(self.task, [body], material=self.material, stiffness=field, **options)
            module = self._baseline
            module.columns = env.grid_shape[1]
        return env.engine, as_gait(module)


_GAITS: dict[str, Callable[[int], Any]] = {
    SINE: lambda seed: sine_gait,
    RANDOM: RandomActions,
    STILL: lambda seed: stand_still,
}


def _load(policy: Any, material: str) -> "SavedPolicy":
    if isinstance(policy, str | os.PathLike):
        if not Path(policy).exists():
            names = ", ".join((*_GAITS, BASELINE))
            raise ValueError(f"policy: got {brief(str(policy))}, neither of {names} nor a run's folder or file")
        from evogymcm.algos.runs.policies import load_policy

        policy = load_policy(Path(policy))
    saved = getattr(policy, "material", None)
    if saved is None:
        raise ValueError(f"policy: got {brief(policy)}, expected a name, a path or a SavedPolicy")
    if saved != material:
        raise ValueError(f"material: got {material!r}, the policy was trained with {saved!r}")
    return policy


def _load_gait(path: Path, material: str) -> Callable[[int], Any]:
    from evogymcm.algos.gaits.stored import load_gaits

    saved = load_gaits(path)
    if len(saved.bodies) != 1:
        raise ValueError(f"policy: {path} holds gaits of {len(saved.bodies)} bodies, expected one")
    if saved.material != material:
        raise ValueError(f"material: got {material!r}, the gait was found with {saved.material!r}")
    return lambda seed: saved.waves


def _find_baseline(task: Task, material: str) -> Any:
    find = getattr(evogymcm, BASELINE, None)
    if find is None:
        raise ValueError(f"policy: got {BASELINE!r}, but this release comes without trained policies")
    return find(task.id, material)
