"""Budgets of training by successive halving."""

from dataclasses import dataclass
from itertools import pairwise
from math import ceil

from evogymcm._settings import check_numbers


@dataclass(frozen=True)
class HalvingSchedule:
    """Successive halving (Jamieson and Talwalkar, 2016): all bodies train a little, the better ones go on.

    Attributes:
        rungs: shares of the full budget of training after which bodies are compared, rising, each between 0 and 1.
        keep: share of the bodies compared at each rung that go on, each above 0 and at most 1.

    Raises:
        ValueError: The rungs do not rise within 0 to 1, or there is not one share in (0, 1] for each.
    """

    rungs: tuple[float, ...] = (0.25, 0.5)
    keep: tuple[float, ...] = (0.5, 0.5)

    def __post_init__(self) -> None:
        for name in ("rungs", "keep"):
            object.__setattr__(self, name, check_numbers(name, getattr(self, name)))
        bounds = (0.0, *self.rungs, 1.0)
        if not all(low < high for low, high in pairwise(bounds)):
            raise ValueError(f"rungs: got {self.rungs}, expected rising shares of the budget, above 0 and below 1")
        if len(self.keep) != len(self.rungs) or not all(0.0 < share <= 1.0 for share in self.keep):
            raise ValueError(f"keep: got {self.keep}, expected {len(self.rungs)} shares, above 0 and at most 1")

    def count(self, rung: int, n_bodies: int) -> int:
        """Returns how many of `n_bodies` go on after a rung: the share kept, rounded up."""
        return ceil(round(self.keep[rung] * n_bodies, 9))  # rounded before: 0.07 * 100 is above 7 in floats

    def cost(self, n_bodies: int) -> float:
        """Returns the training of `n_bodies` in full budgets: `n_bodies` without halving."""
        total, reached = 0.0, 0.0
        for rung, share in enumerate(self.rungs):
            total += n_bodies * (share - reached)
            n_bodies, reached = self.count(rung, n_bodies), share
        return total + n_bodies * (1.0 - reached)
