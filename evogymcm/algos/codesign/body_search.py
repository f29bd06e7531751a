"""The ask/tell protocol of all searches over bodies. Knows no simulator."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Required, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from evogymcm._settings import check_array, check_count, check_number, check_pair
from evogymcm.algos.codesign.design import Design, Individual, mutate_design
from evogymcm.body import H_ACT, SAMPLE_WEIGHTS, V_ACT, check_weights, sample_body

Draw = Callable[[], tuple[Design | None, int | None]]  # gives a design, None where that failed, and its parent
_MAX_FAILURES = 10_000  # draws in a row without a new body, before the bodies of a shape count as used up


class BodySearchOptions(TypedDict, total=False):
    """What every body search takes by name, see `DesignSearch`."""

    seed: Required[int]
    mutation_rate: float
    attempts: int
    carries_stiffness: bool
    weights: Sequence[float]


class DesignSearch(ABC):
    """Proposes designs (`ask`) and learns from their fitness (`tell`), until a budget of bodies is used.

    No body is proposed twice. Between `tell` and `ask`, survivors may be improved by other means (`update`).

    Args:
        shape: rows and columns of the bodies.
        budget: M, how many bodies are proposed in all.
        population: P, individuals in a generation.
        seed: seed of all random draws.
        mutation_rate: probability that a cell of a mutant is drawn anew, see `mutate_body`.
        attempts: attempts at a valid mutant before another parent is drawn.
        carries_stiffness: whether stiffness belongs to the design (the invariant setting).
        weights: relative frequencies of the codes 0 to 4 in random bodies and in cells drawn anew (EvoGym's by
            default); a larger first one gives bodies of fewer voxels.
        settings: the method's own settings, of JSON types.

    Attributes:
        settings: all settings, of JSON types; a saved state can be loaded only if they are equal.
        n_designs: bodies proposed so far.
        generation: number of the next generation, counted from 0; equal to the number of those told.

    Raises:
        ValueError: The shape has no cell, the budget is 0 or more than there are bodies, a number is of the wrong kind
            or out of range, or the weights are not as for `sample_body`.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        budget: int,
        population: int,
        *,
        seed: int,
        mutation_rate: float = 0.1,
        attempts: int = 50,
        carries_stiffness: bool = False,
        weights: Sequence[float] = SAMPLE_WEIGHTS,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        rows, cols = (check_count("shape", side) for side in check_pair("shape", shape))
        self.shape, self.budget = (rows, cols), check_count("budget", budget)
        self.population_size = check_count("population", population)
        self.mutation_rate = check_number("mutation_rate", mutation_rate, above=0.0, high=1.0)
        self.attempts = check_count("attempts", attempts)
        self.carries_stiffness, self.weights = carries_stiffness, check_weights(weights)
        check_budget(self.shape, self.budget, self.weights)
        self.settings = {
            "method": type(self).__name__,
            "shape": list(self.shape),
            "budget": self.budget,
            "population": self.population_size,
            "seed": check_count("seed", seed, 0),
            "mutation_rate": self.mutation_rate,
            "attempts": self.attempts,
            "carries_stiffness": carries_stiffness,
            "weights": list(self.weights),
            **(settings or {}),
        }
        self.n_designs = self.generation = 0
        self._rng = np.random.default_rng(seed)
        self._seen: set[str] = set()
        self._population: list[Individual] = []  # in the order of the last tell, then those asked for since
        self._survivors: list[int] = []
        self._pending: list[int] = []

    @property
    def is_finished(self) -> bool:
        """Whether the budget is used and all fitness told."""
        return self.n_designs >= self.budget and not self._pending

    @property
    def population(self) -> list[Individual]:
        """The current individuals: after `tell` best first, after `ask` survivors, then new ones."""
        # Always sorted from the order of the last tell, so that ties do not depend on the order of updates.
        return list(self._population) if self._pending else sorted(self._population, key=_worst_last)

    @property
    def survivors(self) -> list[Individual]:
        """The individuals selected by the last `tell`, best first; `update` may improve them."""
        return [individual for individual in self.population if individual.index in self._survivors]

    @property
    def parents(self) -> list[Individual]:
        """The individuals whose mutants may be proposed, now or later: here the survivors."""
        return self.survivors

    @property
    def best(self) -> Individual:
        """The individual with the largest fitness in the population, the first if several are equal.

        Raises:
            RuntimeError: No fitness has been told yet.
        """
        for individual in self.population:
            if individual.fitness is not None:
                return individual
        raise RuntimeError("best: no fitness has been told yet")

    def ask(self) -> list[Individual]:
        """Returns the individuals to be trained now, all of them new; the same ones until their fitness is told.

        Raises:
            RuntimeError: The budget is used, or hardly any new body of this shape is left. There is no new individual
                then.
        """
        if self.is_finished:
            raise RuntimeError(f"ask: the budget of {self.budget} bodies is used")
        if not self._pending:
            kept = list(self._population), set(self._seen), self.n_designs
            self._population = self.population
            try:
                self._propose()
            except RuntimeError:
                self._population, self._seen, self.n_designs = kept
                self._pending = []
                raise
        return [individual for individual in self._population if individual.index in self._pending]

    def tell(self, fitness: Mapping[int, float]) -> None:
        """Takes the fitness of all individuals asked for, by index, and selects survivors.

        Raises:
            ValueError: The indices are not those asked for, or a fitness is not finite; nothing has changed then.
        """
        if fitness.keys() != set(self._pending):
            raise ValueError(f"fitness: got indices {sorted(fitness)}, expected {sorted(self._pending)}")
        values = {index: check_number(f"fitness of {index}", value) for index, value in fitness.items()}
        told = [replace(item, fitness=values.get(item.index, item.fitness)) for item in self._population]
        self._pending = []
        self._population = sorted(told, key=_worst_last)
        self._survivors = [individual.index for individual in self._select()]
        self.generation += 1

    def update(self, index: int, *, stiffness: ArrayLike | None = None, fitness: float | None = None) -> None:
        """Replaces a survivor's stiffness, fitness or both, after `tell` and before the next `ask`.

        The survivors stay the same; they and the population are sorted again.

        Args:
            index: number of the survivor.
            stiffness: (rows, cols) its new field; None leaves the old one.
            fitness: its new fitness; None leaves the old one.

        Raises:
            RuntimeError: New individuals are waiting for their fitness.
            ValueError: It is not a survivor, the fitness is not finite, the field does not fit the body, or designs of
                this search have no stiffness.
        """
        if self._pending:
            raise RuntimeError(f"update: the fitness of {self._pending} must be told first")
        if index not in self._survivors:
            raise ValueError(f"index: got {index}, expected one of the survivors {self._survivors}")
        if stiffness is not None and not self.carries_stiffness:
            raise ValueError("stiffness: belongs to a design only where carries_stiffness is set")
        place = next(i for i, individual in enumerate(self._population) if individual.index == index)
        individual = self._population[place]
        if fitness is not None:
            individual = replace(individual, fitness=check_number("fitness", fitness))
        if stiffness is not None:
            design = Design(individual.design.body, check_array("stiffness", stiffness))
            individual = replace(individual, design=design)
        self._population[place] = individual

    def state_dict(self) -> dict[str, Any]:
        """Returns the whole state, of JSON types."""
        return {
            "settings": dict(self.settings),
            "rng": self._rng.bit_generator.state,
            "n_designs": self.n_designs,
            "generation": self.generation,
            "population": [individual.record() for individual in self._population],
            "survivors": list(self._survivors),
            "pending": list(self._pending),
            "seen": sorted(self._seen),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continues exactly from where `state_dict` was called.

        Raises:
            ValueError: The state is of a search with other settings.
        """
        saved = dict(state["settings"])
        if "batch" in saved:  # before, a population was called so, and random search had no rate of mutation
            size = saved.pop("batch")
            saved = self.settings | saved | {"population": size}
        check_settings(self.settings, saved)
        self._rng.bit_generator.state = state["rng"]
        self.n_designs, self.generation = state["n_designs"], state["generation"]
        self._population = [Individual.from_record(record) for record in state["population"]]
        self._survivors, self._pending = list(state["survivors"]), list(state["pending"])
        self._seen = set(state["seen"])

    @abstractmethod
    def _propose(self) -> None:
        """Reduces the population to those that stay, and adds new individuals with `_fill`."""

    @abstractmethod
    def _select(self) -> list[Individual]:
        """Returns the survivors of the population, which is sorted best first."""

    def _fill(self, count: int, draw: Draw) -> None:
        """Adds `count` individuals with new bodies, fewer where the budget ends."""
        while len(self._pending) < count and self.n_designs < self.budget:
            self._add(*self._new(draw))

    def _new(self, draw: Draw, taken: Collection[str] = ()) -> tuple[Design, int | None]:
        """Draws until there is a design whose body was never proposed, and is none of those `taken`."""
        for _ in range(_MAX_FAILURES):
            design, parent = draw()
            if design is not None and design.key not in self._seen and design.key not in taken:
                return design, parent
        raise RuntimeError(
            f"ask: no new body in {_MAX_FAILURES} draws of shape {self.shape} after {len(self._seen)} bodies; "
            "choose a smaller budget, a larger shape or a higher rate of mutation"
        )

    def _add(self, design: Design, parent: int | None) -> None:
        """Adds a new individual, whose fitness is waited for."""
        self._seen.add(design.key)
        self._population.append(Individual(self.n_designs, design, parent, self.generation))
        self._pending.append(self.n_designs)
        self.n_designs += 1

    def _random(self) -> tuple[Design, None]:
        """A random body without a parent, for `_fill`."""
        return Design(sample_body(self.shape, self._rng, self.weights)), None

    def _mutant(self, parents: list[Individual]) -> tuple[Design | None, int]:
        """A mutant of one of the parents, drawn uniformly, for `_fill`."""
        parent = parents[self._rng.integers(len(parents))]
        settings = (self.mutation_rate, self.attempts, self.weights)
        return mutate_design(parent.design, self._rng, *settings), parent.index


def check_budget(shape: tuple[int, int], budget: int, weights: Sequence[float]) -> None:
    """Raises a ValueError where there are fewer grids with an actuator; not all of those are connected."""
    cells, is_drawn = shape[0] * shape[1], [weight > 0.0 for weight in weights]
    codes = sum(is_drawn)
    possible = codes**cells - (codes - is_drawn[H_ACT] - is_drawn[V_ACT]) ** cells
    if budget > possible:
        raise ValueError(f"budget: got {budget}, there are at most {possible} bodies of shape {shape}")


def check_settings(own: Mapping[str, Any], saved: Mapping[str, Any]) -> None:
    """Raises a ValueError naming the settings in which a saved state differs."""
    differing = sorted(key for key in own.keys() | saved.keys() if own.get(key) != saved.get(key))
    if differing:
        changes = "; ".join(f"{key}: got {own.get(key)}, the state has {saved.get(key)}" for key in differing)
        raise ValueError(f"cannot load a state of other settings: {changes}")


def _worst_last(individual: Individual) -> float:
    """Key that sorts best first; sorting with it keeps the order of equals."""
    assert individual.fitness is not None
    return -individual.fitness
