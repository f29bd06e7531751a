"""Searches over bodies: stopping and going on, and bad input."""

import numpy as np
import pytest

from evogymcm.algos.codesign import GeneticAlgorithm, MapElites, RandomSearch
from tests.algos.codesign.test_genetic import SHAPE, play
from tests.algos.tools import through_json, through_torch

# Stopping and going on


@pytest.mark.parametrize("carry", [through_json, through_torch])
@pytest.mark.parametrize("is_asked", [False, True])
@pytest.mark.parametrize("method", [GeneticAlgorithm, RandomSearch, MapElites])
def test_a_resumed_search_equals_an_uninterrupted_one(carry, is_asked, method):
    def make():
        more = {"age_protection": 1} if method is GeneticAlgorithm else {}
        return method((3, 3), 40, 6, seed=5, carries_stiffness=True, **more)

    if method is MapElites:
        pytest.importorskip("ribs")

    def improve(search):
        for individual in search.survivors:
            rng = np.random.default_rng(individual.index)
            search.update(individual.index, stiffness=rng.uniform(0.5, 2.0, (3, 3)), fitness=individual.fitness + 0.01)

    whole = make()
    play(whole, 2)
    improve(whole)
    if is_asked:
        whole.ask()
    state = carry(whole.state_dict())
    rest = play(whole)

    play(resumed := make(), 1)  # whatever it did before
    resumed.load_state_dict(state)
    assert play(resumed) == rest
    assert len(rest) > 10
    assert resumed.state_dict() == whole.state_dict()
    assert resumed.best == whole.best
    assert resumed.parents == whole.parents


def test_a_state_of_other_settings_is_refused():
    state = GeneticAlgorithm(SHAPE, 8, 4, seed=0).state_dict()
    with pytest.raises(ValueError, match="population: got 5, the state has 4; seed: got 1, the state has 0"):
        GeneticAlgorithm(SHAPE, 8, 5, seed=1).load_state_dict(state)
    with pytest.raises(ValueError, match="method: got RandomSearch, the state has GeneticAlgorithm"):
        RandomSearch(SHAPE, 8, 4, seed=0).load_state_dict(state)


def test_a_state_of_before_goes_on():
    whole, resumed = (RandomSearch((3, 3), 40, 7, seed=5) for _ in range(2))
    play(whole, 2)
    state = whole.state_dict()
    old = {name: value for name, value in state["settings"].items() if name not in ("mutation_rate", "attempts")}
    old["batch"] = old.pop("population")
    resumed.load_state_dict(state | {"settings": old})
    assert play(resumed) == play(whole)
    with pytest.raises(ValueError, match="population: got 7, the state has 8"):
        resumed.load_state_dict(state | {"settings": old | {"batch": 8}})


# Bad input


@pytest.mark.parametrize("method", [GeneticAlgorithm, RandomSearch, MapElites])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"population": 0}, "population: got 0"),
        ({"population": 2.5}, "population: got 2.5"),
        ({"budget": 0}, "budget: got 0"),
        ({"shape": (0, 5)}, "shape"),
        ({"shape": (5,)}, "shape"),
        ({"seed": -1}, "seed: got -1"),
        ({"mutation_rate": 0.0}, "mutation_rate: got 0.0"),
        ({"mutation_rate": 1.5}, "mutation_rate: got 1.5"),
        ({"mutation_rate": np.nan}, "mutation_rate: got nan"),
        ({"attempts": 0}, "attempts: got 0"),
        ({"attempts": np.nan}, "attempts: got nan"),
        ({"weights": (1, 1, 1, 0, 0)}, "weights: got"),
    ],
)
def test_bad_arguments_are_refused_by_every_method_alike(method, arguments, message):
    if method is MapElites:
        pytest.importorskip("ribs")
    given = {"shape": SHAPE, "budget": 20, "population": 5, "seed": 0}
    assert method(*list(given.values())[:3], seed=0, carries_stiffness=True, mutation_rate=0.2).carries_stiffness
    with pytest.raises(ValueError, match=message):
        method(**given | arguments)
    with pytest.raises(TypeError, match="rate"):
        method(**given, rate=0.1)


