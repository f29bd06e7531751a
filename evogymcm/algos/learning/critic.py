"""State values: one that pools over the voxels of a body, and a plain one to compare with."""

import math
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from evogymcm.algos.learning.actor import check_network
from evogymcm.algos.learning.layers import N_INPUTS, Dense, NormalizedDense, pool, voxel_frame, voxel_inputs


class VoxelCritic(TensorDictModuleBase):
    """Value of a body's state; takes any number of bodies, of any shape, in any padded grid.

    Args:
        task_features: features of the task, G.
        hidden: width of the hidden layers.
        copies: critics with weights of their own, for inputs with a leading dimension of designs; None for one.
        generator: random generator for the first weights; torch's global one by default.
    """

    in_keys = ["voxels", "types", "task", "occupancy"]  # noqa: RUF012
    out_keys = ["state_value"]  # noqa: RUF012

    def __init__(
        self,
        task_features: int,
        hidden: int = 32,
        copies: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        options: dict[str, Any] = {"copies": copies, "generator": generator}
        self.encode = NormalizedDense(N_INPUTS, hidden, voxel_frame(), **options)
        self.task = NormalizedDense(task_features, hidden, **options)
        self.body = Dense(hidden, hidden, bias=False, **options)
        self.value = Dense(hidden, 1, **options)
        for layer in (self.encode, self.body):
            layer.orthogonal(math.sqrt(2), generator)
        self.value.orthogonal(0.1, generator)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `state_value` (..., 1) into `tensordict` and returns it."""
        pooled = pool(torch.relu(self.encode(voxel_inputs(tensordict))), tensordict.get("occupancy"))
        hidden = torch.relu(self.body(pooled) + self.task(tensordict.get("task")))
        tensordict.set("state_value", self.value(hidden))
        return tensordict

    def observe(self, tensordict: TensorDictBase) -> None:
        """Takes observations (any batch shape) into the running normalisation of the inputs."""
        self.encode.observe(voxel_inputs(tensordict), tensordict.get("occupancy"))
        self.task.observe(tensordict.get("task"))


class MLPCritic(TensorDictModuleBase):
    """Value from the task's flat observation: two layers of tanh units.

    Args:
        features: size of the flat observation, D.
        hidden: width of the hidden layers.
        copies: critics with weights of their own; None for one.
        generator: random generator for the first weights; torch's global one by default.
    """

    in_keys = ["observation"]  # noqa: RUF012
    out_keys = ["state_value"]  # noqa: RUF012

    def __init__(
        self,
        features: int,
        hidden: int = 64,
        copies: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        options: dict[str, Any] = {"copies": copies, "generator": generator}
        self.encode = NormalizedDense(features, hidden, **options)
        self.hidden = Dense(hidden, hidden, **options)
        self.value = Dense(hidden, 1, **options)
        for layer in (self.encode, self.hidden):
            layer.orthogonal(math.sqrt(2), generator)
        self.value.orthogonal(0.1, generator)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `state_value` (..., 1) into `tensordict` and returns it."""
        hidden = torch.tanh(self.encode(tensordict.get("observation").float()))
        tensordict.set("state_value", self.value(torch.tanh(self.hidden(hidden))))
        return tensordict

    def observe(self, tensordict: TensorDictBase) -> None:
        """Takes observations (any batch shape) into the running normalisation of the inputs."""
        self.encode.observe(tensordict.get("observation").float())


Critic = VoxelCritic | MLPCritic


def make_critic(
    env: EnvBase,
    hidden: int | None = None,
    *,
    network: str = "voxel",
    copies: int | None = None,
    generator: torch.Generator | None = None,
) -> Critic:
    """Returns an untrained critic that fits the observations of `env`; arguments as for `make_actor`."""
    check_network(network, env)
    spec = env.observation_spec
    options: dict[str, Any] = {"copies": copies, "generator": generator}
    options |= {} if hidden is None else {"hidden": hidden}
    if network == "mlp":
        return MLPCritic(spec["observation"].shape[-1], **options)
    return VoxelCritic(spec["task"].shape[-1], **options)
