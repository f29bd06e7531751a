"""One policy for every body: what is trained on what, exact resuming, shares of specialists; tiny runs end to end."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.experiments.universal import Universal
from benchmarks.experiments.universal_job import ALONE, IDLE, OWN, TUNED, UNSEEN, five_bodies
from evogymcm.algos import PPOConfig, baselines, load_policy
from evogymcm.algos.codesign import Design, score_alone
from evogymcm.algos.learning.bodies import held_out_bodies
from evogymcm.algos.runs import RunFolder
from evogymcm.envs import tasks

SHORT = replace(tasks.as_task("Walker-v0"), time_limit=6)
PPO = PPOConfig(total_steps=192, num_worlds=2, rollout_steps=32, minibatch=64, epochs=1, hidden=4, eval_interval=64)


@pytest.fixture(autouse=True)
def short_episodes(monkeypatch):
    monkeypatch.setitem(tasks._REGISTRY, "Walker-v0", SHORT)


def tiny(*arms, **changes):
    settings = {"bodies": 3, "trained_on": 2, "finetune_steps": 600, "specialist_steps": 900, "seeds": (1,), "ppo": PPO}
    return Universal(arms=arms, **settings | changes)


def run(experiment, folder, resume=False, should_stop=lambda: False):
    told = []
    (job,) = experiment.jobs()
    return job.run(folder, resume, lambda steps, score: told.append(steps), should_stop), told


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A reactive policy for all bodies from end to end: its folder, its record, the env-steps that it told."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(tasks._REGISTRY, "Walker-v0", SHORT)
        return folder, *run(tiny("stream", material="reactive"), folder)


def test_one_policy_is_scored_on_unseen_bodies_with_its_stiffness_and_without(whole):
    folder, record, told = whole
    run_folder = folder / "Walker-v0-stream-seed1"
    assert record["finished"]
    assert told[-1] == record["env_steps"]
    assert {kind: len(scores) for kind, scores in record["scores"].items()} == {UNSEEN: 3, IDLE: 3, TUNED: 2}
    saved = load_policy(run_folder / "policy" / "final.pt")
    policy = {name: saved.state[name] for name in ("form", "actor", "critic")}
    designs = [Design(body) for body in held_out_bodies((5, 5), 3)]
    make_env = tiny("stream", material="reactive").jobs()[0]._make_env("reactive")
    alone = score_alone(make_env, designs, [policy] * 3, starts=8)  # many bodies in one batch may round otherwise
    assert record["scores"][UNSEEN] == pytest.approx(alone.robust.tolist(), abs=1e-4)
    with torch.no_grad():  # a policy whose stiffness is 1 scores the same as one without stiffness
        actor = {name: value.clone() for name, value in policy["actor"].items()}
        row = list(policy["form"]["ranges"]).index("stiffness")
        actor["heads.weight"][row], actor["heads.bias"][row] = 0.0, 2 * np.arctanh(-1 / 6)
    idle = score_alone(make_env, designs, [policy | {"actor": actor}] * 3, starts=8).robust
    assert record["scores"][IDLE] == pytest.approx(idle.tolist(), abs=1e-4)
    assert record["scores"][IDLE] != record["scores"][UNSEEN]
    tuned = RunFolder.open(run_folder / "bodies").load("final")["actor"]["heads.weight"]
    assert not torch.equal(tuned[0], tuned[1])
    first = RunFolder.open(run_folder / "bodies").load("best")["actor"]["log_std"]
    assert first.max() > policy["actor"]["log_std"].max()  # it explores again


@pytest.mark.slow
def test_a_stopped_run_resumes_exactly(whole, tmp_path):
    experiment = tiny("stream", material="reactive")
    for updates in (1, 2):  # within the training of the one policy, then within fine-tuning
        calls = iter(range(100))
        stopped, _ = run(experiment, tmp_path, resume=True, should_stop=lambda c=calls, n=updates: next(c) >= n)
        assert not stopped["finished"]
    assert set(stopped["scores"]) == {UNSEEN, IDLE}
    resumed, _ = run(experiment, tmp_path, resume=True)
    assert resumed["scores"] == whole[1]["scores"]
    assert resumed["curve"] == whole[1]["curve"]


@pytest.mark.parametrize("material", ["invariant", "reactive"])
def test_a_gait_of_its_own_for_each_body_in_as_many_env_steps_as_fine_tuning(tmp_path, material):
    pytest.importorskip("cma")
    experiment = tiny("gaits", material=material)
    stopped, _ = run(experiment, tmp_path, should_stop=lambda: True)
    assert (stopped["finished"], stopped["scores"]) == (False, {})
    record, told = run(experiment, tmp_path, resume=True)
    assert record["finished"]
    assert record["env_steps"] == told[-1] <= 2 * 600
    assert set(record["scores"]) == {ALONE}
    assert len(record["scores"][ALONE]) == 2
    with pytest.raises(ValueError, match="env_steps: got 100"):
        tiny("gaits", finetune_steps=100)


def test_one_policy_for_five_bodies_is_scored_on_them_and_on_unseen_ones(tmp_path):
    experiment = tiny("five", ppo=replace(PPO, num_worlds=5, total_steps=160))
    record, told = run(experiment, tmp_path)
    assert record["finished"]
    assert told[-1] == record["env_steps"] == 160
    assert {kind: len(scores) for kind, scores in record["scores"].items()} == {UNSEEN: 3, OWN: 5}
    trained = RunFolder.open(tmp_path / "Walker-v0-five-seed1" / "policy").config["bodies"]
    assert trained == [body.text for body in five_bodies()]
    assert not set(trained) & {body.text for body in held_out_bodies((5, 5))}
    lines = experiment.table(experiment.summarise([record])).splitlines()
    scores = record["scores"][OWN]
    assert [cell.strip() for cell in lines[-1].strip("|").split("|")] == [
        "Walker-v0",
        "five",
        f"{np.mean(scores):.2f}",
        " ".join(f"{score:.2f}" for score in scores),
    ]
    experiment.plot([record], tmp_path / "none.png")  # its curve is of the bodies that it trains on
    assert not (tmp_path / "none.png").exists()


def test_other_networks_learn_one_body_each_for_as_long_as_fine_tuning_or_longer(tmp_path):
    fresh, _ = run(tiny("fresh"), tmp_path)
    assert set(fresh["scores"]) == {ALONE}
    assert run(tiny("fresh"), tmp_path, resume=True, should_stop=lambda: True)[0] == fresh  # nothing is done again
    experiment = tiny("specialists", "fresh", "stream")
    tuned, alone, long = (experiment.of_body(arm, 1) for arm in ("stream", "fresh", "specialists"))
    assert (tuned.total_steps, alone.total_steps, long.total_steps) == (600, 600, 900)
    assert (tuned.initial_std, tuned.learning_rate) == (0.5, alone.learning_rate)
    careful = tiny("stream", finetune_rate=2e-4, finetune_std=0.3).of_body("stream", 1)
    assert (careful.initial_std, careful.learning_rate) == (0.3, 2e-4)
    assert experiment.training("Walker-v0", "pool-32", 1).pool == 32
    assert experiment.training("Walker-v0", "context-attention", 1).ppo.context == "attention"


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"material": "soft"}, "material: got 'soft'"),
        ({"trained_on": 1}, "got 1 and 3"),
        ({"bodies": 65}, "got 2 and 65"),
        ({"finetune_steps": 0}, "finetune_steps: got 0"),
        ({"finetune_rate": 0.0}, "finetune_rate: got 0"),
        ({"finetune_std": float("nan")}, "finetune_std: got nan"),
        ({"ppo": replace(PPO, seed=3)}, r"ppo.seed: got 3"),
        ({"arms": ("streams",)}, "arms: got"),
    ],
)
def test_bad_settings(settings, text):
    arms = settings.pop("arms", ("stream",))
    with pytest.raises(ValueError, match=text):
        tiny(*arms, **settings)


def test_the_packages_policy_is_scored_and_tuned_where_there_is_one(tmp_path, sprint_baseline):
    with pytest.raises(ValueError, match=r"baseline: got 'Walker-v0' \(invariant\), the package has Sprint-v0"):
        tiny("baseline")
    for end in (".json", ".npz"):
        (baselines.FOLDER / f"Sprint-v0-invariant{end}").rename(baselines.FOLDER / f"Walker-v0-invariant{end}")
    record, _ = run(tiny("baseline"), tmp_path / "run")
    assert {kind: len(scores) for kind, scores in record["scores"].items()} == {UNSEEN: 3, TUNED: 2}


def test_table_and_figure(tmp_path):
    def record(arm, seed, **scores):
        told = {"task": "Walker-v0", "label": arm, "seed": seed, "finished": True, "env_steps": 1000, "seconds": 7.0}
        return told | {"scores": scores, "curve": [[0, 0.1], [1000, float(seed)]] if arm == "stream" else []}

    runs = [
        record("stream", seed, **{UNSEEN: [1.0, 2.0, 6.0], IDLE: [1.0, 1.0, 1.0], TUNED: [3.0, 3.0]}) for seed in (1, 2)
    ]
    runs.append(record("specialists", 1, **{ALONE: [4.0, 2.0]}))
    experiment = tiny("stream", "specialists", material="reactive", seeds=(1, 2))
    text = experiment.table(experiment.summarise(runs))
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if "Walker" in line]
    assert rows[0][:4] == ["Walker-v0", "stream", "2", "1,000"]
    assert rows[0][4].startswith("3.00 [")
    assert rows[0][5] == "3.00 3.00"
    assert rows[0][8] == "50%, 100%"
    assert rows[1][7].startswith("3.00 [")
    assert rows[2][2:4] == ["3.00", "1.00"]
    assert rows[2][4].startswith("+2.00 [")
    assert rows[2][5] == "2 of 3"
    assert experiment.table([]) == ""
    pytest.importorskip("matplotlib")
    experiment.plot(runs, tmp_path / "curves.png")
    experiment.plot([], tmp_path / "none.png")  # all runs failed
    assert (tmp_path / "curves.png").exists()
    assert not (tmp_path / "none.png").exists()
