"""Co-design: bookkeeping of its phases, exact scores, budgets, and resuming to the same result."""

import functools
import threading
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
import pytest
import torch
from torch.utils._pytree import tree_leaves

import evogymcm as cm
from evogymcm.algos import BodyPPOConfig, RunFolder, RunRecord
from evogymcm.algos.codesign import (
    CodesignConfig,
    Design,
    SearchConfig,
    codesign,
    cost_of,
    score_alone,
    train_designs,
)
from evogymcm.algos.codesign.design import Individual
from evogymcm.algos.codesign.ledger import Ledger
from evogymcm.algos.codesign.scoring import score_together
from evogymcm.algos.codesign.start import env_maker
from evogymcm.envs import SoftRobotEnv, Task

PPO = BodyPPOConfig(
    total_steps=256, num_worlds=8, rollout_steps=16, epochs=1, minibatch=64, hidden=8, eval_interval=128
)  # fmt: skip
TINY = CodesignConfig("Dash-v0", shape=(2, 3), population=4, budget=6, ppo=PPO, piece=2, finetune_steps=128)
SEARCHING = replace(TINY, material="invariant", search=SearchConfig(rounds=3))
RUNS = {
    "reactive": TINY,
    "invariant": replace(TINY, material="invariant"),
    "stiff": replace(TINY, material="invariant", stiffness=1.5),
    "searching": SEARCHING,
}


@dataclass(frozen=True)
class Dash(Task):
    """Get far in a short time."""

    def reward(self, before, after):
        return after.x - before.x


if "Dash-v0" not in cm.tasks:
    observes = ("velocity", "orientation", "relative")
    cm.register_task(Dash("Dash-v0", world="Walker-v0", spawn=(1, 1), time_limit=8, observes=observes))


def through_old_words(run):
    """Writes a run's settings and state as the version before did: with an arm, policies in the state, other names."""
    settings = run.read_json("config.json")
    searches = settings["search"] is not None
    arm = "reactive" if settings.pop("material") == "reactive" else "invariant" if searches else "prescribed"
    settings |= {"arm": arm, "prescribed": settings.pop("stiffness")}
    del settings["piece"]  # a generation was trained in one
    run.write_json("config.json", settings | {"search": settings["search"] or asdict(SearchConfig())})
    state = run.load("codesign")
    if state:
        best = state["champion"]["individual"]
        state["champion"]["policy"] = run.load(f"policy-{best['index']:04}")
        state["policies"], state["returns"] = {best["index"]: state["champion"]["policy"]}, {best["index"]: 0.0}
        run.save("codesign", state)


