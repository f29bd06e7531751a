"""Co-design: bookkeeping of its phases, exact scores, budgets, and resuming to the same result."""

import threading
from dataclasses import asdict, dataclass, replace

import numpy as np
import pytest
import torch

import evogymcm as cm
from evogymcm.algos import BodyPPOConfig, RunFolder
from evogymcm.algos.codesign import Arena, CodesignConfig, Design, SearchConfig, codesign, score_alone, train_designs
from evogymcm.algos.codesign.scoring import score_together
from evogymcm.envs import Task

PPO = BodyPPOConfig(
    total_steps=256, num_worlds=8, rollout_steps=16, epochs=2, minibatch=32, hidden=8, eval_interval=128
)  # fmt: skip
TINY = CodesignConfig(
    task="Dash-v0", shape=(2, 3), population=4, budget=6, ppo=PPO, search=SearchConfig(rounds=3), finetune_steps=128
)
ARMS = ("reactive", "fixed", "invariant", "prescribed")


@dataclass(frozen=True)
class Dash(Task):
    """Get far in a short time."""

    def reward(self, before, after):
        return after.x - before.x


if "Dash-v0" not in cm.tasks:
    observes = ("velocity", "orientation", "relative")
    cm.register_task(Dash("Dash-v0", world="Walker-v0", spawn=(1, 1), time_limit=8, observes=observes))


def told(result):
    """What a run is judged by, without the weights."""
    return result.rows, result.env_steps, result.best.record()


@pytest.mark.parametrize("arm", ARMS)
def test_a_run_from_end_to_end(arm, tmp_path):
    config = replace(TINY, arm=arm, prescribed=1.5)
    seen = []
    run = RunFolder(tmp_path / "run", asdict(config))
    result = codesign(config, run=run, progress=seen.append)
    assert result.finished
    rows = run.rows()
    trained = [row["index"] for row in rows if row["event"] == "train"]
    assert trained == list(range(6))  # every body once
    phases = {row["event"] for row in rows}
    assert phases == ({"train", "search", "finetune"} if arm == "invariant" else {"train"})
    steps = [row["env_steps"] for row in rows]
    assert steps == sorted(steps)
    assert result.env_steps == steps[-1] > 6 * 256
    best = [row["best"] for row in rows]
    assert best == sorted(best)
    assert result.best.fitness == best[-1] == max(row["fitness"] for row in rows)
    assert {progress.phase for progress in seen} == phases
    assert all((run.path / f"policy-{index:04}.pt").is_file() for index in trained)
    assert result.policy["form"]["ranges"].keys() == {"actuation"} | ({"stiffness"} if arm == "reactive" else set())


@pytest.mark.parametrize(("arm", "is_blurred"), [("reactive", False), ("invariant", False), ("invariant", True)])
def test_scores_and_returns_can_be_had_again_to_the_last_bit(arm, is_blurred, tmp_path, monkeypatch):
    config = replace(TINY, arm=arm)
    if is_blurred:  # scores of a batch that are off by more than rounding, and several candidates to choose from
        rng = np.random.default_rng(0)

        def blurred(*args):
            exact = score_together(*args)
            return replace(exact, score=exact.score + rng.normal(scale=0.01, size=exact.score.shape))

        monkeypatch.setattr("evogymcm.algos.codesign.scoring.score_together", blurred)
        search = SearchConfig(rounds=4, candidates=4, probability=1.0, acceptance="paper")
        config = replace(config, search=search)
    run = RunFolder(tmp_path / "run", asdict(config))
    codesign(config, run=run)
    last = {row["index"]: row for row in run.rows()}
    designs = [Design.from_record(row) for row in last.values()]
    policies = [run.load(f"policy-{index:04}") for index in last]
    again = score_alone(config.make_arena(), designs, policies)
    assert again.score.tolist() == [row["fitness"] for row in last.values()]
    assert again.returns.tolist() == [row["return"] for row in last.values()]
    alone = score_alone(config.make_arena(), designs[-1:], policies[-1:]).score
    assert alone[0] == again.score[-1]


