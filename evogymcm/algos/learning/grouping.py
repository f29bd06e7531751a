"""Policies that are asked group of worlds by group of worlds, so that no group's actions depend on the others."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase


class InGroups(TensorDictModuleBase):
    """Policies of groups of worlds, in turn. The actions of each group are computed separately from those of others.

    Groups whose episodes have all ended are not asked: their actions are 1, and have no effect.

    A batched matrix product may round a row differently with the number of rows, and contact amplifies differences.

    Args:
        policies: P policies; group g is asked of policy g % P.
        size: Worlds in a group.
    """

    def __init__(self, policies: Sequence[TensorDictModuleBase], size: int = 1) -> None:
        super().__init__()
        self.policies, self.size = list(policies), size
        self.in_keys, self.out_keys = policies[0].in_keys, policies[0].out_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the actions into `tensordict` (N,) and returns it."""
        done, size = tensordict.get("done"), self.size
        rows = tensordict.select(*self.in_keys, "done")
        is_running = ~done.reshape(-1, size).all(1)
        asked = torch.nonzero(is_running).flatten().tolist()
        out = [self.policies[g % len(self.policies)](rows[g * size : (g + 1) * size]) for g in asked]
        for key in self.out_keys:
            answers = torch.cat([group.get(key) for group in out])
            actions = answers.new_ones(len(rows), *answers.shape[1:])
            actions[is_running.repeat_interleave(size)] = answers
            tensordict.set(key, actions)
        return tensordict
