"""Bounded action distributions with one value per voxel, for bodies of any shape in one padded batch."""

import math
from collections.abc import Mapping
from functools import reduce
from operator import add
from typing import ClassVar

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.distributions import Distribution
from torch.distributions.constraints import Constraint
from torch.nn.functional import softplus

__all__ = ["IDLE", "MaskedSquashedNormal", "VoxelActions"]

Shape = torch.Size | list[int] | tuple[int, ...]

IDLE = 1.0  # rest length and unit stiffness: what voxels that are not driven are given
_EDGE = 1 - 1e-6  # actions on the bounds are read as this far out, so that their log-probability is finite
_ONE = torch.Size()  # a single draw
_HALF_LOG_TAU = 0.5 * math.log(2 * math.pi)


class MaskedSquashedNormal(Distribution):
    """One tanh-squashed Gaussian per voxel; voxels outside `mask` emit `IDLE` and count in no sum.

    A draw is `mid + half * tanh(u)` with `u ~ Normal(loc, scale)`, so it lies within `[low, high]` without clipping.

    Args:
        loc: means before squashing, (..., V).
        scale: standard deviations before squashing, positive, broadcastable to `loc`.
        mask: which voxels are driven, bool, (..., V).
        low: lower bound of the action.
        high: upper bound of the action.
    """

    arg_constraints: ClassVar[dict[str, Constraint]] = {}
    has_rsample = True

    def __init__(self, loc: Tensor, scale: Tensor, mask: Tensor, low: float, high: float) -> None:
        super().__init__(loc.shape[:-1], loc.shape[-1:], validate_args=False)
        self.loc, self.scale, self.mask = loc, scale, mask
        self.low, self.high = low, high
        self.mid, self.half = (low + high) / 2, (high - low) / 2

    def with_noise(self, noise: Tensor) -> Tensor:
        """Returns the action that standard normal `noise` (..., V) gives."""
        return self._squash(self.loc + self.scale * noise)

    def _squash(self, u: Tensor) -> Tensor:
        return torch.where(self.mask, self.mid + self.half * torch.tanh(u), IDLE)

    def rsample(self, sample_shape: Shape = _ONE) -> Tensor:
        """Returns a differentiable draw, (*sample_shape, ..., V)."""
        shape = torch.Size(sample_shape) + self.loc.shape
        return self.with_noise(torch.randn(shape, dtype=self.loc.dtype, device=self.loc.device))

    def log_prob(self, value: Tensor) -> Tensor:
        """Returns the log-density of `value` (..., V), summed over the driven voxels: (...)."""
        u = torch.atanh(((value - self.mid) / self.half).clamp(-_EDGE, _EDGE))
        gaussian = -0.5 * ((u - self.loc) / self.scale).square() - self.scale.log() - _HALF_LOG_TAU
        log_slope = math.log(self.half) + 2 * (math.log(2) - u - softplus(-2 * u))  # of mid + half * tanh(u)
        return torch.where(self.mask, gaussian - log_slope, 0).sum(-1)

    def entropy(self) -> Tensor:
        """Returns the entropy before squashing, summed over the driven voxels: (...).

        The squashed one has no closed form; as an exploration bonus this one serves.
        """
        entropy = self.scale.log() + 0.5 + _HALF_LOG_TAU
        return torch.where(self.mask, entropy, 0).sum(-1)

    @property
    def mode(self) -> Tensor:
        """The action of the middle of the Gaussian, `IDLE` where nothing is driven: (..., V)."""
        return self._squash(self.loc)

    @property
    def mean(self) -> Tensor:
        """The deterministic action (the exact mean of a squashed Gaussian has no closed form)."""
        return self.mode


class VoxelActions(Distribution):
    """Independent heads taken together, as one distribution over the `action` TensorDict.

    Samples are TensorDicts with one entry per head; log-probabilities and entropies are sums over heads, one number
    per body. PPO's ratio is therefore one per body, whatever its number of voxels.

    Args:
        heads: name of the action entry -> its distribution; all of one batch shape.
    """

    arg_constraints: ClassVar[dict[str, Constraint]] = {}

    def __init__(self, heads: Mapping[str, MaskedSquashedNormal]) -> None:
        self.heads = dict(heads)
        super().__init__(next(iter(self.heads.values())).batch_shape, validate_args=False)

    def sample(self, sample_shape: Shape = _ONE) -> TensorDict:
        """Returns a draw without gradients; entries are (*sample_shape, ..., V)."""
        with torch.no_grad():
            draws = {name: head.rsample(sample_shape) for name, head in self.heads.items()}
        return TensorDict(draws, batch_size=torch.Size(sample_shape) + self.batch_shape)

    def with_noise(self, noise: Tensor) -> TensorDict:
        """Returns, without gradients, the action that standard normal `noise` (..., V, heads) gives."""
        with torch.no_grad():
            draws = {name: head.with_noise(noise[..., i]) for i, (name, head) in enumerate(self.heads.items())}
        return TensorDict(draws, batch_size=self.batch_shape)

    def log_prob(self, value: TensorDict) -> Tensor:
        """Returns the joint log-density of an action: (...)."""
        return reduce(add, (head.log_prob(value.get(name)) for name, head in self.heads.items()))

    def entropy(self) -> Tensor:
        """Returns the sum of the heads' entropies: (...)."""
        return reduce(add, (head.entropy() for head in self.heads.values()))

    @property
    def mode(self) -> TensorDict:
        """The deterministic action."""
        return TensorDict({name: head.mode for name, head in self.heads.items()}, batch_size=self.batch_shape)

    @property
    def mean(self) -> TensorDict:
        """The deterministic action."""
        return self.mode
