"""A state value that pools over the voxels of a body."""

import math

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.envs import EnvBase

from evogymcm.algos.features import NormalizedLinear, orthogonal, pool, voxel_frame

__all__ = ["VoxelCritic", "make_critic"]


class VoxelCritic(TensorDictModuleBase):
    """Value of a body's state; takes any number of bodies, of any shape, in any padded grid.

    Args:
        voxel_features: features per voxel, F.
        task_features: features of the task, G.
        hidden: width of the hidden layers.
    """

    in_keys = ["voxels", "task", "occupancy"]  # noqa: RUF012
    out_keys = ["state_value"]  # noqa: RUF012

    def __init__(self, voxel_features: int, task_features: int, hidden: int = 64) -> None:
        super().__init__()
        self.encode = NormalizedLinear(voxel_features, hidden, voxel_frame(voxel_features))
        self.task = NormalizedLinear(task_features, hidden)
        self.body = nn.Linear(hidden, hidden, bias=False)
        self.value = nn.Linear(hidden, 1)
        for layer in (self.encode, self.body):
            orthogonal(layer, math.sqrt(2))
        orthogonal(self.task)
        orthogonal(self.value, 0.1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `state_value` (..., 1) into `tensordict` and returns it."""
        voxels, task, occupancy = (tensordict.get(key) for key in self.in_keys)
        pooled = pool(torch.relu(self.encode(voxels)), occupancy)
        tensordict.set("state_value", self.value(torch.relu(self.body(pooled) + self.task(task))))
        return tensordict

    def observe(self, tensordict: TensorDictBase) -> None:
        """Takes observations (any batch shape) into the running normalisation of the inputs."""
        self.encode.observe(tensordict.get("voxels")[tensordict.get("occupancy")])
        self.task.observe(tensordict.get("task").flatten(0, -2))


def make_critic(env: EnvBase, hidden: int = 64) -> VoxelCritic:
    """Returns an untrained critic that fits the observations of `env`."""
    spec = env.observation_spec
    return VoxelCritic(spec["voxels"].shape[-1], spec["task"].shape[-1], hidden)
