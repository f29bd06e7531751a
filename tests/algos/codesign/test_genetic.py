"""The genetic algorithm over bodies and random search, on objectives that need no simulator."""

import numpy as np
import pytest

from evogymcm.algos.codesign import GeneticAlgorithm, RandomSearch
from evogymcm.algos.codesign.genetic import survivor_count
from evogymcm.body import Body

SHAPE = (5, 5)


def voxels(individual):
    """A toy fitness: the share of horizontal actuators."""
    return float((individual.design.body.grid == 3).mean())


def play(search, generations=10**9, fitness=voxels):
    """Runs a search for some generations and returns the rows of all that was asked for."""
    rows = []
    for _ in range(generations):
        if search.is_finished:
            break
        asked = search.ask()
        told = {individual.index: fitness(individual) for individual in asked}
        search.tell(told)
        rows += [individual.record() | {"fitness": told[individual.index]} for individual in asked]
    return rows


def indices(individuals):
    return [individual.index for individual in individuals]


# The genetic algorithm


@pytest.mark.parametrize(
    ("population", "budget", "n_designs", "survivors"),
    [
        (25, 250, 25, 14),  # 15 * 224 / 249 = 13.5
        (25, 250, 36, 13),  # 15 * 213 / 249 = 12.8
        (25, 250, 48, 13),  # 15 * 201 / 249 = 12.1
        (25, 250, 87, 10),  # 15 * 162 / 249 = 9.8
        (25, 250, 250, 2),  # slightly below 0
        (10, 20, 10, 3),  # 6 * 9 / 19 = 2.8
        (10, 20, 17, 2),  # 6 * 2 / 19 = 0.6
        (3, 6, 3, 2),  # 1.8 * 2 / 5 = 0.7
        (20, 49, 20, 7),  # 12 * 28 / 48 = 7: a whole number, which no rounding error may raise to 8
        (20, 97, 40, 7),  # 12 * 56 / 96 = 7
        (20, 193, 80, 7),  # 12 * 112 / 192 = 7
        (2, 2, 2, 2),
        (1, 1, 1, 1),  # there is no more than one
    ],
)
def test_survivor_counts_by_hand(population, budget, n_designs, survivors):
    assert survivor_count(population, budget, n_designs) == survivors


@pytest.mark.parametrize(
    ("population", "budget", "sizes"),
    [
        (25, 250, [25, 36, 48, 60, 73, 87]),
        (10, 20, [10, 17, 20]),
        (3, 6, [3, 4, 5, 6]),
        (4, 4, [4]),
    ],
)
def test_bodies_after_each_generation_by_hand(population, budget, sizes):
    search = GeneticAlgorithm(SHAPE, budget, population, seed=0)
    for size in sizes:
        assert not search.is_finished
        asked = search.ask()
        assert search.n_designs == size
        search.tell({individual.index: 0.0 for individual in asked})
    assert search.is_finished == (sizes[-1] == budget)


@pytest.mark.parametrize(("budget", "generations"), [(250, 15), (500, 31)])
def test_length_of_the_usual_runs(budget, generations):
    search = GeneticAlgorithm(SHAPE, budget, 25, seed=0)
    rows = play(search)
    assert search.generation == generations
    assert len(rows) == search.n_designs == budget


def test_a_run_by_hand():
    # P = 4, M = 7. Survivors: 2.4 * 2 / 6 = 0.8, so 2; then 2 children, n = 6, and 2.4 * 0 / 6 = 0, so 2; then there
    # is room for 2 children and budget for 1.
    search = GeneticAlgorithm(SHAPE, 7, 4, seed=0)
    asked = search.ask()
    assert indices(asked) == [0, 1, 2, 3]
    assert all(item.parent is None and item.generation == 0 and item.fitness is None for item in asked)
    assert search.survivors == []
    search.tell({3: 2.0, 2: 3.0, 0: 1.0, 1: 3.0})
    assert indices(search.population) == [1, 2, 3, 0]  # 1 and 2 are equal: the earlier first
    assert indices(search.survivors) == [1, 2]
    assert (search.best.index, search.best.fitness) == (1, 3.0)

    asked = search.ask()
    assert indices(asked) == [4, 5]
    assert all(item.parent in (1, 2) and item.generation == 1 for item in asked)
    assert indices(search.population) == [1, 2, 4, 5]
    assert search.best.index == 1
    search.tell({4: 3.0, 5: 5.0})
    assert indices(search.population) == [5, 1, 2, 4]
    assert indices(search.survivors) == [5, 1]

    asked = search.ask()
    assert indices(asked) == [6]
    assert asked[0].parent in (5, 1)
    assert indices(search.population) == [5, 1, 6]
    assert not search.is_finished
    search.tell({6: 4.0})
    assert search.is_finished
    assert indices(search.population) == [5, 6, 1]
    assert indices(search.survivors) == [5, 6]
    assert (search.n_designs, search.generation) == (7, 3)
    with pytest.raises(RuntimeError, match="budget of 7"):
        search.ask()


