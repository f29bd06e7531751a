"""Building blocks of the networks: well-scaled inputs from observations, and layers stacked over designs."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from evogymcm.envs.voxels import N_FEATURES, N_SIDES, N_TYPES, POSITIONS, VELOCITIES

N_INPUTS = N_FEATURES + N_SIDES * (N_TYPES - 1)  # of a voxel, as `voxel_inputs` gives them
_OF_VOXELS = ("voxels", "types", "occupancy", "actuators")  # entries (..., V) or (..., V, features), as are actions
_CORNERS = 4
_MIN_STD = 1e-3  # features that vary less are taken as constant and left unscaled


def voxel_inputs(tensordict: TensorDictBase) -> Tensor:
    """Returns what voxels sense, then the types of each and of its neighbours one-hot: (..., V, N_INPUTS).

    Where `tensordict` holds them already, as `voxel_inputs`, those.
    """
    if (known := tensordict.get("voxel_inputs", None)) is not None:
        return known
    voxels, types = tensordict.get("voxels"), tensordict.get("types")
    codes = torch.arange(1, N_TYPES, dtype=types.dtype, device=types.device)
    one_hot = (types.unsqueeze(-1) == codes).flatten(-2)
    return torch.cat([voxels, one_hot.to(voxels.dtype)], -1)


def compact(tensordict: TensorDictBase) -> TensorDictBase:
    """Returns the same samples in the least number of cells, V', each body's voxels first and in their order.

    What depends on a voxel's place in the grid cannot be computed from them any more; all else stays as it is.

    Args:
        tensordict: observations, and maybe actions, of any batch shape.
    """
    occupancy = tensordict.get("occupancy")
    order = torch.sort(occupancy.logical_not().to(torch.uint8), dim=-1, stable=True).indices
    order = order[..., : int(occupancy.sum(-1).max())]
    out = tensordict.clone(recurse=False)
    for key, value in tensordict.items(include_nested=True, leaves_only=True):
        if key in _OF_VOXELS or key[0] == "action":
            index = order.reshape(*order.shape, *[1] * (value.dim() - order.dim()))
            out[key] = value.gather(order.dim() - 1, index.expand(*order.shape, *value.shape[order.dim() :]))
    return out


def voxel_frame() -> Tensor:
    """Returns the linear map of a voxel's inputs to a voxel-centred frame, (N_INPUTS + 4, N_INPUTS).

    The four corners of a voxel differ little from each other compared with their distance from the body's centre, so
    deformation would drown in position once both are scaled alike. The map writes each group of corner vectors
    (positions, velocities) as the voxel's centre followed by the corners relative to that centre; all other features
    pass unchanged.
    """
    eye = torch.eye(N_INPUTS)
    rows, start = [], 0
    for group in (POSITIONS, VELOCITIES):  # each: x, y of the corners TL, TR, BL, BR
        corners = eye[group : group + 2 * _CORNERS].reshape(_CORNERS, 2, N_INPUTS)
        centre = corners.mean(0)
        rows += [eye[start:group], centre, (corners - centre).reshape(-1, N_INPUTS)]
        start = group + 2 * _CORNERS
    return torch.cat([*rows, eye[start:]])


class Dense(nn.Module):
    """Linear layer, or one for each of several designs: then inputs have a leading dimension of designs.

    Args:
        in_features: size of the last dimension of the input.
        out_features: size of the output.
        bias: whether there is one.
        copies: D independent layers, for inputs (D, ..., in_features); None for a single one.
        generator: of the weights; torch's global one by default.
    """

    bias: nn.Parameter  # or None

    def __init__(
        self,
        in_features: int,
        out_features: int,
        bias: bool = True,
        copies: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        lead = () if copies is None else (copies,)
        self.copies = copies
        self.weight = nn.Parameter(torch.zeros(*lead, out_features, in_features))
        self.register_parameter("bias", nn.Parameter(torch.zeros(*lead, out_features)) if bias else None)
        self.orthogonal(1.0, generator)

    @torch.no_grad()
    def orthogonal(self, gain: float, generator: torch.Generator | None) -> None:
        """Sets orthogonal weights and zero biases (in place)."""
        for weight in self.weight if self.copies else (self.weight,):
            nn.init.orthogonal_(weight, gain, generator)
        if self.bias is not None:
            self.bias.zero_()

    def forward(self, x: Tensor) -> Tensor:
        """Returns (..., in_features) -> (..., out_features)."""
        return affine(x, self.weight, self.bias)


def affine(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """Returns `x @ weight.T + bias`, design by design where the weights have a leading dimension."""
    if weight.dim() == 2:
        return nn.functional.linear(x, weight, bias)
    rows = x.flatten(1, -2)
    out = rows @ weight.transpose(1, 2) if bias is None else torch.baddbmm(bias.unsqueeze(1), rows, weight.mT)
    return out.unflatten(1, x.shape[1:-1])


class NormalizedDense(Dense):
    """Linear layer whose inputs are first mapped by `frame`, then shifted and scaled by running statistics.

    Both steps are linear, so they are folded into the weights and cost nothing per sample. The statistics are buffers:
    they are saved with the module and change only in `observe`, and so does what is computed from them.

    Args:
        in_features: size of the last dimension of the input.
        out_features: size of the output.
        frame: linear map applied before normalisation, (mapped, in_features); None for none.
        copies: as for `Dense`; every design has statistics of its own.
        generator: as for `Dense`.
    """

    count: Tensor
    mean: Tensor
    var: Tensor
    frame: Tensor | None
    scale: Tensor  # of inputs: (mapped, in_features), or (mapped,) without a frame
    shift: Tensor  # of scaled inputs: (mapped,)

    def __init__(
        self,
        in_features: int,
        out_features: int,
        frame: Tensor | None = None,
        copies: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        mapped = in_features if frame is None else frame.shape[0]
        super().__init__(mapped, out_features, copies=copies, generator=generator)
        lead = () if copies is None else (copies,)
        self.register_buffer("frame", frame, persistent=False)
        self.register_buffer("count", torch.zeros(*lead, 1, dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(*lead, mapped, dtype=torch.float64))
        self.register_buffer("var", torch.ones(*lead, mapped, dtype=torch.float64))
        self.register_buffer("scale", None, persistent=False)
        self.register_buffer("shift", None, persistent=False)
        self._fold()

    def _fold(self) -> None:
        """Brings `scale` and `shift` up to date with the statistics."""
        std, dtype = self.var.sqrt(), self.weight.dtype
        gain = torch.where(std < _MIN_STD, 1.0, 1 / std)
        self.shift = (gain * self.mean).to(dtype)
        gain = gain.to(dtype)
        self.scale = gain if self.frame is None else gain.unsqueeze(-1) * self.frame

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        super()._load_from_state_dict(*args, **kwargs)
        self._fold()

    def forward(self, x: Tensor) -> Tensor:
        """Returns the layer's output for raw inputs, (..., in_features) -> (..., out_features)."""
        # Made as columns: the gradient by it is a product that is faster for widths like that of `voxel_inputs`.
        weight = self.weight.mT * self.scale.unsqueeze(-1) if self.frame is None else self.scale.mT @ self.weight.mT
        weight = weight.mT
        bias = self.bias - (self.weight @ self.shift.unsqueeze(-1)).squeeze(-1)
        return affine(x, weight, bias)

    @torch.no_grad()
    def observe(self, x: Tensor, mask: Tensor | None = None) -> None:
        """Takes raw inputs (..., in_features), those of `mask` (...), into the running mean and variance."""
        x = (x if self.frame is None else x @ self.frame.mT).to(torch.float64)
        weights = torch.ones(x.shape[:-1], device=x.device) if mask is None else mask
        x, weights = (value.flatten(self.count.dim() - 1, -2) for value in (x, weights.to(x.dtype).unsqueeze(-1)))
        n = weights.sum(-2)
        mean = (x * weights).sum(-2) / n.clamp_min(1)
        var = ((x - mean.unsqueeze(-2)).square() * weights).sum(-2) / n.clamp_min(1)
        total = (self.count + n).clamp_min(1)
        shift = mean - self.mean
        pooled = (self.var * self.count + var * n + shift.square() * self.count * n / total) / total
        self.mean.add_(shift * n / total)
        self.var.copy_(torch.where(self.count + n > 0, pooled, self.var))
        self.count.add_(n)
        self._fold()


def pool(x: Tensor, mask: Tensor) -> Tensor:
    """Returns the mean of `x` (..., V, H) over the voxels of `mask` (..., V): (..., H)."""
    weights = mask.to(x.dtype)
    weights = weights / weights.sum(-1, keepdim=True).clamp_min(1)
    return torch.matmul(weights.unsqueeze(-2), x).squeeze(-2)
