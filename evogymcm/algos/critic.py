"""A state value that pools over the voxels of a body."""

import math

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.envs import EnvBase

from evogymcm.algos.features import N_INPUTS, NormalizedLinear, orthogonal, pool, voxel_frame, voxel_inputs

__all__ = ["VoxelCritic", "make_critic"]


class VoxelCritic(TensorDictModuleBase):
    """Value of a body's state; takes any number of bodies, of any shape, in any padded grid.

    Args:
        task_features: features of the task, G.
        hidden: width of the hidden layers.
    """

    in_keys = ["voxels", "types", "task", "occupancy"]  # noqa: RUF012
    out_keys = ["state_value"]  # noqa: RUF012

    def __init__(self, task_features: int, hidden: int = 64) -> None:
        super().__init__()
        self.encode = NormalizedLinear(N_INPUTS, hidden, voxel_frame())
        self.task = NormalizedLinear(task_features, hidden)
        self.body = nn.Linear(hidden, hidden, bias=False)
        self.value = nn.Linear(hidden, 1)
        for layer in (self.encode, self.body):
            orthogonal(layer, math.sqrt(2))
        orthogonal(self.task)
        orthogonal(self.value, 0.1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `state_value` (..., 1) into `tensordict` and returns it."""
        pooled = pool(torch.relu(self.encode(voxel_inputs(tensordict))), tensordict.get("occupancy"))
        hidden = torch.relu(self.body(pooled) + self.task(tensordict.get("task")))
        tensordict.set("state_value", self.value(hidden))
        return tensordict

    def observe(self, tensordict: TensorDictBase) -> None:
        """Takes observations (any batch shape) into the running normalisation of the inputs."""
        self.encode.observe(voxel_inputs(tensordict)[tensordict.get("occupancy")])
        self.task.observe(tensordict.get("task").flatten(0, -2))


def make_critic(env: EnvBase, hidden: int = 64) -> VoxelCritic:
    """Returns an untrained critic that fits the observations of `env`."""
    return VoxelCritic(env.observation_spec["task"].shape[-1], hidden)