@pytest.mark.parametrize("method", [GeneticAlgorithm, RandomSearch])
def test_no_body_is_asked_for_twice(method):
    rows = play(search := method((3, 3), 200, 10, seed=1))
    assert [row["index"] for row in rows] == list(range(200))
    assert len({row["body"] for row in rows}) == 200
    assert search.best.fitness == max(row["fitness"] for row in rows)


def test_survivors_are_never_trained_again_and_keep_their_fitness():
    search = GeneticAlgorithm(SHAPE, 40, 6, seed=2)
    fitness, best = {}, -np.inf
    while not search.is_finished:
        for individual in search.ask():
            assert individual.index not in fitness
            fitness[individual.index] = voxels(individual)
        search.tell({index: fitness[index] for index in indices(search.ask())})
        assert all(individual.fitness == fitness[individual.index] for individual in search.population)
        assert search.best.fitness >= best
        best = search.best.fitness
    assert best == max(fitness.values())


def test_parents_are_drawn_uniformly_from_the_survivors():
    # With equal fitness the survivors are always the first bodies, in order; a child's parent has rank 0 to k - 1.
    search = GeneticAlgorithm(SHAPE, 2000, 60, seed=3)
    play(search, 1, fitness=lambda _: 0.0)
    places = []
    while not search.is_finished:
        survivors = indices(search.survivors)
        assert survivors == list(range(len(survivors)))
        asked = search.ask()
        places += [(individual.parent + 0.5) / len(survivors) for individual in asked]
        search.tell({individual.index: 0.0 for individual in asked})
    assert len(places) == 1940
    assert np.mean(places) == pytest.approx(0.5, abs=4 * np.sqrt(1 / 12 / 1940))
    assert np.var(places) == pytest.approx(1 / 12, abs=0.02)  # a little less where survivors are few


def test_it_finds_better_bodies_than_chance():
    play(evolved := GeneticAlgorithm(SHAPE, 300, 10, seed=0))
    play(random := RandomSearch(SHAPE, 300, 10, seed=0))
    assert evolved.best.fitness > random.best.fitness