def test_bad_arguments_of_the_genetic_algorithm_are_refused():
    for arguments, message in (
        ({"population": 2}, "at least 3"),
        ({"population": 30}, "expected 1 to 20"),
        ({"age_protection": -1}, "age_protection: got -1"),
        ({"age_protection": 0.5}, "age_protection: got 0.5"),
    ):
        with pytest.raises(ValueError, match=message):
            GeneticAlgorithm(**{"shape": SHAPE, "budget": 20, "population": 5, "seed": 0} | arguments)


@pytest.mark.parametrize(
    ("fitness", "message"),
    [
        ({0: 1.0, 1: 2.0}, r"got indices \[0, 1\], expected \[0, 1, 2\]"),
        ({0: 1.0, 1: 2.0, 2: 3.0, 3: 4.0}, "indices"),
        ({0: 1.0, 1: 2.0, 2: np.nan}, "fitness of 2: got nan"),
        ({0: 1.0, 1: -np.inf, 2: 0.0}, "fitness of 1: got -inf"),
    ],
)
def test_bad_fitness_is_refused_and_changes_nothing(fitness, message):
    search = GeneticAlgorithm(SHAPE, 6, 3, seed=0)
    search.ask()
    before = search.state_dict()
    with pytest.raises(ValueError, match=message):
        search.tell(fitness)
    assert search.state_dict() == before
    search.tell({0: 1.0, 1: 2.0, 2: 3.0})
    with pytest.raises(ValueError, match="indices"):
        search.tell({0: 1.0, 1: 2.0, 2: 3.0})


def test_asking_again_gives_the_same():
    search = GeneticAlgorithm(SHAPE, 6, 3, seed=0)
    assert search.ask() == search.ask()
    assert search.n_designs == 3
    with pytest.raises(RuntimeError, match="no fitness"):
        search.best  # noqa: B018


def test_a_shape_without_further_bodies_is_an_error(monkeypatch):
    monkeypatch.setattr("evogymcm.algos.codesign.body_search._MAX_FAILURES", 200)
    search = RandomSearch((1, 1), 2, 2, seed=0)  # there are H and V
    assert {item.design.body.text for item in search.ask()} == {"H", "V"}
    with pytest.raises(ValueError, match=r"budget: got 3, there are at most 2 bodies of shape \(1, 1\)"):
        RandomSearch((1, 1), 3, 3, seed=0)
    search = RandomSearch((1, 3), 98, 98, seed=0)  # 125 - 27 have an actuator, but some are in two parts
    with pytest.raises(RuntimeError, match=r"shape \(1, 3\) after \d\d bodies"):
        search.ask()
    assert (search.n_designs, search.population, search.state_dict()["seen"]) == (0, [], [])


@pytest.mark.parametrize("ask", [lambda search: search.ask(), lambda search: search.mutants(9)])
def test_children_that_cannot_all_be_found_leave_none(monkeypatch, ask):
    monkeypatch.setattr("evogymcm.algos.codesign.body_search._MAX_FAILURES", 100)
    search = GeneticAlgorithm((1, 2), 8, 5, seed=0, weights=(1, 0, 0, 1, 1))  # there are 8 bodies
    search.tell({item.index: 0.0 for item in search.ask()})
    before = {name: value for name, value in search.state_dict().items() if name != "rng"}
    search._seen |= {"33", "34", "43", "44", "30", "03"}  # at most two are left, for three children
    before["seen"] = sorted(search._seen)
    with pytest.raises(RuntimeError, match="no new body"):
        ask(search)
    assert {name: value for name, value in search.state_dict().items() if name != "rng"} == before