def test_fitness_of_survivors_never_falls():
    result = codesign(replace(TINY, arm="invariant", search=SearchConfig(rounds=6, acceptance="paper")))
    best = {}
    for row in result.rows:
        assert row["fitness"] >= best.get(row["index"], -np.inf)
        best[row["index"]] = row["fitness"]
    fields = [row["stiffness"] for row in result.rows if row["event"] == "search"]
    assert any(field is not None and np.ptp(np.array(field)) > 0 for field in fields)  # something was found


def test_prescribed_stiffness_is_simulated():
    config = replace(TINY, population=3, budget=3)
    arms = [codesign(replace(config, arm="prescribed", prescribed=value)) for value in (0.5, 1.0, 2.0)]
    fixed = codesign(replace(config, arm="fixed"))
    scores = [[row["fitness"] for row in result.rows] for result in arms]
    assert scores[1] == [row["fitness"] for row in fixed.rows]
    assert scores[0] != scores[1] != scores[2]


def test_scores_together_are_those_alone_but_for_rounding():
    arena = Arena("Dash-v0", "invariant", num_threads=2)
    rng = np.random.default_rng(0)
    designs = [Design(cm.sample_body((2, 3), rng)) for _ in range(3)]
    trained = train_designs(arena, designs, PPO)
    fields = [Design(d.body, rng.uniform(0.5, 2.0, (2, 3))) for _ in range(2) for d in designs]
    before = threading.enumerate()
    together = score_together(arena, fields, trained.best, 2).score
    alone = score_alone(arena, fields, trained.best * 2).score
    assert threading.enumerate() == before  # the simulators' have ended
    np.testing.assert_allclose(together, alone, rtol=0, atol=1e-6)


def test_inheritance_starts_from_the_parents_controller(tmp_path):
    config = replace(TINY, inherit=True, ppo=replace(PPO, learning_rate=1e-12))
    result = codesign(config, run=RunFolder(tmp_path / "run", {}))
    run = RunFolder(tmp_path / "run", {}, resume=True)
    children = [row for row in result.rows if row["parent"] is not None]
    assert children
    for row in children:  # with hardly any learning, a child's weights are its parent's
        own, parent = (run.load(f"policy-{row[key]:04}")["actor"] for key in ("index", "parent"))
        torch.testing.assert_close(own["local.weight"], parent["local.weight"], atol=1e-6, rtol=1e-6)


def test_inherited_controllers_can_explore_anew(tmp_path):
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


def test_halving_saves_training():
    whole, halved = codesign(TINY), codesign(replace(TINY, rungs=(0.5,), keep=(0.34,)))
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
    ("arm", "calls"),  # in the first and the second training; in a search, and in fine-tuning
    [
        pytest.param("reactive", 1, marks=pytest.mark.slow),
        ("reactive", 4),
        pytest.param("invariant", 1, marks=pytest.mark.slow),
        ("invariant", 5),
        pytest.param("invariant", 8, marks=pytest.mark.slow),
    ],
)
def test_a_stopped_run_goes_on_to_the_same_result(arm, calls, tmp_path):
    config = replace(TINY, arm=arm)
    whole, asked = codesign(config), iter(range(10**6))
    stopped = codesign(config, run=RunFolder(tmp_path / "run", {}), should_stop=lambda: next(asked) >= calls)
    assert not stopped.finished
    again = codesign(config, run=RunFolder(tmp_path / "run", {}, resume=True))
    assert told(again) == told(whole)
    assert again.rows == RunFolder(tmp_path / "run", {}, resume=True).rows()
    for key, values in whole.policy["actor"].items():
        assert torch.equal(values, again.policy["actor"][key])


def test_bad_settings_are_refused():
    for changes, message in (
        ({"arm": "active"}, "arm: got 'active', allowed are"),
        ({"method": "bo"}, "method: got 'bo'"),
        ({"prescribed": 3.0}, "prescribed: got 3.0"),
        ({"population": 9}, "population: got 9"),
        ({"rungs": (0.5,), "keep": ()}, "keep: got"),
        ({"ppo": BodyPPOConfig(network="mlp")}, "ppo.network: got 'mlp'"),
        ({"max_env_steps": 0}, "max_env_steps: got 0"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(TINY, **changes)