def test_the_seed_decides_everything():
    runs = [play(GeneticAlgorithm(SHAPE, 20, 5, seed=seed)) for seed in (7, 7, 8)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_arguments_of_mutation_are_used():
    # A rate of 1 draws every cell anew: no resemblance between parent and child beyond chance.
    search = GeneticAlgorithm(SHAPE, 200, 20, seed=0, mutation_rate=1.0)
    rows = {row["index"]: row for row in play(search)}
    pairs = [(row["body"], rows[row["parent"]]["body"]) for row in rows.values() if row["parent"] is not None]
    same = np.mean([np.mean(Body(child).grid == Body(parent).grid) for child, parent in pairs])
    assert same < 0.4


# Improved survivors: the invariant setting


def test_survivors_can_be_improved_and_are_sorted_anew():
    search = GeneticAlgorithm((2, 2), 7, 4, seed=0, carries_stiffness=True)
    assert all(item.design.stiffness is None for item in search.ask())
    search.tell({0: 1.0, 1: 3.0, 2: 2.5, 3: 2.0})
    assert indices(search.survivors) == [1, 2]
    field = np.full((2, 2), 1.7)
    search.update(2, stiffness=field)
    assert indices(search.population) == [1, 2, 3, 0]
    search.update(2, fitness=4.0)
    assert indices(search.population) == [2, 1, 3, 0]
    assert indices(search.survivors) == [2, 1]
    assert search.best.fitness == 4.0
    occupied = search.best.design.body.occupancy
    np.testing.assert_array_equal(search.best.design.stiffness, np.where(occupied, 1.7, 1.0))

    parents = {individual.index: individual.design for individual in search.survivors}
    children = search.ask()
    assert indices(search.population) == [2, 1, 4, 5]
    for child in children:
        same = child.design.body.grid == parents[child.parent].body.grid
        np.testing.assert_array_equal(child.design.field, np.where(same, parents[child.parent].field, 1.0))
    search.tell({4: 0.0, 5: 0.0})
    search.update(1, fitness=9.0)
    search.ask()
    search.tell({6: 8.0})
    assert search.is_finished
    assert indices(search.survivors) == [1, 6]
    search.update(6, fitness=10.0, stiffness=np.full((2, 2), 0.5))  # also in the last generation
    assert search.best.index == 6
    assert indices(search.population) == [6, 1, 2]


def test_ties_do_not_depend_on_the_order_of_updates():
    orders = []
    for updates in ([0, 1, 2], [2, 1, 0]):
        search = GeneticAlgorithm(SHAPE, 100, 5, seed=0)
        search.ask()
        search.tell({0: 5.0, 1: 4.0, 2: 3.0, 3: 0.0, 4: 0.0})
        assert indices(search.survivors) == [0, 1, 2]
        for index in updates:
            search.update(index, fitness=6.0)
        orders.append(indices(search.population))
    assert orders == [[0, 1, 2, 3, 4]] * 2


def test_updates_that_make_no_sense_are_refused():
    search = GeneticAlgorithm(SHAPE, 8, 4, seed=0)
    search.ask()
    with pytest.raises(RuntimeError, match="told first"):
        search.update(0, fitness=1.0)
    search.tell({0: 1.0, 1: 3.0, 2: 2.5, 3: 2.0})
    with pytest.raises(ValueError, match="expected one of the survivors"):
        search.update(0, fitness=1.0)
    with pytest.raises(ValueError, match="carries_stiffness"):
        search.update(1, stiffness=np.ones(SHAPE))
    with pytest.raises(ValueError, match="expected a finite number"):
        search.update(1, fitness=np.nan)
    carrying = GeneticAlgorithm(SHAPE, 8, 4, seed=0, carries_stiffness=True)
    carrying.ask()
    carrying.tell({0: 1.0, 1: 3.0, 2: 2.5, 3: 2.0})
    before = carrying.state_dict()
    for stiffness, fitness in [(np.ones((2, 2)), 5.0), (np.full(SHAPE, 3.0), 5.0), (np.ones(SHAPE), np.inf)]:
        with pytest.raises(ValueError, match=r"stiffness|fitness"):
            carrying.update(1, stiffness=stiffness, fitness=fitness)
    assert carrying.state_dict() == before


# Protection of young bodies


def test_young_bodies_get_half_of_the_places():
    # P = 10, M = 100: 6 * 89 / 99 = 5.4, so 6 survive, 3 of them young; then 6 * 85 / 99 = 5.2, again 6; then
    # 6 * 81 / 99 = 4.9, so 5, of them 2.
    search = GeneticAlgorithm(SHAPE, 100, 10, seed=0, age_protection=1)
    search.ask()
    search.tell({index: 100.0 - index for index in range(10)})
    assert indices(search.survivors) == [0, 1, 2, 3, 4, 5]  # all are equally old
    assert indices(search.ask()) == [10, 11, 12, 13]
    search.tell({10: 1.0, 11: 4.0, 12: 3.0, 13: 2.0})
    assert indices(search.survivors) == [0, 1, 2, 11, 12, 13]
    assert indices(search.population)[:6] == [0, 1, 2, 3, 4, 5]
    assert indices(search.ask()) == [14, 15, 16, 17]
    search.tell({14: 200.0, 15: 0.0, 16: 0.0, 17: 0.0})  # 11 to 13 are protected no longer
    assert indices(search.survivors) == [14, 0, 1, 2, 15]


def test_protection_lasts_as_long_as_told():
    search = GeneticAlgorithm(SHAPE, 100, 10, seed=0, age_protection=2)
    search.ask()
    search.tell({index: 100.0 - index for index in range(10)})
    search.ask()
    search.tell({10: 0.0, 11: 98.5, 12: 0.0, 13: 0.0})  # the first ones are still young, too
    assert indices(search.survivors) == [0, 1, 11, 2, 3, 4]
    search.ask()
    search.tell({14: 3.5, 15: 0.0, 16: 0.0, 17: 0.0})  # two places for the young: 11 and 14
    assert indices(search.survivors) == [0, 1, 11, 2, 14]
    search.ask()
    search.tell(
        {18: 3.0, 19: 4.0, 20: 0.0, 21: 0.0, 22: 0.0}
    )  # 14 is young still, 11 is not: it has a place of its own
    assert indices(search.survivors) == [0, 1, 11, 19, 14]


def test_few_young_bodies_leave_their_places_to_others():
    # P = 10, M = 11: two survive. The one child takes the one place for the young, though it is worst.
    search = GeneticAlgorithm(SHAPE, 11, 10, seed=0, age_protection=1)
    search.ask()
    search.tell({index: float(index) for index in range(10)})
    assert indices(search.survivors) == [9, 8]
    search.ask()
    search.tell({10: -1.0})
    assert indices(search.survivors) == [9, 10]
