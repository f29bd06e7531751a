"""Random search over bodies."""

from collections.abc import Sequence

from evogymcm._settings import check_count
from evogymcm.algos.codesign.body_search import DesignSearch
from evogymcm.algos.codesign.design import Individual
from evogymcm.body import SAMPLE_WEIGHTS

__all__ = ["RandomSearch"]


class RandomSearch(DesignSearch):
    """Random bodies, each trained once: the floor that every other method has to beat.

    The population is all bodies so far; none survives in the sense of being worked on further.

    Args:
        shape: rows and columns of the bodies.
        budget: bodies proposed in all.
        batch: bodies proposed at a time.
        seed: of all random draws.
        weights: see `DesignSearch`.

    Raises:
        ValueError: A count is below 1.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        budget: int,
        batch: int,
        seed: int,
        weights: Sequence[float] = SAMPLE_WEIGHTS,
    ) -> None:
        batch = check_count("batch", batch)
        super().__init__(shape, budget, seed=seed, carries_stiffness=False, settings={"batch": batch}, weights=weights)
        self.batch = batch

    def _propose(self) -> None:
        self._fill(self.batch, self._random)

    @property
    def parents(self) -> list[Individual]:
        """None: every body is random."""
        return []

    def _select(self) -> list[Individual]:
        return []
