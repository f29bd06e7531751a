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
from torch.special import log_ndtr

Shape = torch.Size | list[int] | tuple[int, ...]

IDLE = 1.0  # rest length and unit stiffness: what voxels that are not driven are given
_EDGE = 1 - 1e-6  # from here on an action is on its bound: clipped ones are, but for rounding
_ONE = torch.Size()  # a single draw
_HALF_LOG_TAU = 0.5 * math.log(2 * math.pi)


class MaskedClippedNormal(Distribution):
    """One Gaussian per voxel, clipped to the action's range; voxels outside `mask` emit `IDLE` and count in no sum.

    A draw is `mid + half * u` with `u ~ Normal(loc, scale)`, moved to the nearer bound where it lies outside
    `[low, high]`. A bound is therefore drawn with a probability of its own, and it is that probability which
    `log_prob` returns there, as in Fujita and Maeda, "Clipped Action Policy Gradient", 2018. A policy can thus hold
    a voxel fully contracted, which a squashed Gaussian only comes close to.

    Args:
        loc: means in half ranges from the middle (the bounds are -1 and 1), (..., V).
        scale: standard deviations in half ranges, positive, broadcastable to `loc`.
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
        return self._clip(self.loc + self.scale * noise)

    def _clip(self, u: Tensor) -> Tensor:
        return torch.where(self.mask, (self.mid + self.half * u).clamp(self.low, self.high), IDLE)

    def rsample(self, sample_shape: Shape = _ONE) -> Tensor:
        """Returns a differentiable draw, (*sample_shape, ..., V)."""
        shape = torch.Size(sample_shape) + self.loc.shape
        return self.with_noise(torch.randn(shape, dtype=self.loc.dtype, device=self.loc.device))

    def log_prob(self, value: Tensor) -> Tensor:
        """Returns the log-density of `value` (..., V) within the range, the log-probability of a bound on it.

        Summed over the driven voxels: (...).
        """
        u = (value - self.mid) / self.half
        density = -0.5 * ((u - self.loc) / self.scale).square() - self.scale.log() - _HALF_LOG_TAU - math.log(self.half)
        side = torch.where(u < 0, -1.0, 1.0)
        bound = log_ndtr((side * self.loc - 1) / self.scale)
        return torch.where(self.mask, torch.where(u.abs() > _EDGE, bound, density), 0).sum(-1)

    def entropy(self) -> Tensor:
        """Returns the entropy before clipping, summed over the driven voxels: (...).

        As an exploration bonus it serves: it grows with the noise, also where most of it is clipped.
        """
        entropy = self.scale.log() + 0.5 + _HALF_LOG_TAU
        return torch.where(self.mask, entropy, 0).sum(-1)

    @property
    def mode(self) -> Tensor:
        """The action of the middle of the Gaussian, `IDLE` where nothing is driven: (..., V)."""
        return self._clip(self.loc)

    @property
    def mean(self) -> Tensor:
        """The deterministic action, the same as `mode`; the mean of the clipped Gaussian lies nearer the middle."""
        return self.mode


class VoxelActions(Distribution):
    """Independent heads taken together, as one distribution over the `action` TensorDict.

    Samples are TensorDicts with one entry per head; log-probabilities and entropies are sums over heads, one number
    per body. PPO's ratio is therefore one per body, whatever its number of voxels.

    Args:
        heads: name of the action entry -> its distribution; all of one batch shape.
    """

    arg_constraints: ClassVar[dict[str, Constraint]] = {}

    def __init__(self, heads: Mapping[str, MaskedClippedNormal]) -> None:
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
