"""Trained policies as they lie in run folders, with what they were trained on."""

import pickle
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evogymcm.report.runs import NOT_RECORDED, CodesignRun, TrainingRun, read_run

if TYPE_CHECKING:  # numba and torch are loaded when a command runs, not for its help
    import numpy as np
    from tensordict.nn import TensorDictModuleBase

    from evogymcm.algos.codesign.design import Design
    from evogymcm.body import Body
    from evogymcm.envs.core import TaskEngine


@dataclass(frozen=True)
class Trained:
    """A policy and what its run says of it.

    Attributes:
        policy: the mapping that the run has saved.
        material: the setting that it was trained in.
        task: on which it was trained; None where the run does not say.
        bodies: that it was trained on; None where the run does not say.
        stiffness: a field for each of the bodies, or None for 1 everywhere.
        edge_rule: how stiffness acted on shared edges.
    """

    policy: Mapping[str, Any]
    material: str
    task: str | None
    bodies: "list[str | Body] | None"
    stiffness: "list[np.ndarray] | None"
    edge_rule: str


def load_trained(path: Path) -> Trained:
    """Returns the last policy of a training run, the best design's of a co-design run, or that of one of their files.

    Raises:
        ValueError: There is no policy, or the run's files cannot be read.
    """
    import numpy as np

    names = ("final.pt", "best.pt", "codesign.pt")
    found = next((file for file in (*(path / name for name in names), path) if file.is_file()), None)
    if found is None:
        raise ValueError(f"policy: {path} has none of {', '.join(names)}")
    saved, run = _load(found), read_run(found.parent)
    config: Mapping[str, Any] = {} if run is None else run.config
    design = None
    if found.name == "codesign.pt":
        if saved.get("champion") is None:
            raise ValueError(f"policy: {path} has no trained design yet")
        design, saved = _design(saved["champion"]["individual"], config), saved["champion"]["policy"]
    elif isinstance(run, CodesignRun) and (number := re.fullmatch(r"policy-(\d+)\.pt", found.name)):
        design = _design(run.individuals[int(number[1])], config)
    if "form" not in saved:
        raise ValueError(f"policy: {found} holds no policy")
    bodies: list[str | Body] | None = None
    stiffness = None
    if design is not None:
        bodies, stiffness = [design.body], [np.array(design.field)]
    elif isinstance(run, TrainingRun):
        bodies = config.get("bodies") or ([run.body] if run.body else None)
        stiffness = None if config.get("stiffness") is None else [np.array(field) for field in config["stiffness"]]
    is_reactive = "stiffness" in saved["form"]["ranges"]
    return Trained(
        saved,
        material="reactive" if is_reactive else "invariant",
        task=None if run is None or run.task == NOT_RECORDED else run.task,
        bodies=bodies,
        stiffness=None if is_reactive else stiffness,
        edge_rule=config.get("edge_rule") or "mean_factor",
    )


def _load(file: Path) -> Mapping[str, Any]:
    import torch

    try:
        saved = torch.load(file, weights_only=True)
    except (RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise ValueError(f"policy: {file} cannot be read: {error}") from error
    return saved if isinstance(saved, Mapping) else {}


def _design(row: Mapping[str, Any], config: Mapping[str, Any]) -> "Design":
    """Returns an individual's design as its arm simulates it."""
    from evogymcm.algos.codesign.design import Design

    return Design.from_record(row).in_arm(config["arm"], config["prescribed"])


def module_of(policy: Mapping[str, Any], engine: "TaskEngine") -> "TensorDictModuleBase":
    """Returns the policy as a module that acts in the engine's worlds.

    Raises:
        ValueError: It was trained for other observations, or for another number of bodies.
    """
    from evogymcm.algos import PerDesign, load_actor

    form, copies = policy["form"], policy["form"].get("copies")
    if form["network"] == "mlp":
        name, wanted, there = (
            "flat observation",
            form["features"],
            None if engine.flat is None else engine.flat.shape[1],
        )
    else:
        name, wanted, there = "task features", form["task_features"], engine.features.shape[1]
    if wanted != there:
        raise ValueError(f"policy: takes {wanted} numbers as {name}, {engine.task.id} with these bodies has {there}")
    if copies is not None and engine.num_designs != copies:
        raise ValueError(f"policy: the run has one for each of {copies} bodies, got {engine.num_designs} bodies")
    actor = load_actor(policy)
    actor.columns = engine.grid_shape[1]
    return actor if copies is None else PerDesign(actor, copies)
