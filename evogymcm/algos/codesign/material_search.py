"""Search for the stiffness fields of given bodies under given policies: EvoGymCM's local search, and CMA-ES."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evogymcm._settings import check_array
from evogymcm.algos.codesign.body_search import check_settings
from evogymcm.algos.codesign.config import SearchConfig
from evogymcm.algos.codesign.design import Design, Individual
from evogymcm.algos.codesign.stiffness_proposals import CMA, HillClimber

_MARGIN = 0.02  # of the best score's size: the least gain that the reference code accepts

Field = NDArray[np.float64]


class Materials(NamedTuple):
    """Stiffness fields (n, rows, cols) and their scores (n,)."""

    fields: Field
    scores: Field


class MaterialSearch:
    """Searches the stiffness fields of all survivors together, each on its own body and under its own policy.

    In every round each survivor gets `candidates` proposals, made from the best field so far; the best of them is
    accepted or rejected. The score never falls. A survivor's proposals depend on the seed, its index and its own scores
    only, not on who is searched beside it.

    Args:
        individuals: the survivors, of one shape, with their fitness: the score that their fields have to beat.
        seed: seed of all random draws; use a different one for each generation, such as (seed, generation).
        options: the fields of `SearchConfig`. Acceptance "reference" takes a new score R' over the best R if
            R' >= R + 0.02 |R| (EvoGymCM's reference code), "paper" if R' > R. Proposal "cma" is one CMA-ES per survivor
            with a population of `candidates` (needs the extra `evogymcm[cma]`), and has noise of its own.

    Attributes:
        settings: all settings, of JSON types.
        n_rounds: rounds told so far.

    Raises:
        ValueError: There is no individual, one has no fitness, an index repeats, shapes differ, an option has no such
            value, or a number is out of range.
        ImportError: The package for CMA-ES is missing.
    """

    def __init__(self, individuals: Sequence[Individual], *, seed: int | Sequence[int], **options: Any) -> None:
        self.config = SearchConfig(**options)
        _check_individuals(individuals)
        self.individuals = list(individuals)
        records = [individual.record() for individual in self.individuals]
        self.settings = {"seed": np.asarray(seed).tolist(), **asdict(self.config), "individuals": records}
        self._start()

    def _start(self) -> None:
        """Sets the state before the first round."""
        self.n_rounds = 0
        self._best = [individual.design for individual in self.individuals]
        self._scores = np.array([individual.fitness for individual in self.individuals], dtype=np.float64)
        self._told: list[list[float]] = []
        self._history = [self._scores.copy()]
        self._asked: list[list[Field]] = []
        self._proposers: list[HillClimber | CMA] = []
        for individual in self.individuals:
            rng = np.random.default_rng(np.random.SeedSequence(self.settings["seed"], spawn_key=(individual.index,)))
            if self.config.proposal == "cma":
                self._proposers.append(CMA(individual.design, rng, self.config))
            else:
                self._proposers.append(HillClimber(rng, self.config))

    @property
    def is_finished(self) -> bool:
        """Whether all rounds have been told."""
        return self.n_rounds >= self.config.rounds

    @property
    def best(self) -> Materials:
        """The best fields (n, rows, cols) and their scores (n,), in the order of the individuals."""
        return Materials(np.stack([design.field for design in self._best]), self._scores.copy())

    @property
    def history(self) -> Field:
        """Best scores (1 + n_rounds, n): at the start and after each round."""
        return np.stack(self._history)

    def ask(self) -> Field:
        """Returns the fields to be scored, (n * candidates, rows, cols), those of the first individual first.

        They stay the same until their scores are told.

        Raises:
            RuntimeError: All rounds are over.
        """
        if self.is_finished:
            raise RuntimeError(f"ask: all {self.config.rounds} rounds are over")
        if not self._asked:
            self._asked = [proposer.ask(best) for proposer, best in zip(self._proposers, self._best, strict=True)]
        return np.stack([field for fields in self._asked for field in fields])

    def tell(self, scores: ArrayLike) -> NDArray[np.bool_]:
        """Takes the scores (n * candidates,) of the fields; returns (n,) whether each individual's best was accepted.

        Raises:
            RuntimeError: Nothing has been asked for.
            ValueError: The scores are of another number, or not finite; nothing has changed then.
        """
        if not self._asked:
            raise RuntimeError("tell: nothing has been asked for")
        values = check_array("scores", scores)
        accepted = np.zeros(len(self.individuals), dtype=bool)
        n = len(self.individuals) * self.config.candidates
        if values.shape != (n,) or not np.isfinite(values).all():
            raise ValueError(f"scores: got {values}, expected {n} finite numbers")
        for i, own in enumerate(values.reshape(-1, self.config.candidates)):
            self._proposers[i].tell(own)
            pick = int(own.argmax())
            accepted[i] = self._accepts(own[pick], self._scores[i])
            if accepted[i]:
                self._best[i] = Design(self._best[i].body, self._asked[i][pick])
                self._scores[i] = own[pick]
        self._asked = []
        self._told.append(values.tolist())
        self._history.append(self._scores.copy())
        self.n_rounds += 1
        return accepted

    def _accepts(self, score: float, best: float) -> bool:
        """Whether a score replaces the best so far."""
        # With R = 0 the reference code's rule takes an equal score too.
        return score > best if self.config.acceptance == "paper" else score >= best + _MARGIN * abs(best)

    def state_dict(self) -> dict[str, Any]:
        """Returns the settings and all scores told, of JSON types, from which the search can be repeated."""
        return {"settings": self.settings, "told": [list(scores) for scores in self._told]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continues from where `state_dict` was called, by telling the scores again.

        Raises:
            ValueError: The state is of a search with other settings or individuals.
        """
        check_settings(self.settings, state["settings"])
        self._start()
        for scores in state["told"]:
            self.ask()
            self.tell(scores)


def _check_individuals(individuals: Sequence[Individual]) -> None:
    """Raises a ValueError where these cannot be searched together."""
    if not individuals:
        raise ValueError("individuals: got none, at least one is needed")
    indices, shapes = [item.index for item in individuals], {item.design.body.shape for item in individuals}
    if len(set(indices)) < len(indices):
        raise ValueError(f"individuals: got indices {indices}, each may occur once")
    if len(shapes) > 1:
        raise ValueError(f"individuals: got shapes {sorted(shapes)}, all must be equal")
    without = [item.index for item in individuals if item.fitness is None]
    if without:
        raise ValueError(f"individuals: {without} have no fitness, the score to begin with")
