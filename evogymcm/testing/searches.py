"""The contract of searches over bodies, which co-design asks for individuals and tells their fitness."""

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from evogymcm._messages import brief
from evogymcm.algos.codesign.body_search import DesignSearch
from evogymcm.algos.codesign.design import Design, Individual
from evogymcm.testing._generators import global_generators

_METHODS = ("ask", "tell", "update", "state_dict", "load_state_dict")
_SHOWN = ("population", "survivors", "parents", "is_finished", "n_designs", "generation")
_GIVEN = ("budget", "shape", "carries_stiffness")


def check_body_search(make: Callable[[], DesignSearch], *, generations: int = 20, seed: int = 0) -> None:
    """Raises an error for mistakes in a search over bodies that would otherwise show late, or only as worse runs.

    It tells random fitness, some of it equal, and improves survivors. It checks that every individual asked for is new
    and valid: its body of the search's shape and never proposed before, its number, generation and parent in order;
    that asking again gives the same; that the budget is kept; that wrong fitness is refused and changes nothing; that
    survivors and the best are what was told; that all draws come from the search's own seed; and that a search which is
    restored from its state, through JSON, at any point goes on exactly as the first one.

    Args:
        make: Makes the search, each time a fresh one with the same settings and seed:
            `lambda: MySearch((3, 3), budget=30, population=6, seed=0)`. A budget of some generations shows most.
        generations: Generations at most, where the budget is larger.
        seed: Seed of the fitness.

    Raises:
        ValueError: The search breaks the contract of `DesignSearch`; the message says where.
    """
    if not callable(make):
        raise ValueError(f"make: got {brief(make)}, expected what makes a search, such as a function without arguments")
    before = global_generators()
    search = make()
    _check(search is not make(), search, "make", "it returned the same search again, expected a fresh one")
    missing = [name for name in _METHODS + _SHOWN + _GIVEN if not hasattr(search, name)]
    _check(not missing, search, "attributes", f"it has no {', '.join(missing)}; see DesignSearch")
    _Run(make, search, np.random.default_rng(seed)).to_the_end(generations)
    _check(before == global_generators(), search, "draws", "it uses a global generator; draw from one of its own")


