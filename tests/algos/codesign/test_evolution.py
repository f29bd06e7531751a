"""Evolution of bodies with their gaits: survivors, resuming, what children inherit, and what is stored."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from evogymcm.algos.codesign import Evolution, EvolveConfig, evolve
from evogymcm.algos.gaits import load_gaits
from evogymcm.algos.learning import evaluate
from evogymcm.algos.runs import RunRecord
from evogymcm.envs import tasks

TINY = EvolveConfig(
    shape=(3, 3), max_env_steps=600, first=12, candidates=8, survivors=4, eval_starts=2, seed=3, num_threads=1
)


@pytest.fixture(autouse=True)
def _short(monkeypatch):
    for name in ("Walker-v0", "BidirectionalWalker-v0"):
        monkeypatch.setitem(tasks._REGISTRY, name, replace(tasks.as_task(name), time_limit=12))


def same(one, other):
    return one.best == other.best and one.rows == other.rows and np.array_equal(one.waves.cells, other.waves.cells)


@pytest.mark.parametrize("changes", [{}, {"material": "reactive"}, {"evolves_stiffness": True}])
def test_a_stopped_run_ends_like_one_that_was_not(tmp_path, changes):
    config = replace(TINY, **changes)
    whole = evolve(config)
    assert whole.finished
    asked = iter([False, False, True])
    stopped = evolve(config, run=tmp_path / "run", should_stop=lambda: next(asked))
    assert not stopped.finished
    assert not RunRecord.read(tmp_path / "run").finished
    other = evolve(replace(config, num_threads=2), run=None)
    resumed = evolve(config, run=tmp_path / "run")
    assert same(whole, resumed)
    assert same(whole, other)
    record = RunRecord.read(tmp_path / "run")
    assert record.finished
    assert record.env_steps == whole.env_steps
    last = [row for row in whole.rows if row["event"] == "evaluate"]
    worth = {row["index"]: row["robust_score"] + row["return"] - row["score"] for row in last}
    assert len(worth) == config.survivors
    assert whole.best.index == max(worth, key=worth.__getitem__)
    assert record.ranked()[0] == record.best
    assert record.best["index"] == whole.best.index
    assert record.best["fitness"] <= max(score for _, score in record.curve)


@pytest.mark.parametrize("changes", [{"material": "reactive"}, {"evolves_stiffness": True}, {"stiffness": 2.0}])
def test_what_is_stored_scores_as_it_says(tmp_path, changes):
    config = replace(TINY, **changes)
    result = evolve(config, run=tmp_path)
    saved = load_gaits(tmp_path)
    assert (saved.material, saved.bodies) == (config.material, (result.best.design.body,))
    played = evaluate(saved.waves, saved.make_engine(num_threads=1))
    assert played.score[0] == result.best.fitness
    rows = [row for row in result.rows if row["event"] == "evaluate"]
    row = next(row for row in rows if row["index"] == result.best.index)
    assert row["score"] == result.best.fitness
    assert {"robust_score", "spread", "stiffness_work"} <= row.keys()
    if "stiffness" in changes:
        assert (saved.stiffness[0][result.best.design.body.occupancy] == 2.0).all()


def test_a_design_whose_simulation_ends_in_instability_is_not_the_best():
    state = Evolution(TINY)
    while not state.is_finished:
        state.advance()
    winner = state.best
    for row in state.rows:
        if (row["event"], row["index"]) == ("evaluate", winner.individual.index):
            row["return"] -= 3.0  # the penalty, which no score holds
    assert state.best is not winner


def test_survivors_are_the_best_of_all_and_few_of_each_body():
    state = Evolution(replace(TINY, per_body=1, max_env_steps=1_000))
    seen = [-np.inf]
    while not state.is_finished:
        state.advance()
        fitness = [mover.fitness for mover in state.survivors]
        assert fitness == sorted(fitness, reverse=True)
        assert fitness[0] >= seen[-1]
        seen.append(fitness[0])
        assert max(Counter(mover.individual.design.key for mover in state.survivors).values()) == 1
    assert seen[-1] > seen[1]
    indices = [row["index"] for row in state.rows if row["event"] == "evolve"]
    assert indices == list(range(state.n_designs))
    parents = [row["parent"] for row in state.rows if row["generation"] > 0]
    assert parents
    assert set(parents) <= set(indices)


def test_a_child_changes_its_body_or_its_gait_and_keeps_the_rest():
    state = Evolution(replace(TINY, evolves_stiffness=True, candidates=64, gait_rate=0.5))
    state.advance()
    parents = {mover.individual.index: mover for mover in state.survivors}
    kinds = Counter()
    for child in state._children():
        parent = parents[child.individual.parent]
        has_body = child.individual.design.body == parent.individual.design.body
        has_gait = np.array_equal(child.gait, parent.gait) and np.array_equal(child.cells, parent.cells)
        kinds[has_body, has_gait] += 1
        if has_body:
            assert not has_gait
    assert set(kinds) >= {(True, False), (False, True), (False, False)}


def test_tasks_that_draw_are_played_several_times():
    config = replace(TINY, task="BidirectionalWalker-v0", first=2, survivors=2, candidates=2, max_env_steps=1)
    state = Evolution(config)
    state.advance()
    assert state.env_steps == 2 * 8 * 12


def test_where_work_costs_the_best_is_one_that_is_worth_it():
    config = replace(TINY, seed=0, work_weight=(1.0, 1.0))  # far more than any score
    result = evolve(config)
    rows = [row for row in result.rows if row["event"] == "evaluate"]
    worth = {row["index"]: row["robust_score"] - row["actuation_work"] - row["stiffness_work"] for row in rows}
    assert result.best.index == max(worth, key=worth.__getitem__)
    (row,) = (row for row in rows if row["index"] == result.best.index)
    assert result.best.fitness == pytest.approx(row["score"] - row["actuation_work"] - row["stiffness_work"])
    assert result.best.index != max(rows, key=lambda row: row["robust_score"])["index"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"survivors": 13}, "survivors: got 13, expected 2 to 12"),
        ({"material": "reactive", "evolves_stiffness": True}, "evolves_stiffness: got True"),
        ({"material": "reactive", "stiffness": 2.0}, "stiffness: got 2.0"),
        ({"evolves_stiffness": True, "stiffness": 2.0}, "begin at 1"),
        ({"body_rate": 0}, "body_rate"),
        ({"task": 3}, "task: got 3"),
        ({"weights": (1, 1, 1, 0, 0)}, "weights"),
    ],
)
def test_bad_settings_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(TINY, **changes)


def test_runs_that_cannot_start_leave_no_folder(tmp_path):
    for changes in ({"task": "Nothing-v0"}, {"task": "CaveCrawler-v0", "shape": (30, 30)}):
        with pytest.raises(ValueError, match=r"Nothing-v0|body"):
            evolve(replace(TINY, **changes), run=tmp_path / "run")
    assert not (tmp_path / "run").exists()
