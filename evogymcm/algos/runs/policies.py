"""Trained policies from run folders, with what they were trained on."""

import pickle
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase

from evogymcm.algos.learning.actor import load_actor
from evogymcm.algos.learning.stacking import PerDesign
from evogymcm.algos.runs.folder import CONFIG, TABLE
from evogymcm.algos.runs.record import NOT_RECORDED, RunRecord
from evogymcm.body import Body, as_body
from evogymcm.envs import SoftRobotEnv

_NAMES = ("final.pt", "best.pt", "codesign.pt")
_CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True, eq=False)
class SavedPolicy:
    """A policy and what its run recorded about it.

    Attributes:
        path: Its file.
        state: What the run saved: the kind of network, and the weights of actor and critic.
        material: The setting that it was trained in.
        task: Id of the task that it was trained on; None if not recorded.
        bodies: The bodies that it was trained on; empty if not recorded.
        stiffness: A field for each of the bodies; None for 1 everywhere, or set by the policy.
        edge_rule: How stiffness acted on shared edges.
    """

    path: Path
    state: Mapping[str, Any] = field(repr=False)
    material: str
    task: str | None
    bodies: tuple[Body, ...]
    stiffness: tuple[np.ndarray, ...] | None
    edge_rule: str

    def make_env(
        self,
        num_worlds: int | None = None,
        *,
        task: Any = None,
        bodies: Sequence[Any] = (),
        stiffness: Sequence[np.ndarray] | None = None,
        **options: Any,
    ) -> SoftRobotEnv:
        """Returns an environment like the one in which the policy was trained.

        Args:
            num_worlds: N; as many as bodies by default.
            task: Another task.
            bodies: Other bodies, with stiffness 1 unless `stiffness` says otherwise.
            stiffness: Other fields, one for each body.
            **options: Other arguments of `SoftRobotEnv`.

        Raises:
            ValueError: The task or bodies are neither given nor recorded, or an argument cannot be used.
        """
        if not (task or self.task):
            raise ValueError(f"task: got none, and {self.path} does not say on which one it was trained")
        if not (bodies or self.bodies):
            raise ValueError(f"bodies: got none, and {self.path} does not say on which one it was trained")
        if stiffness is None and not bodies:
            stiffness = self.stiffness
        fields = None if stiffness is None else list(stiffness)
        settings = {"material": self.material, "stiffness": fields, "edge_rule": self.edge_rule}
        return SoftRobotEnv(task or self.task, list(bodies or self.bodies), num_worlds, **settings, **options)

    def module(self, env: SoftRobotEnv) -> TensorDictModuleBase:
        """Returns the policy as a module that acts in an environment.

        Independent policies act each in their own worlds.

        Raises:
            ValueError: It was trained for other observations, another material or another number of bodies.
        """
        form, copies = self.state["form"], self.state["form"].get("copies")
        name, key, wanted = "task features", "task", form.get("task_features")
        if form["network"] == "mlp":
            name, key, wanted = "flat observation", "observation", form["features"]
        spec = env.observation_spec
        there = spec[key].shape[-1] if key in spec.keys() else None
        if wanted != there:
            raise ValueError(f"policy: takes {wanted} numbers as {name}, {env.task.id} with these bodies has {there}")
        if copies is not None and env.num_designs != copies:
            raise ValueError(f"policy: the run has one for each of {copies} bodies, got {env.num_designs} bodies")
        actor = load_actor(self.state)
        if set(actor.ranges) != set(env.full_action_spec["action"].keys()):
            raise ValueError(f"policy: was trained in the {self.material} setting, the environment has the other one")
        actor.columns = env.grid_shape[1]
        return actor if copies is None else PerDesign(actor, copies)


def load_policy(path: str | Path) -> SavedPolicy:
    """Returns the last policy of a training run, the best design's of a co-design run, or that of one of their files.

    Args:
        path: A run's folder, of this version or an earlier one, or a file in it or alone: `final.pt`, `best.pt`,
            `codesign.pt` (its best design), `policy-0003.pt` (design 3), `checkpoint.pt` (the newest of a training that
            goes on).

    Raises:
        ValueError: There is no policy, or the run's files cannot be read.
    """
    path = Path(path)
    found = next((file for file in (*(path / name for name in _NAMES), path) if file.is_file()), None)
    if found is None:
        raise ValueError(f"policy: {path} has none of {', '.join(_NAMES)}")
    saved, folder = _load(found), found.parent
    run = RunRecord.read(folder) if any((folder / name).is_file() for name in (CONFIG, TABLE)) else None
    row = None
    if found.name == "codesign.pt":
        if saved.get("champion") is None:
            raise ValueError(f"policy: {path} has no trained design yet")
        best = saved["champion"]
        row = best["individual"]
        saved = best.get("policy") or _load(found.with_name(f"policy-{row['index']:04}.pt"))  # first of before
    elif run and run.kind == "codesign" and (number := re.fullmatch(r"policy-(\d+)\.pt", found.name)):
        row = run.designs[int(number[1])]
    elif found.name == _CHECKPOINT and "trainer" in saved:
        saved = saved["trainer"]["learner"] | {"form": saved["trainer"]["best"]["form"]}
    if "form" not in saved:
        raise ValueError(f"policy: {found} holds no policy")
    is_reactive = "stiffness" in saved["form"]["ranges"]
    bodies, fields = _designs(run, row)
    return SavedPolicy(
        found,
        saved,
        material="reactive" if is_reactive else "invariant",
        task=None if run is None or run.task == NOT_RECORDED else run.task,
        bodies=bodies,
        stiffness=None if is_reactive else fields,
        edge_rule="mean_factor" if run is None else run.edge_rule,
    )


def _load(file: Path) -> Mapping[str, Any]:
    try:
        saved = torch.load(file, weights_only=True)
    except (RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise ValueError(f"policy: {file} cannot be read: {error}") from error
    return saved if isinstance(saved, Mapping) else {}


def _designs(
    run: RunRecord | None, row: Mapping[str, Any] | None
) -> tuple[tuple[Body, ...], tuple[np.ndarray, ...] | None]:
    """Returns the bodies of a policy with their stiffness, as far as its run says them."""
    if run is None:
        return (), None
    if row is not None:
        body, stiffness = run.design(row)
        return (body,), (stiffness,)
    bodies = tuple(map(as_body, run.bodies))
    if run.stiffness is None or not bodies:
        return bodies, None
    fields = run.stiffness if isinstance(run.stiffness, list | tuple) else [run.stiffness] * len(bodies)
    return bodies, tuple(np.where(body.occupancy, rows, 1.0) for body, rows in zip(bodies, fields, strict=True))
