"""`check_body_search`: it finds each mistake in a search of one's own, and none in those of the package."""

import itertools
import random
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from evogymcm.algos.codesign import CodesignConfig, Design, GeneticAlgorithm, RandomSearch, SearchConfig
from evogymcm.algos.codesign.config import Method
from evogymcm.algos.codesign.start import make_body_search
from evogymcm.body import Body, sample_body
from evogymcm.testing import check_body_search


@pytest.mark.parametrize("search", [None, SearchConfig()])
@pytest.mark.parametrize("method", Method.__args__)
def test_methods_of_the_package_have_no_mistakes(method, search):
    if method == "qd":
        pytest.importorskip("ribs")
    settings = {"material": "invariant" if search else "reactive", "search": search, "shape": (2, 3)}
    check_body_search(partial(make_body_search, CodesignConfig(method=method, population=4, budget=11, **settings)))


def test_a_method_that_protects_the_young_has_none():
    make = partial(GeneticAlgorithm, (2, 2), 14, 5, seed=3, age_protection=1, carries_stiffness=True)
    check_body_search(make, generations=3)


def ask(change):
    """A search whose `ask` returns something else than it should."""

    class Mine(GeneticAlgorithm):
        def ask(self):
            return change(self, super().ask())

    return Mine


def first(change):
    return ask(lambda self, asked: [change(self, asked[0]), *asked[1:]])


class Twice(RandomSearch):
    def _random(self):
        return Design(Body(["HH", "H."])), None

    def _new(self, draw, taken=()):
        return draw()


class Greedy(RandomSearch):
    def _fill(self, count, draw):
        for _ in range(count):
            self._add(*self._new(draw))


class Endless(RandomSearch):
    def ask(self):
        self._pending = self._pending or []
        return super().ask() if not self.is_finished else []


class Early(RandomSearch):
    @property
    def is_finished(self):
        return self.n_designs >= self.budget


class Uncounted(RandomSearch):
    def tell(self, fitness):
        super().tell(fitness)
        self.generation -= 1


class Careless(RandomSearch):
    def tell(self, fitness):
        super().tell({index: fitness.get(index, 0.0) for index in self._pending})


class Finite(RandomSearch):
    def tell(self, fitness):
        super().tell({index: float(np.nan_to_num(value)) for index, value in fitness.items()})


class Half(RandomSearch):
    def tell(self, fitness):
        self.attempts = 0
        self._seen.add(str(len(fitness)))
        super().tell(fitness)


class WorstFirst(GeneticAlgorithm):
    @property
    def survivors(self):
        return super().survivors[::-1]


class Forgetful(GeneticAlgorithm):
    def update(self, index, *, stiffness=None, fitness=None):
        super().update(index, stiffness=stiffness)


class Hasty(GeneticAlgorithm):
    def update(self, index, *, stiffness=None, fitness=None):
        if not self._pending:
            super().update(index, stiffness=stiffness, fitness=fitness)


class Open(GeneticAlgorithm):
    def update(self, index, *, stiffness=None, fitness=None):
        if self._pending or index in self._survivors:
            super().update(index, stiffness=stiffness, fitness=fitness)


class Modest(GeneticAlgorithm):
    @property
    def best(self):
        return self.population[-1]


class Orphans(GeneticAlgorithm):
    @property
    def parents(self):
        return super().parents[:1]


class OwnDraws(RandomSearch):
    def _random(self):
        return Design(sample_body(self.shape, np.random.default_rng())), None


class GlobalDraws(RandomSearch):
    def _random(self):
        return Design(sample_body(self.shape, np.random.randint(10**6))), None  # noqa: NPY002


class OldGlobalDraws(RandomSearch):
    def _random(self):
        random.random()
        return super()._random()


class Amnesic(RandomSearch):
    def load_state_dict(self, state):
        rng = self._rng.bit_generator.state
        super().load_state_dict(state)
        self._rng.bit_generator.state = rng


class HalfRestored(GeneticAlgorithm):
    def load_state_dict(self, state):
        super().load_state_dict(dict(state) | {"survivors": []})


class Arrays(RandomSearch):
    def state_dict(self):
        return super().state_dict() | {"counts": np.arange(3)}


