"""Random search over bodies."""

from evogymcm.algos.codesign.body_search import DesignSearch
from evogymcm.algos.codesign.design import Individual


class RandomSearch(DesignSearch):
    """Random bodies, each trained once: the floor that every other method has to beat.

    The population is all bodies so far; none survives to be improved further. It takes the options of
    `DesignSearch`, those of mutation without any effect.
    """

    @property
    def parents(self) -> list[Individual]:
        """None: every body is random."""
        return []

    def _propose(self) -> None:
        self._fill(self.population_size, self._random)

    def _select(self) -> list[Individual]:
        return []
