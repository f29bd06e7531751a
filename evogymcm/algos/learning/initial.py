"""What training begins with: fresh weights, the package's baseline, or a policy of a run."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import torch

from evogymcm.algos.baselines import has_baseline, load_baseline
from evogymcm.algos.learning.config import AUTO, BASELINE, FRESH, PPOConfig
from evogymcm.algos.runs.policies import SavedPolicy, load_policy

_OF_NETWORKS = ("network", "hidden", "context")  # settings of PPO that a policy's form says too
_P = TypeVar("_P", bound=PPOConfig)


def find_initial(initial: str, task: str, material: str, ppo: PPOConfig) -> tuple[str, SavedPolicy | None]:
    """Returns what training begins with: "fresh", "baseline" or a policy's path, and that policy, None for none.

    Args:
        initial: See `TrainConfig`.
        task: Id of the task.
        material: The setting.
        ppo: Settings that its networks must not contradict.

    Raises:
        ValueError: There is no such policy, or it has other networks.
    """
    if initial == FRESH or (initial == AUTO and not has_baseline(task, material)):
        return FRESH, None
    word, *names = initial.split(":")
    if word == BASELINE and len(names) <= 2:
        saved = load_baseline(*[*names, *(task, material)[len(names) :]])
    else:
        saved = load_baseline(task, material) if initial == AUTO else load_policy(initial)
    try:
        following(ppo, saved.state)
    except ValueError:
        if initial == AUTO:
            return FRESH, None
        raise
    return BASELINE if initial == AUTO else initial, saved


def initial_policy(initial: str, task: str, material: str, ppo: PPOConfig) -> tuple[str, dict[str, Any] | None]:
    """Returns what `find_initial` does, the policy as one that explores with `ppo.initial_std`."""
    word, saved = find_initial(initial, task, material, ppo)
    return word, None if saved is None else exploring(saved.state, ppo.initial_std)


def following(ppo: _P, policy: Mapping[str, Any]) -> _P:
    """Returns settings with networks like a policy's; a ValueError where other than the default ones are asked for."""
    defaults, form = type(ppo)(), policy["form"]
    wanted = {name: form[name] for name in _OF_NETWORKS if name in form}
    for name, value in wanted.items():
        given = getattr(ppo, name)
        if given not in (value, getattr(defaults, name)):
            raise ValueError(f"{name}: got {given!r}, the policy to begin with has {value!r}; leave it out")
    return replace(ppo, **wanted)


def exploring(policy: Mapping[str, Any], std: float) -> dict[str, Any]:
    """Returns a policy with the same mean actions that explores with `std`, in half ranges of the action."""
    log_std = torch.full_like(policy["actor"]["log_std"], math.log(std))
    return {"form": policy["form"], "actor": policy["actor"] | {"log_std": log_std}, "critic": policy["critic"]}
