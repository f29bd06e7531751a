"""Children chosen from several mutants by a score that costs less than fitness: the protocol, and co-design with it."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from evogymcm.algos import RunFolder, RunRecord
from evogymcm.algos.codesign import GeneticAlgorithm, RandomSearch, codesign, cost_of, score_alone
from evogymcm.algos.codesign.scoring import score_together
from evogymcm.algos.codesign.start import env_maker
from tests.algos.codesign.test_codesign import RUNS, SEARCHING, TINY, told
from tests.algos.codesign.test_genetic import SHAPE, indices, play, voxels
from tests.algos.tools import through_json

# The protocol


def after_one_generation(**settings):
    search = GeneticAlgorithm(SHAPE, 40, 6, **({"seed": 3} | settings))
    play(search, 1)
    return search


def test_mutants_are_new_and_of_one_survivor_for_each_child():
    search = after_one_generation()
    survivors, seen = set(indices(search.survivors)), {item.design.key for item in search.population}
    groups = search.mutants(10)
    assert len(groups) == 6 - len(survivors)
    keys = [mutant.design.key for group in groups for mutant in group]
    assert len(set(keys)) == len(keys) == 10 * len(groups)
    assert not seen & set(keys)
    for index, group in enumerate(groups, start=6):
        assert {mutant.index for mutant in group} == {index}
        assert len({mutant.parent for mutant in group}) == 1
        assert group[0].parent in survivors
        assert all(mutant.generation == 1 and mutant.fitness is None for mutant in group)
    assert search.mutants(10) == groups  # the same until chosen
    assert search.n_designs == 6


def test_the_best_mutants_are_asked_for_and_the_others_forgotten():
    search = after_one_generation()
    groups = search.mutants(5)
    scores = np.array([[voxels(mutant) for mutant in group] for group in groups])
    scores[0] = [0.0, 7.0, 1.0, 7.0, 2.0]
    search.choose(scores)
    chosen = [group[int(np.argmax(row))] for group, row in zip(groups, scores, strict=True)]
    assert chosen[0] is groups[0][1]  # the first of equals
    assert search.ask() == chosen
    assert search.n_designs == 6 + len(groups)
    rest = {mutant.design.key for group in groups for mutant in group} - {mutant.design.key for mutant in chosen}
    assert not rest & set(search.state_dict()["seen"])
    search.tell({mutant.index: voxels(mutant) for mutant in chosen})
    assert len(search.population) == 6
    assert search.generation == 2


def test_choosing_keeps_to_the_budget():
    search = GeneticAlgorithm(SHAPE, 14, 6, seed=0)
    while not search.is_finished:
        if search.generation:
            search.choose([[voxels(mutant) for mutant in group] for group in search.mutants(4)])
        search.tell({item.index: voxels(item) for item in search.ask()})
    assert search.n_designs == 14
    with pytest.raises(RuntimeError, match="mutants: must be asked for between"):
        search.mutants(4)


def test_choosing_helps_where_the_score_is_the_fitness():
    def final(count):
        search = GeneticAlgorithm(SHAPE, 60, 10, seed=1)
        while not search.is_finished:
            if search.generation:
                search.choose([[voxels(mutant) for mutant in group] for group in search.mutants(count)])
            search.tell({item.index: voxels(item) for item in search.ask()})
        return search.best.fitness

    assert final(30) > final(1) + 0.1


def test_a_search_saved_before_the_choice_goes_on_to_the_same():
    search = after_one_generation(carries_stiffness=True)
    for individual in search.survivors:
        search.update(individual.index, stiffness=np.full(SHAPE, 1.5))
    groups = search.mutants(4)
    resumed = GeneticAlgorithm(SHAPE, 40, 6, seed=3, carries_stiffness=True)
    resumed.load_state_dict(through_json(search.state_dict()))
    assert resumed.mutants(4) == groups
    assert any(np.ptp(mutant.design.field[mutant.design.body.occupancy]) > 0 for mutant in groups[0])  # inherited
    for one in (search, resumed):
        one.choose([[voxels(mutant) for mutant in group] for group in groups])
    assert play(resumed, 2) == play(search, 2)


def test_bad_choices_are_refused_and_change_nothing():
    search = GeneticAlgorithm(SHAPE, 40, 6, seed=3)
    with pytest.raises(RuntimeError, match="mutants: must be asked for between"):
        search.mutants(2)
    search = after_one_generation()
    with pytest.raises(RuntimeError, match="choose: mutants must be asked for first"):
        search.choose([[0.0]])
    with pytest.raises(ValueError, match="count: got 0"):
        search.mutants(0)
    groups = search.mutants(2)
    before = search.state_dict()
    with pytest.raises(ValueError, match="count: got 3, expected at least 1, 2 are waiting"):
        search.mutants(3)
    with pytest.raises(RuntimeError, match="ask: mutants are waiting"):
        search.ask()
    for scores in (np.zeros((len(groups), 3)), np.full((len(groups), 2), np.nan), np.zeros(len(groups))):
        with pytest.raises(ValueError, match=r"scores: got .* expected finite numbers of shape"):
            search.choose(scores)
    assert search.state_dict() == before


# Fewer or more voxels


@pytest.mark.parametrize("method", [GeneticAlgorithm, RandomSearch])
def test_weights_hold_for_random_bodies_and_mutants(method):
    sizes = {}
    for name, weights in (("default", (0.6, 0.2, 0.2, 0.2, 0.2)), ("sparse", (1.6, 0.2, 0.0, 0.2, 0.4))):
        rows = play(method(SHAPE, 200, 40, seed=1, weights=weights), fitness=lambda individual: 0.0)
        text = "".join(row["body"] for row in rows)
        sizes[name] = [sum(cell in "RSHV" for cell in row["body"]) for row in rows]
        if name == "sparse":
            assert "S" not in text
            assert text.count("V") == pytest.approx(2 * text.count("H"), rel=0.3)
    assert np.mean(sizes["default"][:40]) == pytest.approx(16.7, abs=1.5)
    assert np.mean(sizes["sparse"][:40]) < 11
    assert np.mean(sizes["sparse"][40:]) < np.mean(sizes["default"][40:]) - 4


def test_weights_are_checked_and_part_of_the_state():
    with pytest.raises(ValueError, match="weights: got"):
        GeneticAlgorithm(SHAPE, 8, 4, seed=0, weights=(1, 1, 1, 0, 0))
    with pytest.raises(ValueError, match="weights: got"):
        replace(TINY, weights=(1.0, 1.0))
    state = GeneticAlgorithm(SHAPE, 8, 4, seed=0).state_dict()
    with pytest.raises(ValueError, match="weights: got"):
        GeneticAlgorithm(SHAPE, 8, 4, seed=0, weights=(2, 1, 1, 1, 1)).load_state_dict(state)


# Co-design

SCREENING = replace(TINY, inherit=True, mutants=3)


@functools.cache
def whole_screening():
    return codesign(SCREENING)


@pytest.mark.parametrize(
    "config",
    [
        RUNS["stiff"],
        pytest.param(TINY, marks=pytest.mark.slow),
        pytest.param(SEARCHING, marks=pytest.mark.slow),
    ],
)
def test_children_are_the_best_mutants_under_their_parents_policy(config, tmp_path, monkeypatch):
    config = replace(config, inherit=True, population=3, budget=5, mutants=10)  # two blocks of mutants
    played = []

    def spy(make_env, mutants, policies):
        scores = score_together(make_env, mutants, policies)
        played.append((mutants, policies, scores.score))
        return scores

    monkeypatch.setattr("evogymcm.algos.codesign.pieces.score_together", spy)
    seen = []
    result = codesign(config, run=RunFolder(tmp_path / "run", {}), progress=seen.append)
    assert [len(mutants[0]) for mutants, _, _ in played] == [8, 2, 8, 2]
    assert "screen" in {progress.phase for progress in seen}
    trained = {row["index"]: row for row in result.rows if row["event"] == "train"}
    run = RunFolder(tmp_path / "run", {}, resume=True)
    for child, (first, second) in zip((3, 4), (played[:2], played[2:]), strict=True):
        mutants, scores = [*first[0][0], *second[0][0]], np.concatenate([first[2][0], second[2][0]])
        pick = int(scores.argmax())
        assert mutants[pick].body.text == trained[child]["body"]
        assert np.ptp(scores) > 0
        if not config.search:  # there the parent's policy may have been tuned since it was played
            policies = [run.load(f"policy-{trained[child]['parent']:04}")]
            alone = score_alone(env_maker(config), [mutants[pick]], policies).score
            assert scores[pick] == pytest.approx(alone[0], abs=1e-5)
            assert trained[child]["fitness"] >= scores[pick] - 1e-5  # training starts from there
        if config.stiffness == 1.5:
            assert set(mutants[pick].field.ravel()) <= {1.0, 1.5}


def test_screening_is_counted():
    config = replace(RUNS["invariant"], population=3, inherit=True)
    plain, screened = (codesign(replace(config, mutants=mutants)) for mutants in (1, 4))
    children = 3
    assert screened.env_steps - plain.env_steps == children * 4 * 8
    cost = cost_of(replace(config, mutants=4))
    assert cost.screening == children * 4 * 8
    assert screened.env_steps == cost.total


# In the first training, before the mutants are played, and in the second training.
@pytest.mark.parametrize("calls", [pytest.param(2, marks=pytest.mark.slow), 4, 6])
def test_a_stopped_screening_goes_on_to_the_same_result(calls, tmp_path):
    whole, asked = whole_screening(), iter(range(10**6))
    stopped = codesign(SCREENING, run=tmp_path / "run", should_stop=lambda: next(asked) >= calls)
    assert not stopped.finished
    assert not RunRecord.read(tmp_path / "run").finished  # children that were chosen are proposed, but not trained
    assert told(codesign(SCREENING, run=tmp_path / "run")) == told(whole)
    assert RunRecord.read(tmp_path / "run").finished


def test_a_limit_of_env_steps_ends_no_run_between_screening_and_training():
    config = replace(SCREENING, population=3)
    one = codesign(replace(config, budget=3))
    result = codesign(replace(config, max_env_steps=one.env_steps + 1))  # reached while screening
    assert result.finished
    assert len(result.rows) == 4


def test_screening_needs_inherited_policies():
    with pytest.raises(ValueError, match=r"mutants: got 3, more than 1 need inherit"):
        replace(TINY, mutants=3)
    with pytest.raises(ValueError, match="method='qd'"):
        replace(SCREENING, method="qd")
    with pytest.raises(ValueError, match="mutants: got 0"):
        replace(TINY, mutants=0)
