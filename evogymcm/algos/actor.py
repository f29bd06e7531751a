"""A policy that drives every voxel of every body with the same small network."""

import math
from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import EnvBase, ExplorationType
from torchrl.envs.utils import exploration_type

from evogymcm.algos.distributions import IDLE, MaskedSquashedNormal, VoxelActions
from evogymcm.algos.features import N_INPUTS, NormalizedLinear, orthogonal, pool, voxel_frame, voxel_inputs

__all__ = ["VoxelActor", "make_actor"]

# Action entry -> observation that marks the voxels it drives, and the mean action before training. Actuation starts
# in the middle of its range, stiffness at 1, where a co-optimised robot is the same robot as a control-only one.
_HEADS: Mapping[str, tuple[str, float | None]] = {"actuation": ("actuators", None), "stiffness": ("occupancy", IDLE)}
_REACH = 3.0  # means before squashing stay within this: 99.5 % of the range, and probabilities that stay finite


class VoxelActor(TensorDictModuleBase):
    """Stochastic policy with weights shared by all voxels.

    Each voxel sees its own features, the mean over the body of what all voxels encode, and the task's features. The
    module therefore takes any number of bodies, of any shape, in any padded grid. It samples unless the exploration
    type is deterministic (`torchrl.envs.set_exploration_type`).

    Args:
        task_features: features of the task, G.
        ranges: action entry ("actuation", "stiffness") -> (low, high).
        hidden: width of both hidden layers.
        initial_std: standard deviation before squashing that training starts with (1 fills the range).

    Raises:
        ValueError: if `ranges` names no head or an unknown one.
    """

    dist_sample_keys = ["action"]  # noqa: RUF012  (names that TorchRL's losses look up)
    log_prob_keys = ["action_log_prob"]  # noqa: RUF012

    def __init__(
        self,
        task_features: int,
        ranges: Mapping[str, tuple[float, float]],
        hidden: int = 64,
        initial_std: float = 1.0,
    ) -> None:
        super().__init__()
        if not ranges or not set(ranges) <= set(_HEADS):
            raise ValueError(f"action heads: got {sorted(ranges)}, allowed are {sorted(_HEADS)}")
        self.ranges = dict(ranges)
        self.in_keys = ["voxels", "types", "task", "occupancy", *(_HEADS[name][0] for name in ranges)]
        self.in_keys = list(dict.fromkeys(self.in_keys))
        self.out_keys = [*(("action", name) for name in ranges), "action_log_prob"]
        self.encode = NormalizedLinear(N_INPUTS, hidden, voxel_frame())
        self.task = NormalizedLinear(task_features, hidden)
        self.local = nn.Linear(hidden, hidden)
        self.body = nn.Linear(hidden, hidden, bias=False)
        self.heads = nn.Linear(hidden, len(ranges))
        self.log_std = nn.Parameter(torch.full((len(ranges),), math.log(initial_std)))
        for layer in (self.encode, self.local, self.body):
            orthogonal(layer, math.sqrt(2))
        orthogonal(self.task)
        orthogonal(self.heads, 0.01)
        with torch.no_grad():
            self.heads.bias.copy_(torch.tensor([self._start(name) for name in ranges]))

    def _start(self, name: str) -> float:
        """Output that gives the head's first action."""
        (low, high), first = self.ranges[name], _HEADS[name][1]
        return (
            0.0 if first is None else _REACH * math.atanh(math.atanh((2 * first - low - high) / (high - low)) / _REACH)
        )

    def _means(self, tensordict: TensorDictBase) -> Tensor:
        """Means before squashing, (..., V, heads)."""
        encoded = torch.relu(self.encode(voxel_inputs(tensordict)))
        shared = self.body(pool(encoded, tensordict.get("occupancy"))) + self.task(tensordict.get("task"))
        outputs = self.heads(torch.relu(self.local(encoded) + shared.unsqueeze(-2)))
        return _REACH * torch.tanh(outputs / _REACH)

    def get_dist(self, tensordict: TensorDictBase) -> VoxelActions:
        """Returns the action distribution for the observations in `tensordict`."""
        means = self._means(tensordict)
        std = self.log_std.exp()
        return VoxelActions(
            {
                name: MaskedSquashedNormal(means[..., i], std[i], tensordict.get(_HEADS[name][0]), *self.ranges[name])
                for i, name in enumerate(self.ranges)
            }
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` and `action_log_prob` into `tensordict` and returns it."""
        dist = self.get_dist(tensordict)
        is_random = exploration_type() in (None, ExplorationType.RANDOM)
        action = dist.sample() if is_random else dist.mode
        tensordict.set("action", action)
        tensordict.set("action_log_prob", dist.log_prob(action))
        return tensordict

    @torch.no_grad()
    def limit_std(self, limit: float) -> None:
        """Lowers standard deviations (before squashing) that are above `limit` to it."""
        self.log_std.clamp_(max=math.log(limit))

    def observe(self, tensordict: TensorDictBase) -> None:
        """Takes observations (any batch shape) into the running normalisation of the inputs."""
        self.encode.observe(voxel_inputs(tensordict)[tensordict.get("occupancy")])
        self.task.observe(tensordict.get("task").flatten(0, -2))


def make_actor(env: EnvBase, hidden: int = 64, initial_std: float = 1.0) -> VoxelActor:
    """Returns an untrained actor that fits the observations and action ranges of `env`."""
    spaces = {name: spec.space for name, spec in env.full_action_spec["action"].items()}
    return VoxelActor(
        task_features=env.observation_spec["task"].shape[-1],
        ranges={name: (space.low.min().item(), space.high.max().item()) for name, space in spaces.items()},
        hidden=hidden,
        initial_std=initial_std,
    )
