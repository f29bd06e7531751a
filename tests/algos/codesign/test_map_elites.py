"""MAP-Elites over designs, on an objective that needs no simulator."""

from functools import partial

import numpy as np
import pytest

from evogymcm.algos.codesign import Design, MapElites, design_measures
from evogymcm.body import Body
from tests.algos.codesign.test_genetic import play as play_for

SHAPE = (4, 4)


@pytest.fixture
def ribs():
    return pytest.importorskip("ribs")


def voxels(individual):
    """A toy fitness: few voxels are good."""
    return -float(individual.design.body.n_voxels)


play = partial(play_for, fitness=voxels)


def kind(search, individual):
    return int(search.archive.index_of_single(design_measures(individual.design)))


def check_elites(search):
    """The elites are the best of their kinds; of equals, any one."""
    best = {}
    for individual in search.population:
        best.setdefault(kind(search, individual), individual.fitness)
    assert {kind(search, elite): elite.fitness for elite in search.elites} == best
    assert len(search.elites) == len(best) == search.archive.stats.num_elites


def test_measures_by_hand():
    body = Body("HR/.S/.V")
    assert design_measures(Design(body)) == (0.5, 1.0)
    field = [[0.5, 1.0], [2.0, 1.5], [2.0, 1.0]]  # the empty cells do not count
    assert design_measures(Design(body, field)) == (0.5, 1.0)
    assert design_measures(Design(Body("HR"), [[2.0, 1.0]])) == (0.5, 1.5)


def test_elites_are_the_best_of_their_kinds(ribs):
    search = MapElites(SHAPE, 150, 10, seed=0, carries_stiffness=True)
    rows = play(search)
    assert len(rows) == search.n_designs == 150
    assert len({row["body"] for row in rows}) == 150
    check_elites(search)
    assert len(search.elites) > 20
    assert search.best.fitness == search.archive.stats.obj_max
    assert [elite.fitness for elite in search.elites] == sorted((e.fitness for e in search.elites), reverse=True)


def test_parents_are_elites_and_children_follow_them(ribs):
    search = MapElites(SHAPE, 120, 10, seed=0, initial=20, carries_stiffness=True)
    assert all(row["parent"] is None for row in play(search, 2))
    n_kinds = len(search.elites)
    while not search.is_finished:
        elites = {elite.index: elite.design for elite in search.elites}
        for child in search.ask():
            parent = elites[child.parent]
            assert child.design.body != parent.body
            assert child.design.stiffness is not None
        search.tell({child.index: voxels(child) for child in search.ask()})
        new = [elite.index for elite in search.elites if elite.index not in elites]
        assert sorted(new) == sorted(survivor.index for survivor in search.survivors)
        assert len(search.elites) >= n_kinds
        n_kinds = len(search.elites)


def test_random_designs_spread_over_stiffness(ribs):
    search = MapElites(SHAPE, 300, 300, seed=1, carries_stiffness=True)
    fields = [individual.design for individual in search.ask()]
    levels = np.array([design.field[design.body.occupancy].mean() for design in fields])
    assert all(np.ptp(design.field[design.body.occupancy]) == 0.0 for design in fields)
    assert np.log(levels).mean() == pytest.approx(0.0, abs=4 * np.log(2) / np.sqrt(3 * 300))
    assert np.log(levels).std() == pytest.approx(np.log(2) / np.sqrt(3), rel=0.1)


def test_without_stiffness_there_is_one_column(ribs):
    search = MapElites(SHAPE, 60, 20, seed=0, dims=(8, 1))
    play(search)
    assert all(individual.design.stiffness is None for individual in search.population)
    check_elites(search)
    assert 2 <= len(search.elites) <= 8


def test_an_improved_survivor_may_change_its_kind(ribs):
    search = MapElites(SHAPE, 40, 20, seed=0, carries_stiffness=True)
    play(search, 1)
    survivor = search.survivors[-1]
    before = kind(search, survivor)
    search.update(survivor.index, stiffness=np.full(SHAPE, 2.0), fitness=5.0)
    assert search.best.index == survivor.index
    assert kind(search, search.best) != before
    assert survivor.index in [elite.index for elite in search.elites]
    check_elites(search)
    search.ask()
    assert search.best.index == survivor.index  # also while others are waiting


def test_of_equals_the_first_stays(ribs):
    search = MapElites(SHAPE, 40, 20, seed=0, dims=(1, 1))
    play(search, fitness=lambda _: 1.0)
    assert [elite.index for elite in search.elites] == [0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"initial": 0}, "initial: got 0"),
        ({"dims": (10, 0)}, "dims"),
        ({"dims": (10,)}, "dims"),
        ({"sigma": -1.0}, "sigma"),
        ({"probability": 2.0}, "probability"),
    ],
)
def test_bad_arguments_are_refused(ribs, arguments, message):
    with pytest.raises(ValueError, match=message):
        MapElites(**({"shape": SHAPE, "budget": 40, "population": 10, "seed": 0} | arguments))
