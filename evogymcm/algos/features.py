"""From voxel observations to well-scaled network inputs: a voxel-centred frame and running normalisation."""

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from evogymcm.envs.voxels import N_FEATURES, N_SIDES, N_TYPES, POSITIONS, VELOCITIES

__all__ = ["N_INPUTS", "NormalizedLinear", "orthogonal", "pool", "voxel_frame", "voxel_inputs"]

N_INPUTS = N_FEATURES + N_SIDES * (N_TYPES - 1)  # of a voxel, as `voxel_inputs` gives them
_CORNERS = 4
_MIN_STD = 1e-3  # features that vary less are taken as constant and left unscaled


def voxel_inputs(tensordict: TensorDictBase) -> Tensor:
    """Returns what voxels sense, then the types of each and of its neighbours one-hot: (..., V, N_INPUTS)."""
    voxels, types = tensordict.get("voxels"), tensordict.get("types")
    codes = torch.arange(1, N_TYPES, dtype=types.dtype, device=types.device)
    one_hot = (types.unsqueeze(-1) == codes).flatten(-2)
    return torch.cat([voxels, one_hot.to(voxels.dtype)], -1)


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


class NormalizedLinear(nn.Linear):
    """Linear layer whose inputs are first mapped by `frame`, then shifted and scaled by running statistics.

    Both steps are linear, so they are folded into the weights and cost nothing per sample. The statistics are buffers:
    they are saved with the module and change only in `observe`.

    Args:
        in_features: size of the last dimension of the input.
        out_features: size of the output.
        frame: linear map applied before normalisation, (mapped, in_features); None for none.
    """

    count: Tensor
    mean: Tensor
    var: Tensor
    frame: Tensor | None

    def __init__(self, in_features: int, out_features: int, frame: Tensor | None = None) -> None:
        mapped = in_features if frame is None else frame.shape[0]
        super().__init__(mapped, out_features)
        self.register_buffer("frame", frame, persistent=False)
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(mapped, dtype=torch.float64))
        self.register_buffer("var", torch.ones(mapped, dtype=torch.float64))

    def forward(self, x: Tensor) -> Tensor:
        """Returns the layer's output for raw inputs, (..., in_features) -> (..., out_features)."""
        std = self.var.sqrt()
        gain = torch.where(std < _MIN_STD, 1.0, 1 / std).to(x.dtype)
        weight = self.weight * gain
        bias = self.bias - weight @ self.mean.to(x.dtype)
        return nn.functional.linear(x, weight if self.frame is None else weight @ self.frame, bias)

    @torch.no_grad()
    def observe(self, x: Tensor) -> None:
        """Takes raw inputs (n, in_features) into the running mean and variance."""
        if not len(x):
            return
        x = x if self.frame is None else x @ self.frame.T
        x = x.to(torch.float64)
        n, mean, var = len(x), x.mean(0), x.var(0, correction=0)
        total = self.count + n
        shift = mean - self.mean
        pooled = self.var * self.count + var * n + shift.square() * self.count * n / total
        self.mean.add_(shift * n / total)
        self.var.copy_(pooled / total)
        self.count.copy_(total)


def pool(x: Tensor, mask: Tensor) -> Tensor:
    """Returns the mean of `x` (..., V, H) over the voxels of `mask` (..., V): (..., H)."""
    weights = mask.to(x.dtype)
    weights = weights / weights.sum(-1, keepdim=True).clamp_min(1)
    return torch.matmul(weights.unsqueeze(-2), x).squeeze(-2)


def orthogonal(layer: nn.Linear, gain: float = 1.0) -> None:
    """Sets orthogonal weights and zero biases (in place)."""
    nn.init.orthogonal_(layer.weight, gain)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
