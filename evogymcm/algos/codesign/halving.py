"""Budgets of training by successive halving."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, isfinite

from evogymcm._settings import check_numbers

__all__ = ["HalvingSchedule"]


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

    def promote(self, fitness: Mapping[int, float], rung: int) -> list[int]:
        """Returns the indices of the bodies that go on, best first; of equals, those that come first in `fitness`.

        Args:
            fitness: the bodies that reached the rung, by index, with what they reached.
            rung: which one, counted from 0.

        Raises:
            ValueError: There is no such rung, or a fitness is not finite.
        """
        if not 0 <= rung < len(self.rungs):
            raise ValueError(f"rung: got {rung}, expected 0 to {len(self.rungs) - 1}")
        if not all(isfinite(value) for value in fitness.values()):
            raise ValueError(f"fitness: got {dict(fitness)}, all must be finite")
        ranked = sorted(fitness, key=lambda index: -fitness[index])
        return ranked[: self.count(rung, len(ranked))]

    def cost(self, n_bodies: int) -> float:
        """Returns the training of `n_bodies` in full budgets: `n_bodies` without halving."""
        total, reached = 0.0, 0.0
        for rung, share in enumerate(self.rungs):
            total += n_bodies * (share - reached)
            n_bodies, reached = self.count(rung, n_bodies), share
        return total + n_bodies * (1.0 - reached)
