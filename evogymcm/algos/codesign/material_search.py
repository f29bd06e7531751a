"""Search for the stiffness fields of given bodies under given policies: EvoGymCM's local search, and CMA-ES."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evogymcm._settings import check_choice, check_count, check_number
from evogymcm.algos.codesign.body_search import check_settings
from evogymcm.algos.codesign.design import Design, Individual
from evogymcm.algos.codesign.stiffness_proposals import CMA, NOISE, HillClimber, Proposer, load_cma

__all__ = ["ACCEPTANCE", "PROPOSALS", "MaterialSearch", "Materials", "check_search"]

ACCEPTANCE = ("reference", "paper")
PROPOSALS = ("hill-climbing", "cma")
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
        seed: of all random draws; with each generation another one, such as (seed, generation).
        rounds: proposals of each survivor, one after another.
        candidates: proposals of each survivor in a round, evaluated together.
        probability: of a voxel to be changed in a proposal.
        sigma: standard deviation of its noise; with CMA-ES, the initial step in the logarithm of stiffness.
        acceptance: "reference" takes a new score R' over the best R if R' >= R + 0.02 |R| (EvoGymCM's reference code),
            "paper" if R' > R.
        noise: see `perturb_stiffness`; CMA-ES has its own.
        proposal: "hill-climbing", or "cma" for one CMA-ES per survivor with a population of `candidates` (needs the
            extra `evogymcm[cma]`).

    Attributes:
        settings: all of them, of JSON types.
        n_rounds: rounds told so far.

    Raises:
        ValueError: There is no individual, one has no fitness, an index repeats, shapes differ, an option has no such
            value, or a number is out of range.
        ImportError: The package for CMA-ES is missing.
    """

    def __init__(
        self,
        individuals: Sequence[Individual],
        *,
        seed: int | Sequence[int],
        rounds: int = 20,
        candidates: int = 1,
        probability: float = 0.15,
        sigma: float = 0.2,
        acceptance: str = "reference",
        noise: str = "multiplicative",
        proposal: str = "hill-climbing",
    ) -> None:
        options = check_search(
            {
                "rounds": rounds,
                "candidates": candidates,
                "probability": probability,
                "sigma": sigma,
                "acceptance": acceptance,
                "noise": noise,
                "proposal": proposal,
            }
        )
        _check_individuals(individuals)
        self.individuals = list(individuals)
        self.rounds, self.candidates, self.acceptance = options["rounds"], options["candidates"], acceptance
        records = [individual.record() for individual in self.individuals]
        self.settings = {"seed": np.asarray(seed).tolist(), **options, "individuals": records}
        self._start()

    def _start(self) -> None:
        """Sets the state before the first round."""
        options = self.settings
        self.n_rounds = 0
        self._best = [individual.design for individual in self.individuals]
        self._scores = np.array([individual.fitness for individual in self.individuals], dtype=np.float64)
        self._told: list[list[float]] = []
        self._history = [self._scores.copy()]
        self._asked: list[list[Field]] = []
        self._proposers: list[Proposer] = []
        for individual in self.individuals:
            rng = np.random.default_rng(np.random.SeedSequence(options["seed"], spawn_key=(individual.index,)))
            if options["proposal"] == "cma":
                self._proposers.append(CMA(individual.design, rng, self.candidates, options["sigma"]))
            else:
                arguments = (options["probability"], options["sigma"], options["noise"])
                self._proposers.append(HillClimber(rng, self.candidates, *arguments))

    @property
    def is_finished(self) -> bool:
        """Whether all rounds have been told."""
        return self.n_rounds >= self.rounds

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
            raise RuntimeError(f"ask: all {self.rounds} rounds are over")
        if not self._asked:
            self._asked = [proposer.ask(best) for proposer, best in zip(self._proposers, self._best, strict=True)]
        return np.stack([field for fields in self._asked for field in fields])

    def tell(self, scores: ArrayLike) -> NDArray[np.bool_]:
        """Takes the scores (n * candidates,) of the fields asked for, and returns (n,) whose best of them was accepted.

        Raises:
            RuntimeError: Nothing has been asked for.
            ValueError: The scores are not as many, or not finite; nothing has changed then.
        """
        if not self._asked:
            raise RuntimeError("tell: nothing has been asked for")
        values = np.array(scores, dtype=np.float64)
        accepted = np.zeros(len(self.individuals), dtype=bool)
        n = len(self.individuals) * self.candidates
        if values.shape != (n,) or not np.isfinite(values).all():
            raise ValueError(f"scores: got {values}, expected {n} finite numbers")
        for i, own in enumerate(values.reshape(-1, self.candidates)):
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
        return score > best if self.acceptance == "paper" else score >= best + _MARGIN * abs(best)

    def state_dict(self) -> dict[str, Any]:
        """Returns the settings and all scores told, of JSON types: with them the search can be repeated."""
        return {"settings": self.settings, "told": [list(scores) for scores in self._told]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from where `state_dict` was called, by telling the scores again.

        Raises:
            ValueError: The state is of a search with other settings or individuals.
        """
        check_settings(self.settings, state["settings"])
        self._start()
        for scores in state["told"]:
            self.ask()
            self.tell(scores)


def check_search(options: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the options of a search, all but individuals and seed, as Python has them.

    Raises:
        ValueError: A value is of the wrong kind or out of range, or "cma" has fewer than 2 candidates.
        ImportError: The package for CMA-ES is missing.
    """
    choices = {"acceptance": ACCEPTANCE, "noise": NOISE, "proposal": PROPOSALS}
    checked: dict[str, Any] = {name: check_count(name, options[name]) for name in ("rounds", "candidates")}
    checked["probability"] = check_number("probability", options["probability"], low=0.0, high=1.0)
    checked["sigma"] = check_number("sigma", options["sigma"], above=0.0)
    checked |= {name: check_choice(name, options[name], allowed) for name, allowed in choices.items()}
    if checked["proposal"] == "cma":
        if checked["candidates"] < 2:
            raise ValueError(f"candidates: got {checked['candidates']}, proposal 'cma' needs at least 2")
        load_cma()
    return checked


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
