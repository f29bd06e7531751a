"""Policies of one task or setting as the beginning of training in another."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase

from evogymcm.algos.learning.actor import VoxelActor, ranges_of
from evogymcm.algos.learning.critic import VoxelCritic
from evogymcm.envs.observed import N_COMMON


def carried_over(policy: Mapping[str, Any], env: EnvBase) -> dict[str, Any]:
    """Returns a policy of another task or setting as one for this; all of it as it is where it fits.

    It acts as before at first: of the task's features, those that all tasks have keep their weights, and the others get
    0; a head that is new gives the same action everywhere (stiffness 1). Statistics of the task's features begin anew.
    A policy does not know its task: one with as many features counts as the same.

    Args:
        policy: A saved policy, or several stacked ones.
        env: Where it is to act, a `SoftRobotEnv`.
    """
    form = policy["form"]
    if form["network"] != "voxel":
        return dict(policy)
    ranges, task_features = ranges_of(env), env.observation_spec["task"].shape[-1]
    if form["task_features"] == task_features and list(form["ranges"]) == list(ranges):
        return dict(policy)
    known, is_other_task = list(form["ranges"]), form["task_features"] != task_features
    form = form | {"task_features": task_features, "ranges": dict(ranges)}
    options = {name: form[name] for name in ("hidden", "copies")} | {"generator": torch.Generator()}
    actor = VoxelActor(task_features, ranges, context=form["context"], columns=form["columns"], **options)
    fresh = {"actor": actor.state_dict(), "critic": VoxelCritic(task_features, **options).state_dict()}
    out: dict[str, Any] = {"form": form}
    for part, state in fresh.items():
        given = dict(policy[part])
        if is_other_task:
            given |= _of_task(state, given)
        if part == "actor":
            given |= _of_heads(state, given, list(ranges), known)
        out[part] = given
    return out


def _of_task(fresh: Mapping[str, Tensor], given: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns what a layer of a task's features becomes in a network for another task."""
    out = {name: fresh[name].clone() for name in ("task.weight", "task.mean", "task.var", "task.count")}
    out["task.weight"].zero_()
    for name in ("task.weight", "task.mean", "task.var"):
        out[name][..., :N_COMMON] = given[name][..., :N_COMMON]
    return out


def _of_heads(
    fresh: Mapping[str, Tensor], given: Mapping[str, Tensor], heads: Sequence[str], known: Sequence[str]
) -> dict[str, Tensor]:
    """Returns what the heads become in a network with others: those that it knows as they are, and idle ones."""
    axes = {"heads.weight": -2, "heads.bias": -1, "log_std": -1}
    out = {name: fresh[name].clone() for name in axes}
    out["heads.weight"].zero_()
    for name, axis in axes.items():
        for i, head in enumerate(heads):
            if head in known:
                out[name].select(axis, i).copy_(given[name].select(axis, known.index(head)))
    return out


def check_form(given: Mapping[str, Any], own: Mapping[str, Any]) -> None:
    """Raises a ValueError where a policy's form is not that of a run's networks."""
    if set(given["ranges"]) != set(own["ranges"]):
        is_reactive = "stiffness" in given["ranges"]
        raise ValueError(f"initial: the policy {'sets stiffness' if is_reactive else 'does not set stiffness'}")
    same = given.keys() & own.keys() - {"ranges", "columns", "copies"}
    differing = [f"{name} {given[name]!r}, the run {own[name]!r}" for name in sorted(same) if given[name] != own[name]]
    if differing:
        raise ValueError(f"initial: the policy has {'; '.join(differing)}")
    copies = given.get("copies")
    if copies not in (None, own["copies"]):
        raise ValueError(
            f"initial: got policies of {copies} designs, expected one, or one for each of independent ones"
        )
