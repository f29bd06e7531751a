"""EvoGym's genetic algorithm over bodies (Bhatia et al., 2021)."""

from collections.abc import Mapping
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from evogymcm._settings import check_array, check_count
from evogymcm.algos.codesign.body_search import BodySearchOptions, DesignSearch
from evogymcm.algos.codesign.design import Individual


def survivor_count(population: int, budget: int, n_designs: int) -> int:
    """Returns how many of a generation survive: max(2, ceil(P 0.6 (M - n - 1) / (M - 1))), at most all of them.

    P is the population, M the budget, and n the bodies proposed so far, this generation included.
    """
    # In integers: rounding errors of 0.6 must not add a survivor. -(-a // b) is the ceiling of a / b.
    share = -(-3 * population * (budget - n_designs - 1) // (5 * max(budget - 1, 1)))
    return min(max(2, share), population)


def check_population(population: int, budget: int) -> None:
    """Raises a ValueError where a population is larger than the budget, or too small for children."""
    if population > budget:
        raise ValueError(f"population: got {population}, expected 1 to {budget} (the budget of bodies)")
    if 3 > population < budget:
        raise ValueError(f"population: got {population}, expected at least 3, since 2 survive")


class GeneticAlgorithm(DesignSearch):
    """The genetic algorithm of EvoGym and of EvoGymCM's reference code: mutation and truncation, no crossover.

    The first generation is random. Of each generation the best survive, fewer as the budget runs out. They keep their
    fitness and are never proposed again; mutants of survivors, drawn uniformly, complete the population.

    Where designs carry stiffness, they start with 1 everywhere; a child inherits its parent's where a cell kept its
    type. (The reference code's children also keep the stiffness of some cells that changed their type: those changed in
    an attempt at mutation that gave no valid body.)

    With `age_protection` A, floor(k / 2) of the k survivors' places are for bodies in their first A generations, if
    there are enough: the best of these take them, and the best of all others the rest. New bodies then compete with
    each other first, and have some generations of fine-tuning to catch up with old ones. The best body always survives.
    A = 0 selects by fitness alone.

    Children may be selected before they are proposed: `mutants` gives several of one parent for each, `choose` takes
    the best by any score that costs less than fitness. Bodies that are not chosen count as never proposed.

    Args:
        shape: rows and columns of the bodies.
        budget: M, bodies proposed in all.
        population: P, individuals in a generation.
        age_protection: A, in generations.
        options: those of `DesignSearch`: seed, mutation_rate, attempts, carries_stiffness, weights.

    Raises:
        ValueError: The population is larger than the budget, or too small for children; or as `DesignSearch`.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        budget: int,
        population: int,
        *,
        age_protection: int = 0,
        **options: Unpack[BodySearchOptions],
    ) -> None:
        self.age_protection = check_count("age_protection", age_protection, 0)
        settings = {"age_protection": self.age_protection}
        super().__init__(shape, budget, population, settings=settings, **options)
        check_population(self.population_size, self.budget)
        self._mutants: list[list[Individual]] = []  # of the next children, waiting to be chosen from

    def mutants(self, count: int) -> list[list[Individual]]:
        """Returns `count` mutants of one parent for each child of the next generation, to `choose` from.

        All have new bodies, and no two the same. They stay the same until a choice is made; those of a child share
        the index that the chosen one will have.

        Raises:
            RuntimeError: No generation has survivors yet, new individuals are waiting for their fitness, the budget is
                used, or the shape has hardly any further body.
            ValueError: The count is below 1, or others of another count wait to be chosen from.
        """
        if not self._population or self._pending or self.is_finished:
            raise RuntimeError("mutants: must be asked for between a generation told and the next one asked for")
        if count < 1 or (self._mutants and len(self._mutants[0]) != count):
            waiting = f", {len(self._mutants[0])} are waiting" if self._mutants else ""
            raise ValueError(f"count: got {count}, expected at least 1{waiting}")
        if not self._mutants:
            parents, taken, groups = self.survivors, set[str](), list[list[Individual]]()
            n_children = min(self.population_size - len(parents), self.budget - self.n_designs)
            for index in range(self.n_designs, self.n_designs + n_children):
                parent = parents[self._rng.integers(len(parents))]
                group = []
                for _ in range(count):
                    design, _ = self._new(lambda: self._mutant([parent]), taken)  # noqa: B023 - called at once
                    taken.add(design.key)
                    group.append(Individual(index, design, parent.index, self.generation))
                groups.append(group)
            self._mutants = groups  # all of them, or none where bodies run out
        return [list(group) for group in self._mutants]

    def choose(self, scores: ArrayLike) -> None:
        """Takes the scores (children, count) of the mutants; the best mutant for each child is proposed.

        Raises:
            RuntimeError: There are no mutants to choose from.
            ValueError: The scores are of another number, or not finite; nothing has changed then.
        """
        if not self._mutants:
            raise RuntimeError("choose: mutants must be asked for first")
        values = check_array("scores", scores)
        expected = (len(self._mutants), len(self._mutants[0]))
        if values.shape != expected or not np.isfinite(values).all():
            got = f"shape {values.shape}" if values.shape != expected else "some that are not finite"
            raise ValueError(f"scores: got {got}, expected finite numbers of shape {expected}")
        self._population = self.survivors
        for group, pick in zip(self._mutants, values.argmax(1), strict=True):
            self._add(group[pick].design, group[pick].parent)
        self._mutants = []

    def state_dict(self) -> dict[str, Any]:
        """Returns the whole state, of JSON types, with the mutants that wait to be chosen from."""
        return super().state_dict() | {"mutants": [[item.record() for item in group] for group in self._mutants]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continues from where `state_dict` was called, see `DesignSearch.load_state_dict`."""
        super().load_state_dict(state)
        self._mutants = [[Individual.from_record(record) for record in group] for group in state["mutants"]]

    def _propose(self) -> None:
        if self._mutants:
            raise RuntimeError("ask: mutants are waiting to be chosen from")
        if not self._population:
            self._fill(self.population_size, self._random)
            return
        parents = self.survivors
        self._population = list(parents)  # a copy: children join it, and must not become parents yet
        self._fill(self.population_size - len(parents), lambda: self._mutant(parents))

    def _select(self) -> list[Individual]:
        count = survivor_count(self.population_size, self.budget, self.n_designs)
        newest = self.generation - self.age_protection
        young = [item for item in self._population if item.generation > newest][: count // 2]
        protected = {item.index for item in young}
        others = [item for item in self._population if item.index not in protected]
        return young + others[: count - len(young)]
