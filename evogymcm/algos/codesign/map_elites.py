"""MAP-Elites (Mouret and Clune, 2015) over designs, with the archive of pyribs (Tjanaka et al., 2023)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import log
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from evogymcm._settings import check_count, check_number, check_pair
from evogymcm.algos.codesign.body_search import DesignSearch
from evogymcm.algos.codesign.design import Design, Individual, check_mutation, mutate_design
from evogymcm.algos.codesign.stiffness_proposals import perturb_stiffness
from evogymcm.body import SAMPLE_WEIGHTS, STIFFNESS_HIGH, STIFFNESS_LOW

__all__ = ["MapElites", "design_measures"]


def design_measures(design: Design) -> tuple[float, float]:
    """Returns what tells designs apart here: actuators per voxel, in [0, 1], and mean stiffness of the voxels."""
    body = design.body
    return body.n_actuators / body.n_voxels, float(design.field[body.occupancy].mean())


class MapElites(DesignSearch):
    """Keeps the best design of each kind, and proposes mutants of them.

    A kind is a cell of a grid over `design_measures`. The first designs are random; later ones are mutants of elites
    drawn uniformly. Where designs carry stiffness, a random one has the same value on all voxels, log-uniform in
    [0.5, 2], and a mutant's inherited field gets noise too, since mean stiffness would hardly vary otherwise; where
    they do not, it is 1, and the grid should have one column.

    The population is all designs so far, the survivors are those elites that were told last: each is worked on further
    (`update`) once, when it is new.

    Args:
        shape: rows and columns of the bodies.
        budget: bodies proposed in all.
        batch: bodies proposed at a time.
        seed: of all random draws.
        initial: random bodies before mutants; `batch` by default, and whole batches always.
        dims: cells of the grid along either measure.
        mutation_rate: probability that a cell is drawn anew, see `mutate_body`.
        attempts: at a valid mutant, before another parent is drawn.
        carries_stiffness: whether stiffness belongs to the design (the invariant setting).
        probability: of a voxel's stiffness to change in a mutant.
        sigma: standard deviation of that change, in the logarithm.
        weights: see `DesignSearch`.

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
        batch: int,
        *,
        seed: int,
        initial: int | None = None,
        dims: tuple[int, int] = (10, 10),
        mutation_rate: float = 0.1,
        attempts: int = 50,
        carries_stiffness: bool = True,
        probability: float = 0.15,
        sigma: float = 0.2,
        weights: Sequence[float] = SAMPLE_WEIGHTS,
    ) -> None:
        try:
            from ribs.archives import GridArchive
        except ImportError as error:
            raise ImportError("MapElites needs pyribs: pip install evogymcm[qd]") from error
        batch = check_count("batch", batch)
        initial = batch if initial is None else check_count("initial", initial)
        across, down = check_pair("dims", dims)
        dims = check_count("dims", across), check_count("dims", down)
        mutation_rate, attempts = check_mutation(mutation_rate, attempts)
        probability = check_number("probability", probability, low=0.0, high=1.0)
        sigma = check_number("sigma", sigma, low=0.0)
        settings = {
            "batch": batch,
            "initial": initial,
            "dims": list(dims),
            "mutation_rate": mutation_rate,
            "attempts": attempts,
            "probability": probability,
            "sigma": sigma,
        }
        super().__init__(
            shape, budget, seed=seed, carries_stiffness=carries_stiffness, settings=settings, weights=weights
        )
        self.batch, self.initial = batch, initial
        self.mutation_rate, self.attempts = mutation_rate, attempts
        self.probability, self.sigma = probability, sigma
        ranges = [(0.0, 1.0), (STIFFNESS_LOW, STIFFNESS_HIGH)]
        self.archive = GridArchive(solution_dim=1, dims=dims, ranges=ranges, seed=seed)

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
            self._fill(self.batch, self._random_kind)
        else:
            parents = self.elites
            self._fill(self.batch, lambda: self._child(parents))

    def _random_kind(self) -> tuple[Design, None]:
        """A random body, with a uniform field where designs have one, for `_fill`."""
        design, _ = self._random()
        if self.carries_stiffness:
            level = np.exp(self._rng.uniform(log(STIFFNESS_LOW), log(STIFFNESS_HIGH)))
            design = replace(design, stiffness=np.full(self.shape, np.clip(level, STIFFNESS_LOW, STIFFNESS_HIGH)))
        return design, None

    def _child(self, parents: list[Individual]) -> tuple[Design | None, int]:
        """A mutant of one of the parents, for `_fill`."""
        parent = parents[self._rng.integers(len(parents))]
        child = mutate_design(parent.design, self._rng, self.mutation_rate, self.attempts, self.weights)
        if child is not None and self.carries_stiffness:
            child = replace(child, stiffness=perturb_stiffness(child, self._rng, self.probability, self.sigma))
        return child, parent.index

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
