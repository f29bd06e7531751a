"""MAP-Elites (Mouret and Clune, 2015) over designs, with the archive of pyribs (Tjanaka et al., 2023)."""

from collections.abc import Mapping
from dataclasses import replace
from math import log
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from evogymcm._extras import load_extra
from evogymcm._settings import check_count, check_number, check_pair
from evogymcm.algos.codesign.body_search import BodySearchOptions, DesignSearch
from evogymcm.algos.codesign.design import Design, Individual
from evogymcm.algos.codesign.stiffness_proposals import perturb_stiffness
from evogymcm.body import STIFFNESS_HIGH, STIFFNESS_LOW


def design_measures(design: Design) -> tuple[float, float]:
    """Returns what distinguishes designs: actuators per voxel, in [0, 1], and mean stiffness of the voxels."""
    body = design.body
    return body.n_actuators / body.n_voxels, float(design.field[body.occupancy].mean())


class MapElites(DesignSearch):
    """Keeps the best design of each kind, and proposes mutants of them.

    A kind is a cell of a grid over `design_measures`. The first designs are random; later ones are mutants of elites
    drawn uniformly. Where designs carry stiffness, a random one has the same value on all voxels, log-uniform in
    [0.5, 2], and a mutant's inherited field gets noise too, since mean stiffness would hardly vary otherwise; where
    they do not, it is 1, and the grid should have one column.

    The population is all designs so far, the survivors are the elites that were told last: each can be improved
    (`update`) once, when it is new.

    Args:
        shape: rows and columns of the bodies.
        budget: M, bodies proposed in all.
        population: P, bodies proposed at a time.
        initial: random bodies before mutants; `population` by default, and whole generations always.
        dims: cells of the grid along either measure.
        probability: how likely a voxel's stiffness is to change in a mutant.
        sigma: standard deviation of that change, in the logarithm.
        options: options of `DesignSearch`: seed, mutation_rate, attempts, carries_stiffness, weights.

    Attributes:
        archive: the `ribs.archives.GridArchive`, for its statistics and plots; its solutions are indices.

    Raises:
        ValueError: A count is below 1, or a rate or probability out of range.
        ImportError: The package ribs is missing.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        budget: int,
        population: int,
        *,
        initial: int | None = None,
        dims: tuple[int, int] = (10, 10),
        probability: float = 0.15,
        sigma: float = 0.2,
        **options: Unpack[BodySearchOptions],
    ) -> None:
        archives = load_extra("ribs.archives", "MapElites needs pyribs", "qd")
        population = check_count("population", population)
        self.initial = population if initial is None else check_count("initial", initial)
        across, down = check_pair("dims", dims)
        dims = check_count("dims", across), check_count("dims", down)
        self.probability = check_number("probability", probability, low=0.0, high=1.0)
        self.sigma = check_number("sigma", sigma, low=0.0)
        settings = {
            "initial": self.initial,
            "dims": list(dims),
            "probability": self.probability,
            "sigma": self.sigma,
        }
        super().__init__(shape, budget, population, settings=settings, **options)
        ranges = [(0.0, 1.0), (STIFFNESS_LOW, STIFFNESS_HIGH)]
        self.archive = archives.GridArchive(solution_dim=1, dims=dims, ranges=ranges, seed=self.settings["seed"])

    @property
    def elites(self) -> list[Individual]:
        """The best individual of each kind found so far, best first."""
        indices = set(self.archive.data("solution")[:, 0].astype(int).tolist())
        return [individual for individual in self.population if individual.index in indices]

    @property
    def parents(self) -> list[Individual]:
        """All whose fitness is told: an elite that moves to another kind may give way to one that it had displaced."""
        return [individual for individual in self.population if individual.fitness is not None]

    def update(self, index: int, *, stiffness: ArrayLike | None = None, fitness: float | None = None) -> None:
        """Replaces a survivor's stiffness, fitness or both, see `DesignSearch.update`; its kind may change by it."""
        super().update(index, stiffness=stiffness, fitness=fitness)
        self._fill_archive()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from where `state_dict` was called, see `DesignSearch.load_state_dict`."""
        super().load_state_dict(state)
        self._fill_archive()

    def _propose(self) -> None:
        if self.n_designs < self.initial:
            self._fill(self.population_size, self._random_kind)
        else:
            parents = self.elites
            self._fill(self.population_size, lambda: self._child(parents))

    def _random_kind(self) -> tuple[Design, None]:
        """A random body, with a uniform field where designs have one, for `_fill`."""
        design, _ = self._random()
        if self.carries_stiffness:
            level = np.exp(self._rng.uniform(log(STIFFNESS_LOW), log(STIFFNESS_HIGH)))
            design = replace(design, stiffness=np.full(self.shape, np.clip(level, STIFFNESS_LOW, STIFFNESS_HIGH)))
        return design, None

    def _child(self, parents: list[Individual]) -> tuple[Design | None, int]:
        """A mutant, with noise on the field that it inherits, for `_fill`."""
        child, parent = self._mutant(parents)
        if child is not None and self.carries_stiffness:
            child = replace(child, stiffness=perturb_stiffness(child, self._rng, self.probability, self.sigma))
        return child, parent

    def _select(self) -> list[Individual]:
        self._fill_archive()
        return [individual for individual in self.elites if individual.generation == self.generation]

    def _fill_archive(self) -> None:
        """Builds the archive anew from all individuals, as an update may have moved an elite to another cell."""
        self.archive.clear()
        told = [individual for individual in self._population if individual.fitness is not None]
        if told:
            self.archive.add(
                np.array([[individual.index] for individual in told]),
                np.array([individual.fitness for individual in told]),
                np.array([design_measures(individual.design) for individual in told]),
            )
