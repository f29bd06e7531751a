"""What a voxel knows of the rest of its body: kinds of context that a per-voxel policy can be given.

Each takes what the voxels encode of themselves, (..., V, H), and returns what is added to their hidden layer,
(..., V, H) or (..., 1, H). None depends on padding, and none has weights that depend on a body or a grid's size.
"""

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from evogymcm._settings import check_choice
from evogymcm.algos.learning.config import CONTEXTS
from evogymcm.algos.learning.layers import Dense, pool


class Context(nn.Module):
    """Nothing: the plain local network, in which a voxel knows its own surroundings only.

    Args:
        hidden: H, width of what voxels encode.
        copies: as for `Dense`.
        generator: as for `Dense`.
    """

    needs_grid = False  # whether it depends on the places of voxels in the grid

    def __init__(self, hidden: int, copies: int | None = None, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.hidden = hidden

    def forward(self, encoded: Tensor, occupancy: Tensor, types: Tensor, columns: int) -> Tensor:
        """Returns what is added to the voxels' hidden layer.

        Args:
            encoded: (..., V, H) what each voxel encodes.
            occupancy: (..., V) bool.
            types: (..., V, 5) codes of each voxel and its connected neighbours.
            columns: of the padded grid.
        """
        return torch.zeros(self.hidden, dtype=encoded.dtype, device=encoded.device)


class BodyContext(Context):
    """The mean over the body."""

    def __init__(self, hidden: int, copies: int | None = None, generator: torch.Generator | None = None) -> None:
        super().__init__(hidden, copies, generator)
        self.body = Dense(hidden, hidden, bias=False, copies=copies, generator=generator)
        self.body.orthogonal(math.sqrt(2), generator)

    def forward(self, encoded: Tensor, occupancy: Tensor, types: Tensor, columns: int) -> Tensor:
        """Returns (..., 1, H)."""
        return self.body(pool(encoded, occupancy)).unsqueeze(-2)


class MessageContext(BodyContext):
    """A message from each connected neighbour, weighted by its side, and the mean over the body."""

    needs_grid = True

    def __init__(self, hidden: int, copies: int | None = None, generator: torch.Generator | None = None) -> None:
        super().__init__(hidden, copies, generator)
        self.neighbours = Dense(4 * hidden, hidden, bias=False, copies=copies, generator=generator)

    def forward(self, encoded: Tensor, occupancy: Tensor, types: Tensor, columns: int) -> Tensor:
        """Returns (..., V, H)."""
        grid = pad(encoded.unflatten(-2, (-1, columns)), (0, 0, 1, 1, 1, 1))
        sides = (grid[..., :-2, 1:-1, :], grid[..., 1:-1, 2:, :], grid[..., 2:, 1:-1, :], grid[..., 1:-1, :-2, :])
        messages = torch.stack(sides, -2).flatten(-4, -3)  # (..., V, 4, H)
        messages = messages * (types[..., 1:] > 0).unsqueeze(-1)
        return super().forward(encoded, occupancy, types, columns) + self.neighbours(messages.flatten(-2))


class AttentionContext(Context):
    """What each voxel asks of all others: one head of dot-product attention."""

    def __init__(self, hidden: int, copies: int | None = None, generator: torch.Generator | None = None) -> None:
        super().__init__(hidden, copies, generator)
        self.query, self.key, self.value = (
            Dense(hidden, hidden, bias=False, copies=copies, generator=generator) for _ in range(3)
        )
        self.value.orthogonal(math.sqrt(2), generator)

    def forward(self, encoded: Tensor, occupancy: Tensor, types: Tensor, columns: int) -> Tensor:
        """Returns (..., V, H)."""
        scores = self.query(encoded) @ self.key(encoded).transpose(-1, -2) / math.sqrt(self.hidden)
        weights = scores.masked_fill(~occupancy.unsqueeze(-2), -1e9).softmax(-1)
        return weights @ self.value(encoded)


_KINDS: Mapping[str, type[Context]] = dict(
    zip(CONTEXTS, (Context, BodyContext, MessageContext, AttentionContext), strict=True)
)


def make_context(kind: str, hidden: int, **options: Any) -> Context:
    """Returns a context of one of the kinds in `CONTEXTS`.

    Raises:
        ValueError: There is no such kind.
    """
    return _KINDS[check_choice("context", kind, CONTEXTS)](hidden, **options)