class _Run:
    """One search that is run, with those that follow it from a saved state."""

    def __init__(self, make: Callable[[], DesignSearch], search: DesignSearch, rng: np.random.Generator) -> None:
        self._make, self._search, self._rng = make, search, rng
        self._seen: dict[str, int] = {}
        self._told: dict[int, float] = {}
        self._others: dict[str, DesignSearch] = {"another search with the same seed": make()}

    def to_the_end(self, generations: int) -> None:
        search = self._search
        start = search.generation, search.n_designs, search.is_finished
        self._check(
            start == (0, 0, False), "start", f"(generation, n_designs, is_finished) is {start}, not (0, 0, False)"
        )
        self._follow("a new search")
        while not search.is_finished and search.generation < generations:
            asked = self._ask()
            self._follow("a search that waits for fitness")
            self._refuse(asked)
            self._tell(asked)
            self._follow("a search that has been told")
            self._update()
        if search.is_finished:
            try:
                search.ask()
            except RuntimeError:
                return
            self._check(False, "ask", "the budget is used and all fitness told: expected a RuntimeError")

    def _check(self, is_right: bool, where: str, what: str) -> None:
        _check(is_right, self._search, where, what)

    def _follow(self, what: str) -> None:
        """Restores a fresh search from the state of the first one."""
        state = self._search.state_dict()
        try:
            text = json.dumps(state, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{_name(self._search)}: state_dict: {error}; expected JSON types") from error
        given = json.loads(text)
        self._check(given == state, "state_dict", "it changes on its way through JSON")
        other = self._make()
        other.ask()  # whatever it did before
        other.load_state_dict(given)
        self._others[f"{what}, restored"] = other
        self._check(given == state, "load_state_dict", "it changes the state that it is given")
        self._compare("state_dict")

    def _compare(self, where: str) -> None:
        """Checks that all searches that follow are where the first one is."""
        shown = {name: _record(getattr(self._search, name)) for name in (*_SHOWN, "state_dict")}
        for what, other in self._others.items():
            for name, expected in shown.items():
                got = _record(getattr(other, name))
                if got != expected:
                    says = f"{what} shows {name} {brief(got)}, the first one {brief(expected)}"
                    why = "the state must hold all that is needed to go on, and draws must come from the seed"
                    self._check(False, where, f"{says}; {why}")

    def _ask(self) -> list[Individual]:
        search = self._search
        n, generation, parents = search.n_designs, search.generation, {item.index for item in search.parents}
        asked = search.ask()
        is_list = isinstance(asked, Sequence) and len(asked) > 0 and all(isinstance(one, Individual) for one in asked)
        self._check(is_list, "ask", f"got {brief(asked)}, expected a list of at least one Individual")
        for number, item in enumerate(asked, n):
            self._check(
                item.index == number, "ask", f"an individual has index {item.index}, expected {number}, the next"
            )
            self._check(
                item.generation == generation,
                "ask",
                f"individual {number} is of generation {item.generation}, the search is in {generation}",
            )
            self._check(
                item.fitness is None, "ask", f"individual {number} has fitness {item.fitness} before it is told"
            )
            self._check(
                item.parent is None or item.parent in parents,
                "ask",
                f"individual {number} has parent {item.parent}, which was not among `parents` {sorted(parents)}: its "
                "policy may be forgotten",
            )
            self._check_design(item)
        self._check(search.n_designs == n + len(asked), "ask", f"n_designs is {search.n_designs}, not {n + len(asked)}")
        self._check(
            search.n_designs <= search.budget, "ask", f"{search.n_designs} bodies, the budget is {search.budget}"
        )
        self._check(not search.is_finished, "is_finished", "it is True while fitness is waited for")
        state = search.state_dict()
        self._check(_record(search.ask()) == _record(asked), "ask", "asked again, it returns other individuals")
        self._check(search.state_dict() == state, "ask", "asked again, it changes its state")
        for what, other in self._others.items():
            got = other.ask()
            self._check(
                _record(got) == _record(asked),
                "ask",
                f"{what} asks for {brief(_texts(got))}, the first one for {brief(_texts(asked))}",
            )
        return list(asked)

    def _check_design(self, item: Individual) -> None:
        search, design = self._search, item.design
        self._check(isinstance(design, Design), "ask", f"individual {item.index} has {brief(design)}, not a Design")
        shape = design.body.shape
        self._check(
            shape == tuple(search.shape), "ask", f"body {item.index} has shape {shape}, not the search's {search.shape}"
        )
        first = self._seen.setdefault(design.key, item.index)
        self._check(
            first == item.index, "ask", f"body {item.index}, {design.body.text}, was proposed before as {first}"
        )
        self._check(
            design.stiffness is None or search.carries_stiffness,
            "ask",
            f"design {item.index} has stiffness, though carries_stiffness is not set",
        )

    def _refuse(self, asked: Sequence[Individual]) -> None:
        """Tells wrong fitness, and updates too early."""
        right = {item.index: 0.0 for item in asked}
        first = asked[0].index
        wrong: dict[str, Mapping[int, float]] = {
            "one is missing": {index: 0.0 for index in right if index != first},
            "one was not asked for": right | {self._search.n_designs: 0.0},
            "one is NaN": right | {first: float("nan")},
            "one is infinite": right | {first: float("inf")},
        }
        state = self._search.state_dict()
        for what, fitness in wrong.items():
            self._raises(ValueError, "tell", f"fitness where {what}", self._search.tell, fitness)
        for item in self._search.survivors[:1]:
            where = "before new individuals have their fitness"
            self._raises(RuntimeError, "update", where, partial(self._search.update, item.index, fitness=1.0))
        self._check(self._search.state_dict() == state, "tell", "what it refuses changes its state")

    def _raises(self, kind: type[Exception], where: str, what: str, call: Callable[..., Any], *given: Any) -> None:
        try:
            call(*given)
        except kind:
            return
        self._check(False, where, f"it takes {what}; expected a {kind.__name__}")

    def _tell(self, asked: Sequence[Individual]) -> None:
        search, generation = self._search, self._search.generation
        values = self._rng.choice([-1.5, 0.0, 2.0], len(asked)) + self._rng.choice(
            [0.0, self._rng.random()], len(asked)
        )
        fitness = {item.index: float(value) for item, value in zip(asked, values, strict=True)}
        for one in (search, *self._others.values()):
            one.tell(dict(fitness))
        self._told |= fitness
        now = search.generation
        self._check(
            now == generation + 1, "tell", f"generation is {now} after it was {generation}: it counts what is told"
        )
        used, finished = search.n_designs >= search.budget, search.is_finished
        self._check(
            finished == used, "is_finished", f"it is {finished}; {search.n_designs} of {search.budget} are told"
        )
        self._check_people()
        self._compare("tell")

    def _check_people(self) -> None:
        """Checks population, survivors and the best against what was told."""
        search = self._search
        for name in ("population", "survivors", "parents"):
            people = getattr(search, name)
            for item in people:
                told = self._told.get(item.index)
                self._check(item.fitness == told, name, f"{item.index} has fitness {item.fitness}, it was told {told}")
                self._check(
                    self._seen.get(item.design.key) == item.index,
                    name,
                    f"{item.index} has another body than was asked for",
                )
            order = [item.fitness for item in people]
            self._check(order == sorted(order, reverse=True), name, f"fitness is {brief(order)}, expected best first")
        known = {item.index for item in search.population}
        lost = sorted({item.index for item in search.survivors} - known)
        self._check(not lost, "survivors", f"{lost} are not in the population")
        best = max((self._told[index] for index in known), default=None)
        self._check(
            search.best.fitness == best, "best", f"its fitness is {search.best.fitness}, the population's {best}"
        )

    def _update(self) -> None:
        """Improves survivors, as material search and fine-tuning do."""
        search = self._search
        people = list(search.survivors)
        others = [index for index in self._told if index not in {item.index for item in people}]
        for index in others[:1]:
            self._raises(ValueError, "update", "one that did not survive", partial(search.update, index, fitness=1.0))
        for item in people[::2]:
            fitness = self._told[item.index] + float(self._rng.random())
            field = self._rng.uniform(0.5, 2.0, item.design.body.shape) if search.carries_stiffness else None
            for one in (search, *self._others.values()):
                one.update(item.index, stiffness=field, fitness=fitness)
            self._told[item.index] = fitness
            now = {one.index: one for one in search.survivors}
            self._check(set(now) == {one.index for one in people}, "update", "the survivors are others after it")
            if field is not None:
                expected = Design(item.design.body, field)
                self._check(now[item.index].design == expected, "update", f"{item.index} has not the stiffness given")
        self._check_people()
        self._follow("a search whose survivors are updated")


def _check(is_right: bool, search: object, where: str, what: str) -> None:
    if not is_right:
        raise ValueError(f"{_name(search)}: {where}: {what}")


def _name(search: object) -> str:
    return f"body search {type(search).__name__}"


def _texts(people: Sequence[Individual]) -> list[str]:
    return [item.design.body.text for item in people]


def _record(value: Any) -> Any:
    """Returns what a search shows in a form that compares."""
    value = value() if callable(value) else value
    return [item.record() for item in value] if isinstance(value, list) else value