class Tuples(RandomSearch):
    def state_dict(self):
        return super().state_dict() | {1: "one"}


class Takes(RandomSearch):
    def load_state_dict(self, state):
        super().load_state_dict(state)
        state["pending"].append(0)


class Bare:
    is_finished = False


class Late(RandomSearch):
    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.generation = 1


single = RandomSearch((2, 2), 9, 3, seed=0)
counter = itertools.count()
WRONG = {
    "no search": (Bare, r"attributes: it has no ask, tell, update, .*see DesignSearch"),
    "generation from 1": (Late, r"start: .* is \(1, 0, False\)"),
    "nothing asked": (ask(lambda self, asked: []), r"ask: got \[\], expected a list of at least one Individual"),
    "designs asked": (ask(lambda self, asked: [one.design for one in asked]), r"ask: got \[Design"),
    "index from 1": (first(lambda self, one: replace(one, index=one.index + 1)), "index 1, expected 0"),
    "another generation": (
        first(lambda self, one: replace(one, generation=7)),
        "is of generation 7, the search is in 0",
    ),
    "fitness before": (first(lambda self, one: replace(one, fitness=0.0)), "individual 0 has fitness 0.0 before"),
    "parent out of nowhere": (first(lambda self, one: replace(one, parent=9)), "individual 0 has parent 9, which was"),
    "parent not kept": (Orphans, r"has parent \d+, which was not among `parents`"),
    "another shape": (
        first(lambda self, one: replace(one, design=Design(Body("HH")))),
        r"shape \(1, 2\), not the search's",
    ),
    "a body twice": (Twice, "body 1, HH/H., was proposed before as 0"),
    "stiffness uncalled for": (
        first(lambda self, one: replace(one, design=Design(one.design.body, np.ones((2, 2))))),
        "design 0 has stiffness, though",
    ),
    "beyond the budget": (Greedy, "12 bodies, the budget is 11"),
    "other individuals each time": (
        ask(lambda self, asked: asked if next(counter) % 2 else asked[::-1]),
        "expected|asked again, it returns other individuals",
    ),
    "finished while waiting": (Early, "is_finished: it is True while fitness is waited for"),
    "asks after its end": (Endless, "the budget is used and all fitness told: expected a RuntimeError"),
    "generations not counted": (Uncounted, "generation is 0 after it was 0"),
    "missing fitness": (Careless, "it takes fitness where one is missing; expected a ValueError"),
    "NaN": (Finite, "it takes fitness where one is NaN; expected a ValueError"),
    "changes what it refuses": (Half, "what it refuses changes its state"),
    "survivors worst first": (WorstFirst, r"survivors: fitness is \[.*\], expected best first"),
    "updates without fitness": (Forgetful, "it was told"),
    "updates too early": (Hasty, "it takes before new individuals have their fitness; expected a RuntimeError"),
    "updates of the dead": (Open, "it takes one that did not survive; expected a ValueError"),
    "best that is not": (Modest, "best: its fitness is"),
    "unseeded draws": (OwnDraws, "another search with the same seed asks for"),
    "numpy's global draws": (GlobalDraws, "another search|it uses a global generator"),
    "global draws": (OldGlobalDraws, "draws: it uses a global generator"),
    "draws not restored": (Amnesic, "restored shows state_dict"),
    "survivors not restored": (HalfRestored, "restored shows survivors"),
    "a state of arrays": (Arrays, "state_dict: Object of type ndarray"),
    "a state of numbered keys": (Tuples, "state_dict: it changes on its way through JSON"),
    "a state taken": (Takes, "load_state_dict: it changes the state that it is given"),
}


@pytest.mark.parametrize("case", WRONG)
def test_mistakes_are_named(case):
    kind, message = WRONG[case]
    make = kind if kind is Bare else partial(kind, (2, 2), 11, 4, seed=0)
    with pytest.raises(ValueError, match=f"(?s)^body search {kind.__name__}: .*(?:{message})"):
        check_body_search(make)


def test_what_is_no_factory_is_refused():
    with pytest.raises(ValueError, match=r"make: got <.*, expected what makes a search"):
        check_body_search(single)
    with pytest.raises(ValueError, match="make: it returned the same search again"):
        check_body_search(lambda: single)