def told(result):
    """What a run is judged by, without the weights."""
    return result.rows, result.env_steps, result.best.record()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Gives a run that has come to its end: its folder, its result, and what it told. Each is made once."""

    @functools.cache
    def make(config):
        seen, run = [], RunFolder(tmp_path_factory.mktemp("finished") / "run", asdict(config))
        return run, codesign(config, run=run, progress=seen.append), seen

    return make


@pytest.mark.parametrize("config", RUNS.values(), ids=RUNS)
def test_a_run_from_end_to_end(config, finished):
    run, result, seen = finished(config)
    assert result.finished
    rows = run.rows()
    trained = [row["index"] for row in rows if row["event"] == "train"]
    assert trained == list(range(6))  # every body once
    phases = {row["event"] for row in rows}
    assert phases == ({"train", "search", "finetune"} if config.search else {"train"})
    steps = [row["env_steps"] for row in rows]
    assert steps == sorted(steps)
    assert result.env_steps == steps[-1] > 6 * 256
    best = [row["best"] for row in rows]
    assert best == sorted(best)
    assert result.best.fitness == best[-1] == max(row["fitness"] for row in rows)
    assert {progress.phase for progress in seen} == phases
    assert all((run.path / f"policy-{index:04}.pt").is_file() for index in trained)
    actions = {"actuation", "stiffness"} if config.material == "reactive" else {"actuation"}
    assert result.policy["form"]["ranges"].keys() == actions


@pytest.mark.parametrize(("config", "is_blurred"), [(TINY, False), (SEARCHING, False), (SEARCHING, True)])
def test_scores_and_returns_can_be_had_again_to_the_last_bit(config, is_blurred, finished, tmp_path, monkeypatch):
    if is_blurred:  # scores of a batch that are off by more than rounding, and several candidates to choose from
        rng = np.random.default_rng(0)

        def blurred(*args, **options):
            exact = score_together(*args, **options)
            return replace(exact, score=exact.score + rng.normal(scale=0.01, size=exact.score.shape))

        monkeypatch.setattr("evogymcm.algos.codesign.scoring.score_together", blurred)
        search = SearchConfig(rounds=4, candidates=4, probability=1.0, acceptance="paper")
        config = replace(config, search=search)
        run = RunFolder(tmp_path / "run", asdict(config))
        codesign(config, run=run)
    else:
        run, *_ = finished(config)
    last = {row["index"]: row for row in run.rows()}
    designs = [Design.from_record(row) for row in last.values()]
    policies = [run.load(f"policy-{index:04}") for index in last]
    again = score_alone(env_maker(config), designs, policies)
    assert again.score.tolist() == [row["fitness"] for row in last.values()]
    assert again.returns.tolist() == [row["return"] for row in last.values()]
    alone = score_alone(env_maker(config), designs[-1:], policies[-1:]).score
    assert alone[0] == again.score[-1]


def test_fitness_of_survivors_never_falls():
    result = codesign(replace(SEARCHING, search=SearchConfig(rounds=6, acceptance="paper")))
    best = {}
    for row in result.rows:
        assert row["fitness"] >= best.get(row["index"], -np.inf)
        best[row["index"]] = row["fitness"]
    fields = [row["stiffness"] for row in result.rows if row["event"] == "search"]
    assert any(field is not None and np.ptp(np.array(field)) > 0 for field in fields)  # something was found


def test_stiffness_is_simulated():
    config = replace(TINY, material="invariant", population=3, budget=3)
    results = [codesign(replace(config, stiffness=value)) for value in (0.5, 1.0, 2.0)]
    scores = [[row["fitness"] for row in result.rows] for result in results]
    assert scores[0] != scores[1] != scores[2]


def test_scores_together_are_those_alone_but_for_rounding():
    make_env = partial(SoftRobotEnv, "Dash-v0", num_threads=2)
    rng = np.random.default_rng(0)
    designs = [Design(cm.sample_body((2, 3), rng)) for _ in range(3)]
    trained = train_designs(make_env, designs, PPO)
    groups = [[Design(design.body, rng.uniform(0.5, 2.0, (2, 3))) for _ in range(2)] for design in designs]
    before = threading.enumerate()
    together = score_together(make_env, groups, trained.best)
    assert together.env_steps == 6 * 8
    for group, policy, score in zip(groups, trained.best, together.score, strict=True):
        alone = score_alone(make_env, group, [policy] * 2).score
        np.testing.assert_allclose(score, alone, rtol=0, atol=1e-6)
    assert threading.enumerate() == before  # the simulators' have ended


def test_inheritance_starts_from_the_parents_policy(tmp_path):
    config = replace(TINY, inherit=True, ppo=replace(PPO, learning_rate=1e-12))
    result = codesign(config, run=RunFolder(tmp_path / "run", {}))
    run = RunFolder(tmp_path / "run", {}, resume=True)
    children = [row for row in result.rows if row["parent"] is not None]
    assert children
    for row in children:  # with hardly any learning, a child's weights are its parent's
        own, parent = (run.load(f"policy-{row[key]:04}")["actor"] for key in ("index", "parent"))
        torch.testing.assert_close(own["local.weight"], parent["local.weight"], atol=1e-6, rtol=1e-6)


def test_inherited_policies_can_explore_anew(tmp_path):
    ppo = replace(PPO, learning_rate=1e-12, initial_std=2.0, final_std=2.0)
    config = replace(TINY, inherit=True, inherit_std=0.5, ppo=ppo)
    result = codesign(config, run=RunFolder(tmp_path / "run", {}))
    run = RunFolder(tmp_path / "run", {}, resume=True)
    for row in result.rows:
        std = run.load(f"policy-{row['index']:04}")["actor"]["log_std"].exp()
        expected = 2.0 if row["parent"] is None else 0.5
        torch.testing.assert_close(std, torch.full_like(std, expected))
    with pytest.raises(ValueError, match=r"inherit_std: got 0.5, but inherit is off"):
        replace(TINY, inherit_std=0.5)
    with pytest.raises(ValueError, match="inherit_std: got 0"):
        replace(TINY, inherit=True, inherit_std=0.0)


def test_halving_saves_training(finished):
    (_, whole, _), halved = finished(TINY), codesign(replace(TINY, rungs=(0.5,), keep=(0.34,)))
    assert halved.finished
    assert halved.env_steps < whole.env_steps
    assert len(halved.rows) == len(whole.rows) == 6


def test_the_budget_of_env_steps_ends_a_run():
    limit = 3000
    result = codesign(replace(TINY, budget=30, max_env_steps=limit))
    assert result.finished
    before = [row["env_steps"] for row in result.rows if row["env_steps"] < limit]
    assert result.env_steps >= limit
    assert len(result.rows) < 30
    assert result.rows[-1]["env_steps"] not in before  # it stopped with the phase that crossed the limit


@pytest.mark.parametrize(
    ("config", "calls"),  # in the first and the second training; in a search, and in fine-tuning
    [
        pytest.param(TINY, 1, marks=pytest.mark.slow),
        (TINY, 4),
        pytest.param(SEARCHING, 1, marks=pytest.mark.slow),
        (SEARCHING, 5),
        pytest.param(SEARCHING, 8, marks=pytest.mark.slow),
    ],
)
def test_a_stopped_run_goes_on_to_the_same_result(config, calls, finished, tmp_path):
    (_, whole, _), asked = finished(config), iter(range(10**6))
    stopped = codesign(config, run=RunFolder(tmp_path / "run", {}), should_stop=lambda: next(asked) >= calls)
    assert not stopped.finished
    again = codesign(config, run=RunFolder(tmp_path / "run", {}, resume=True))
    assert told(again) == told(whole)
    assert again.rows == RunFolder(tmp_path / "run", {}, resume=True).rows()
    for key, values in whole.policy["actor"].items():
        assert torch.equal(values, again.policy["actor"][key])


@pytest.mark.parametrize("saves", [3, pytest.param(6, marks=pytest.mark.slow)])  # after each fine-tuning
def test_a_run_killed_between_its_policies_and_its_state_goes_on_to_the_same_result(saves, tmp_path, monkeypatch):
    ppo, search = replace(PPO, total_steps=128, epochs=2, minibatch=32), SearchConfig(rounds=1)
    config = replace(SEARCHING, ppo=ppo, search=search, finetune_steps=512)
    whole, save, seen = codesign(config, run=RunFolder(tmp_path / "whole", {})), RunFolder.save, iter(range(10**6))
    fitness = {(row["event"], row["generation_now"], row["index"]): row["fitness"] for row in whole.rows}
    gained = [
        generation
        for (event, generation, index), value in fitness.items()
        if event == "finetune" and value > fitness["search", generation, index]
    ]
    assert {0, 1} <= set(gained)  # policies were replaced

    def dying(self, name, state):
        if name == "codesign" and next(seen) == saves - 1:
            raise KeyboardInterrupt
        save(self, name, state)

    run = RunFolder(tmp_path / "run", {})
    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "save", dying)
        with pytest.raises(KeyboardInterrupt):
            codesign(config, run=run)
    run = RunFolder(tmp_path / "run", {}, resume=True)
    assert told(codesign(config, run=run)) == told(whole)
    for file in (tmp_path / "whole").glob("*.pt"):
        if file.stem != "codesign":
            for key, values in torch.load(file)["actor"].items():
                assert torch.equal(values, run.load(file.stem)["actor"][key])
    state = run.load("codesign")  # each policy lies in its own file, and nowhere else
    assert not any(isinstance(value, torch.Tensor) for value in tree_leaves(state))


@pytest.mark.parametrize("name", ["stiff", "searching"])
def test_runs_in_the_words_of_before_go_on_to_the_same_result(name, tmp_path):
    config, asked = replace(RUNS[name], piece=None), iter(range(10**6))
    run = RunFolder(tmp_path / "run", asdict(config))
    codesign(config, run=run, should_stop=lambda: next(asked) >= 4)
    through_old_words(run)
    again = codesign(config, run=RunFolder(tmp_path / "run", asdict(config), resume=True))
    assert told(again) == told(codesign(config))
    with pytest.raises(ValueError, match="material: got reactive, the run has invariant"):
        RunFolder(tmp_path / "run", asdict(TINY), resume=True)


STARTS = replace(TINY, budget=4, eval_starts=3, ppo=replace(PPO, eval_starts=2, selection="robust"))
SEARCHED = replace(STARTS, material="invariant", search=SearchConfig(rounds=1, acceptance="paper"))


@pytest.mark.parametrize("config", [STARTS, replace(STARTS, selection="robust"), replace(SEARCHED, selection="robust")])
def test_fitness_is_what_the_selection_says_from_as_many_starts_as_the_settings(config, tmp_path):
    run = RunFolder(tmp_path / "run", asdict(config))
    calls = []
    codesign(config, run=run, should_stop=lambda: calls.append(1) or len(calls) > 2)
    result = codesign(config, run=RunFolder(run.path, asdict(config), resume=True))
    assert told(result) == told(codesign(config))
    most = cost_of(config)  # a search plays again only what may be accepted
    assert most.total - most.search <= result.env_steps <= most.total
    last = {row["index"]: row for row in result.rows}
    designs = [Design.from_record(row) for row in last.values()]
    policies = [run.load(f"policy-{index:04}") for index in last]
    again = score_alone(env_maker(config), designs, policies, starts=3)
    np.testing.assert_array_equal(again.score, score_alone(env_maker(config), designs, policies).score)
    assert again.env_steps == 3 * len(designs) * 8
    by = "robust_score" if config.selection == "robust" else "score"
    for i, row in enumerate(last.values()):
        assert again.row(i) == {name: row[name] for name in ("return", "score", "robust_score", "spread")}
        assert row["fitness"] == row[by]
    one = score_alone(env_maker(config), designs[1:2], policies[1:2], starts=3)
    assert (one.robust[0], one.spread[0]) == (again.robust[1], again.spread[1])
    record = RunRecord.read(run.path)
    assert record.best["robust_score"] == last[result.best.index]["robust_score"]


def test_a_table_that_is_taken_up_again_goes_on_with_what_it_told(tmp_path):
    run, one = RunFolder(tmp_path / "run", {}), Individual(0, Design(cm.Body("HVH/S.R")), fitness=1.5)
    ledger, again = Ledger(run), Ledger(run)
    scores = {"return": 3.0, "score": 2.0, "robust_score": 1.5, "spread": 0.25}
    ledger.add("train", one, 0, 10, scores)
    again.load_state_dict(ledger.state_dict())
    again.add("search", one, 0, 20, None)
    assert scores.items() <= run.rows()[-1].items()


def test_a_run_of_before_there_were_several_starts_is_gone_on_with(tmp_path):
    settings = asdict(TINY)
    run = RunFolder(tmp_path / "run", settings)
    for place in (settings, settings["ppo"]):
        del place["eval_starts"], place["selection"]
    run.write_json("config.json", settings)
    assert RunFolder(run.path, asdict(TINY), resume=True).config
    with pytest.raises(ValueError, match="eval_starts: got 2, the run has 1"):
        RunFolder(run.path, asdict(replace(TINY, eval_starts=2)), resume=True)


def test_work_is_told_of_each_design_and_changes_no_fitness(tmp_path):
    run, config = tmp_path / "run", replace(SEARCHING, budget=4)
    plain, measured = codesign(config), codesign(replace(config, work_weight=0), run=run)
    assert [row["fitness"] for row in measured.rows] == [row["fitness"] for row in plain.rows]
    assert all(row["actuation_work"] > 0 == row["stiffness_work"] for row in measured.rows)
    assert not any("actuation_work" in row for row in plain.rows)
    best = RunRecord.read(run).best
    assert best["actuation_work"] in [row["actuation_work"] for row in measured.rows if row["index"] == best["index"]]
    dear = codesign(replace(config, work_weight=1.0))
    assert [row["fitness"] for row in dear.rows] != [row["fitness"] for row in plain.rows]  # policies learn otherwise
