"""Searches over bodies and stiffness of drawn settings: stopped anywhere, they go on as if they had not been."""

import contextlib
import importlib.util

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from evogymcm.algos.codesign import GeneticAlgorithm, Individual, MapElites, MaterialSearch, RandomSearch
from evogymcm.algos.codesign.design import Design
from tests.algos.tools import through_json, through_torch
from tests.properties.strategies import SEEDS, bodies, fields

CARRY = st.sampled_from([through_json, through_torch])
HAS_RIBS, HAS_CMA = (importlib.util.find_spec(name) is not None for name in ("ribs", "cma"))


@st.composite
def searches(draw):
    """What makes searches over bodies that are all alike."""
    shape = draw(st.sampled_from([(1, 2), (2, 1), (2, 2), (3, 2), (3, 3), (2, 5)]))
    options = {
        "seed": draw(SEEDS),
        "mutation_rate": draw(st.floats(0.01, 1.0)),
        "attempts": draw(st.integers(1, 9)),
        "carries_stiffness": draw(st.booleans()),
    }
    if draw(st.booleans()):
        options["weights"] = (*draw(st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4)), 0.5)
    population, budget = draw(st.integers(1, 9)), draw(st.integers(1, 25))
    kinds = [(RandomSearch, {}), (GeneticAlgorithm, {"age_protection": draw(st.integers(0, 3))})]
    if HAS_RIBS:
        kinds.append(
            (
                MapElites,
                {
                    "initial": draw(st.none() | st.integers(1, 9)),
                    "dims": draw(st.sampled_from([(10, 10), (1, 1), (4, 1)])),
                },
            )
        )
    kind, more = draw(st.sampled_from(kinds))

    def make():
        return kind(shape, budget, population, **options, **more)

    try:
        make()
    except ValueError:
        assume(False)
    return make


def do(search, deed):
    """Does one thing to a search, which a number chooses with all that it takes; returns what came of it."""
    rng = np.random.default_rng(deed)
    what = rng.integers(4)
    try:
        if what == 0:
            return [item.record() for item in search.ask()]
        if what == 1:
            asked = search.ask()
            values = rng.choice([0.0, 1.0, -2.5, 1e9], len(asked)) if rng.random() < 0.5 else rng.random(len(asked))
            return search.tell({item.index: float(value) for item, value in zip(asked, values, strict=True)})
        if what == 2 and search.survivors and not search._pending:
            item = search.survivors[rng.integers(len(search.survivors))]
            field = rng.uniform(0.5, 2.0, search.shape) if search.carries_stiffness else None
            return search.update(item.index, stiffness=field, fitness=item.fitness + rng.random())
        if what == 3 and isinstance(search, GeneticAlgorithm):
            count = len(search._mutants[0]) if search._mutants and search._mutants[0:] else int(rng.integers(1, 4))
            groups = search.mutants(count)
            if rng.random() < 0.5 and groups:
                search.choose(rng.random((len(groups), count)))
            return [[item.record() for item in group] for group in groups]
    except RuntimeError as error:  # the budget, or the bodies of a small shape, are used up, or it is not the time
        return str(error)
    return None


def shown(search):
    best = None
    with contextlib.suppress(RuntimeError):
        best = search.best.record()
    people = [[item.record() for item in items] for items in (search.population, search.survivors, search.parents)]
    return best, people, search.is_finished, search.generation, search.n_designs


DEEDS = st.lists(st.integers(0, 10**6), max_size=14)


@pytest.fixture(autouse=True, scope="module")
def _giving_up_soon():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evogymcm.algos.codesign.body_search._MAX_FAILURES", 30)
        yield


@given(searches(), DEEDS, DEEDS, DEEDS, CARRY)
def test_a_search_over_bodies_goes_on_from_any_state(make, before, elsewhere, after, carry):
    whole, resumed = make(), make()
    for deed in before:
        do(whole, deed)
    for deed in elsewhere:
        do(resumed, deed)
    state = carry(whole.state_dict())
    resumed.load_state_dict(state)
    assert shown(resumed) == shown(whole)
    for deed in after:
        assert do(resumed, deed) == do(whole, deed)
        assert shown(resumed) == shown(whole)
        assert resumed.state_dict() == whole.state_dict()


@given(searches(), st.lists(SEEDS, max_size=40))
def test_no_body_is_proposed_twice_and_the_budget_is_kept(make, seeds):
    search, seen, best = make(), [], -np.inf
    for seed in seeds:
        if search.is_finished:
            break
        try:
            asked = search.ask()
        except RuntimeError:  # of a small shape all bodies are found
            break
        assert 1 <= len(asked) <= search.population_size
        seen += [item.design.body for item in asked]
        fitness = np.random.default_rng(seed).normal(size=len(asked)).tolist()
        search.tell({item.index: value for item, value in zip(asked, fitness, strict=True)})
        best = max(best, *fitness)
        assert search.best.fitness == best
    assert len(set(seen)) == len(seen) == search.n_designs <= search.budget


@pytest.mark.filterwarnings("ignore:.*Initial standard deviation")
@given(
    st.lists(bodies(3), min_size=1, max_size=3),
    st.data(),
    SEEDS,
    CARRY,
)
def test_a_search_over_stiffness_goes_on_from_any_state(given_bodies, data, seed, carry):
    shape = given_bodies[0].shape
    given_bodies = [body for body in given_bodies if body.shape == shape]
    scores = data.draw(st.lists(st.floats(-10, 10), min_size=len(given_bodies), max_size=len(given_bodies)))
    people = [
        Individual(3 * i, Design(body, data.draw(st.none() | fields(body))), fitness=score)
        for i, (body, score) in enumerate(zip(given_bodies, scores, strict=True))
    ]
    proposal = data.draw(st.sampled_from(["hill-climbing", "cma"] if HAS_CMA else ["hill-climbing"]))
    options = {
        "rounds": data.draw(st.integers(1, 4)),
        "candidates": data.draw(st.integers(2 if proposal == "cma" else 1, 5)),
        "probability": data.draw(st.floats(0, 1)),
        "sigma": data.draw(st.floats(0.01, 3.0)),
        "acceptance": data.draw(st.sampled_from(["reference", "paper"])),
        "noise": data.draw(st.sampled_from(["multiplicative", "additive"])),
        "proposal": proposal,
    }
    whole, resumed = (MaterialSearch(people, seed=(seed, 1), **options) for _ in range(2))
    cut, rng = data.draw(st.integers(0, options["rounds"])), np.random.default_rng(seed)
    while not whole.is_finished:
        if whole.n_rounds == cut:
            resumed.load_state_dict(carry(whole.state_dict()))
        asked = whole.ask()
        assert ((asked >= 0.5) & (asked <= 2.0)).all()
        for field, item in zip(asked, np.repeat(people, options["candidates"]), strict=True):
            assert (field[~item.design.body.occupancy] == 1.0).all()
        told = rng.normal(size=len(asked)) * 10.0 ** rng.integers(-3, 4)
        before = whole.best.scores
        accepted = whole.tell(told)
        assert (whole.best.scores >= before).all()
        if whole.n_rounds > cut:
            assert np.array_equal(resumed.ask(), asked)
            assert np.array_equal(resumed.tell(told), accepted)
            assert np.array_equal(resumed.best.fields, whole.best.fields)
