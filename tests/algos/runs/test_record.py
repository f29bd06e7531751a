"""Runs of earlier versions (`tests/data/runs`, see its README) and of this one: one record, one loader of policies."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from evogymcm.algos import PPOConfig, RunFolder, RunRecord, TrainConfig, evaluate, load_policy, train
from evogymcm.body import Body

OLD = Path(__file__).resolve().parents[2] / "data" / "runs"
TINY = PPOConfig(total_steps=64, num_worlds=4, rollout_steps=8, epochs=1, minibatch=16, hidden=8, eval_interval=32)


def test_training_of_earlier_versions_is_read():
    command, fields, library, suite, variant = (
        RunRecord.read(OLD / name)
        for name in ("train-command", "train-fields", "train-library", "suite", "contexts/message")
    )
    assert {run.kind for run in (command, fields, library, suite, variant)} == {"train"}
    assert (command.task, command.label, command.bodies) == ("Walker-v0", "reactive", ("HHH/V.V",))
    assert (command.seed, command.finished, command.env_steps, command.edge_rule) == (0, True, 64, "mean_factor")
    assert command.final["score"] == command.curve[-1][1] == command.rows[-1]["score"]
    assert (fields.material, fields.bodies) == ("invariant", ("HHH/V.V", "VHH/S.R"))
    assert fields.stiffness == [[[2, 2, 2], [2, 1, 2]], [[0.5, 0.5, 0.5], [1, 1, 1.5]]]
    assert (library.task, library.material, library.seed, library.finished) == ("not recorded", None, 0, False)
    assert (suite.label, suite.material, suite.body) == ("co-optimisation", "reactive", "Walk_Bot")
    assert (variant.label, variant.material, variant.untrained) == ("message", "reactive", variant.curve[0][1])


def test_co_design_of_earlier_versions_is_read():
    prescribed, invariant = (RunRecord.read(OLD / f"codesign-{arm}") for arm in ("prescribed", "invariant"))
    assert (prescribed.kind, prescribed.label, prescribed.stiffness) == ("codesign", "prescribed", 1.5)
    assert (invariant.label, invariant.stiffness, invariant.material) == ("invariant", None, "invariant")
    assert (prescribed.n_designs, prescribed.finished, sorted(prescribed.designs)) == (3, True, [0, 1, 2])
    body, stiffness = prescribed.design(prescribed.ranked()[0])
    assert (body, stiffness.tolist()) == (Body("S../HR."), [[1.5, 1, 1], [1.5, 1.5, 1]])
    alone = RunRecord.from_dict(json.loads((OLD / "codesign-prescribed" / "result.json").read_text()))
    assert (alone.kind, alone.n_designs, alone.curve) == ("codesign", 3, prescribed.curve)
    assert alone.ranked()[0]["body"] == "S../HR."


@pytest.mark.parametrize(
    ("name", "stiffness"),
    [
        ("train-command", None),
        ("train-fields", [[[2, 2, 2], [2, 1, 2]], [[0.5, 0.5, 0.5], [1, 1, 1.5]]]),
        ("codesign-prescribed", [[[1.5, 1, 1], [1.5, 1.5, 1]]]),
        ("codesign-prescribed/policy-0000.pt", [[[1.5, 1.5, 1.5], [1.5, 1.5, 1]]]),
        ("codesign-invariant/policy-0000.pt", [[[1, 1, 1], [1, 1, 1]]]),
    ],
)
def test_policies_of_earlier_versions_score_what_their_runs_say(name, stiffness):
    policy = load_policy(OLD / name)
    fields = policy.stiffness
    assert stiffness == (None if fields is None else [field.tolist() for field in fields])
    env = policy.make_env(num_threads=1)
    score = evaluate(policy.module(env), env).score
    run = RunRecord.read(OLD / name if (OLD / name).is_dir() else (OLD / name).parent)
    if run.kind == "train":
        expected = policy.state["score"].numpy()
    else:
        number = 0 if policy.path.name.startswith("policy") else run.best["index"]
        expected = [run.designs[number]["fitness"]]
    assert score == pytest.approx(expected, abs=1e-12)


def test_reading_leaves_a_folder_as_it_is(tmp_path):
    for name in ("config.json", "curve.jsonl", "result.json"):
        (tmp_path / name).write_bytes((OLD / "train-command" / name).read_bytes())
    before = {path: path.stat().st_mtime_ns for path in (tmp_path, *tmp_path.iterdir())}
    for path in (tmp_path, *tmp_path.iterdir()):
        path.chmod(0o555 if path.is_dir() else 0o444)
    run = RunFolder.open(tmp_path)
    assert (run.config["task"], len(run.rows()), run.load("best")) == ("Walker-v0", 3, None)
    assert RunRecord.read(tmp_path).finished
    tmp_path.chmod(0o755)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path, *tmp_path.iterdir())} == before
    with pytest.raises(ValueError, match="holds no run"):
        RunFolder.open(tmp_path / "nowhere")


def test_a_run_of_settings_alone_is_recorded_and_its_policy_loaded(sprint, tmp_path):
    field = [[2, 1.5, 1], [0.5, 9, 1]]  # the empty cell does not count
    config = TrainConfig(sprint, [Body("HHH/V.V")], stiffness=[field], edge_rule="mean_stiffness", ppo=TINY)
    result = train(config, run=tmp_path / "run", num_threads=1)
    run = RunRecord.read(tmp_path / "run")
    assert (run.kind, run.task, run.label, run.bodies) == ("train", sprint, "invariant", ("HHH/V.V",))
    assert (run.finished, run.env_steps, run.edge_rule, run.seed) == (True, 64, "mean_stiffness", 0)
    assert run.final["score"] == result.final.score[0]
    assert run.origin["versions"]["torch"]
    assert run.config == json.loads(json.dumps(asdict(config)))
    assert RunRecord.from_dict(json.loads(json.dumps(run.as_dict()))).curve == run.curve
    policy = load_policy(tmp_path / "run")
    assert (policy.task, policy.edge_rule, policy.stiffness[0][1, 1]) == (sprint, "mean_stiffness", 1)
    env = policy.make_env(num_threads=1)
    assert evaluate(policy.module(env), env).score[0] == result.final.score[0]
    assert train(config, run=tmp_path / "run", num_threads=1).final.score[0] == result.final.score[0]  # gone on with
    for other, message in (
        (replace(config, stiffness=None), "stiffness: got None"),
        (replace(config, ppo=replace(TINY, clip=0.1)), "ppo: got"),
    ):
        folder = RunFolder(tmp_path / "run", asdict(config), resume=True)
        with pytest.raises(ValueError, match=message):
            train(other, run=folder, num_threads=1)


def test_a_killed_run_says_what_it_was(sprint, tmp_path):
    def crash(progress):
        raise RuntimeError("power cut")

    run = RunFolder(tmp_path / "run", {"arm": "control-only"})  # settings of an experiment
    with pytest.raises(RuntimeError, match="power cut"):
        train(TrainConfig(sprint, ppo=TINY, stiffness=0.5), run=run, progress=crash, num_threads=1)
    record = RunRecord.read(tmp_path / "run")
    assert (record.label, record.finished, record.final, record.stiffness) == ("control-only", False, None, 0.5)
    assert record.origin["versions"]["torch"]
    assert load_policy(tmp_path / "run").stiffness[0].min() == 0.5


def test_settings_of_training_are_checked():
    for wrong, message in (
        ({"task": 3}, "task: got 3"),
        ({"bodies": "Wolk_Bot"}, "Walk_Bot"),
        ({"bodies": [Body("HH/VV", [[0, 0, 1], [1, 2, 3]])]}, "connections of its own"),
        ({"material": "steel"}, "invariant, reactive"),
        ({"material": "reactive", "stiffness": 1}, "the policy sets it"),
        ({"stiffness": 3}, "at most 2"),
        ({"stiffness": "2"}, "stiffness: got '2', expected a number"),
        ({"stiffness": [1.0, 2.0]}, "expected a number, or rows of numbers for each body"),
        ({"edge_rule": "mean"}, "mean_factor"),
        ({"ppo": None}, "expected a PPOConfig"),
    ):
        with pytest.raises(ValueError, match=message):
            TrainConfig(**{"task": "Walker-v0"} | wrong)
    for bodies in ("HHH/V.V", [Body("HHH/V.V")], np.array([[3, 3, 3], [4, 0, 4]]), [[3, 3, 3], [4, 0, 4]]):
        assert TrainConfig("Walker-v0", bodies).bodies == ("HHH/V.V",)
    assert TrainConfig("Walker-v0", ["HHH", Path("robot.npz"), "Walk_Bot"]).bodies == ("HHH", "robot.npz", "Walk_Bot")
    assert TrainConfig("BridgeWalker-v0").resolved().bodies == ("Bridge_Bot",)
    assert TrainConfig("Walker-v0", stiffness=np.float32(0.5)).stiffness == 0.5
    with pytest.raises(ValueError, match="got 2 fields, expected one for each of 1"):
        TrainConfig("Walker-v0", "HHH/V.V", stiffness=[[[1, 1, 1], [1, 1, 1]]] * 2).designs()
    with pytest.raises(ValueError, match="expected a TrainConfig"):
        train(TINY)
