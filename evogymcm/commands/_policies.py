"""Trained policies as they lie in run folders, with what they were trained on."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # numba and torch are loaded when a command runs, not for its help
    import numpy as np

    from evogymcm.body import Body
    from evogymcm.envs.core import TaskEngine

    Control = Callable[[TaskEngine], tuple[np.ndarray, np.ndarray | None]]


@dataclass(frozen=True)
class Trained:
    """A policy and what its run says of it.

    Attributes:
        policy: the mapping that the run has saved.
        material: the setting that it was trained in.
        bodies: that it was trained on; None where the run does not say.
        stiffness: a field for each of the bodies, or None for 1 everywhere.
        edge_rule: how stiffness acted on shared edges.
    """

    policy: Mapping[str, Any]
    material: str
    bodies: "list[str | Body] | None"
    stiffness: "list[np.ndarray] | None"
    edge_rule: str


def load_trained(path: Path) -> Trained:
    """Returns the last policy of a training run, the best design's of a co-design run, or that of one file.

    Raises:
        ValueError: There is no policy.
    """
    import numpy as np
    import torch

    names = ("final.pt", "best.pt", "codesign.pt")
    found = next((file for file in (*(path / name for name in names), path) if file.is_file()), None)
    if found is None:
        raise ValueError(f"policy: {path} has none of {', '.join(names)}")
    saved = torch.load(found, weights_only=True)
    settings = found.parent / "config.json"
    config = json.loads(settings.read_text(encoding="utf-8")) if settings.is_file() else {}
    edge_rule = config.get("edge_rule") or "mean_factor"
    bodies: list[str | Body] | None = None
    stiffness = None
    if found.name == "codesign.pt":
        from evogymcm.algos.designs import Design

        if saved["champion"] is None:
            raise ValueError(f"policy: {path} has no trained design yet")
        design = Design.from_record(saved["champion"]["individual"]).in_arm(config["arm"], config["prescribed"])
        bodies, stiffness, saved = [design.body], [np.array(design.field)], saved["champion"]["policy"]
    elif found.parent == path and isinstance(config.get("bodies"), list):
        bodies = config["bodies"]
        stiffness = None if config.get("stiffness") is None else [np.array(field) for field in config["stiffness"]]
    material = "reactive" if "stiffness" in saved["form"]["ranges"] else "invariant"
    return Trained(saved, material, bodies, stiffness if material == "invariant" else None, edge_rule)


def control_of(policy: Mapping[str, Any], engine: "TaskEngine") -> "Control":
    """Returns the policy as deterministic control of the engine's worlds.

    Raises:
        ValueError: It was trained for other observations, or for another number of bodies.
    """
    import numpy as np
    import torch
    from tensordict import TensorDict
    from torchrl.envs.utils import ExplorationType, set_exploration_type

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
    module = actor if copies is None else PerDesign(actor, copies)

    def control(engine: "TaskEngine") -> "tuple[np.ndarray, np.ndarray | None]":
        seen = {
            "voxels": engine.voxels,
            "types": engine.types,
            "task": engine.features.astype(np.float32),
            "occupancy": engine.occupancy,
            "actuators": engine.actuators,
        }
        if engine.flat is not None:
            seen["observation"] = engine.flat
        td = TensorDict({key: torch.from_numpy(value) for key, value in seen.items()}, [engine.num_worlds])
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            action = module(td)["action"]
        return action["actuation"].numpy(), action["stiffness"].numpy() if "stiffness" in actor.ranges else None

    return control
