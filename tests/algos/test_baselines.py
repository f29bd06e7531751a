"""Universal policies of the package: those that it has, how a run becomes one, and what begins with one."""

import json
import re
import runpy
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import evogymcm as cm
from benchmarks.experiments.paper import PAPER
from benchmarks.store_baseline import LARGEST, command_of, read_config, store
from evogymcm.__main__ import _parse
from evogymcm.algos import PPOConfig, RunFolder, RunRecord, TrainConfig, evaluate, load_policy, train
from evogymcm.algos.baselines import FOLDER, load_baseline
from evogymcm.algos.codesign import BodyPPOConfig, CodesignConfig, SpecialistConfig, codesign
from evogymcm.algos.learning.bodies import held_out_bodies
from evogymcm.algos.learning.training import make_trainer
from evogymcm.commands.train import _config
from evogymcm.envs import SoftRobotEnv

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = {(task, material) for task in PAPER for material in ("invariant", "reactive")}
BODY, OTHER = "HHH/V.V", "VHHH/S..R/V..V"
TINY = PPOConfig(64, 4, 8, epochs=1, minibatch=16, eval_interval=0)
KEYS = {
    "task",
    "material",
    "random_bodies",
    "pool",
    "stiffness",
    "edge_rule",
    "work_weight",
    "env_steps",
    "seconds",
    "seed",
}
KEYS |= {"policy", "score", "robust_score", "spread", "starts", "robust_scores", "command", "ppo", "form", "origin"}


def same(one, other):
    return one.keys() == other.keys() and all(
        torch.equal(value, other[name]) and value.dtype == other[name].dtype for name, value in one.items()
    )


def close(one, other):
    """Whether weights are the same but for steps of next to no length."""
    kept = one.keys() - {"log_std"} - {name for name in one if name.split(".")[-1] in ("count", "mean", "var")}
    return all(torch.allclose(one[name], other[name], atol=1e-6, rtol=0) for name in kept)


def test_the_package_has_the_baselines_that_it_should_and_no_other_files():
    assert set(cm.baselines()) == SHIPPED
    files = {f"{task}-{material}{suffix}" for task, material in SHIPPED for suffix in (".json", ".npz")}
    assert {path.name for path in FOLDER.glob("*")} == files


def test_the_page_shows_those_that_there_are():
    table = runpy.run_path(str(ROOT / "docs" / "baseline_table.py"))["table"]()
    page = (ROOT / "docs" / "baselines.md").read_text(encoding="utf-8")
    shown = re.search(r"<!-- baselines: .*? -->(.*?)<!-- end of baselines -->", page, re.DOTALL)
    assert shown[1].strip() == table.strip(), "run: python docs/baseline_table.py --write"


@pytest.mark.parametrize(("task", "material"), sorted(cm.baselines()))
def test_those_of_the_package_are_small_documented_and_act_on_any_body(task, material):
    record = cm.baselines()[task, material]
    assert record.keys() == KEYS
    assert (record["task"], record["material"], len(record["robust_scores"])) == (task, material, 64)
    assert record["robust_score"] == pytest.approx(np.mean(record["robust_scores"]), abs=1e-3)
    assert record["env_steps"] > 0 < record["seconds"]
    assert record["origin"]["machine"]["cpu"]
    assert record["origin"]["commit"]
    config = _config(_parse(shlex.split(record["command"])[1:]))
    assert (config.task, config.material, config.ppo) == (task, material, PPOConfig(**record["ppo"]))
    assert load_baseline(task, material).path.stat().st_size < LARGEST
    env = SoftRobotEnv(task, [BODY, OTHER], 2, material=material, num_threads=1)
    actor = cm.baseline(task, material)
    acted = actor(env.reset())
    assert set(acted["action"].keys()) == ({"actuation", "stiffness"} if material == "reactive" else {"actuation"})
    assert acted["action", "actuation"].isfinite().all()


@pytest.mark.slow
@pytest.mark.parametrize(("task", "material"), sorted(cm.baselines()))
def test_those_of_the_package_move_random_bodies_as_recorded(task, material):
    record, n = cm.baselines()[task, material], 16
    bodies = held_out_bodies(record["random_bodies"])[:n]
    score = evaluate(cm.baseline(task, material), SoftRobotEnv(task, bodies, n, material=material)).score
    expected = np.mean(record["robust_scores"][:n])
    assert abs(score.mean() - expected) < 0.25 * abs(expected)  # another processor, other bits, other gaits


def test_a_run_on_random_bodies_becomes_a_baseline_of_the_same_bits(sprint_baseline, sprint):
    final, saved = RunFolder.open(sprint_baseline).load("final"), load_baseline(sprint, "invariant")
    for part in ("actor", "critic"):
        assert same(final[part], saved.state[part])
    assert final["form"] == saved.state["form"]
    assert {path.name for path in saved.path.parent.iterdir()} == {
        f"{sprint}-invariant{end}" for end in (".json", ".npz")
    }
    actor, env = cm.baseline(sprint), SoftRobotEnv(sprint, [BODY, OTHER], 2, num_threads=1)
    theirs = load_policy(sprint_baseline).module(env)
    assert (evaluate(actor, env).score == evaluate(theirs, SoftRobotEnv(sprint, [BODY, OTHER], 2)).score).all()

    (found, record), *others = cm.baselines().items()
    assert (found, others) == ((sprint, "invariant"), [])
    assert record.keys() == KEYS
    bodies = held_out_bodies((3, 2))
    fields = [np.where(body.occupancy, 0.5, 1.0) for body in bodies]
    alone = evaluate(actor, SoftRobotEnv(sprint, bodies, 64, stiffness=fields))
    assert record["score"] == alone.score.mean()
    assert record["spread"] > 0
    assert record["robust_score"] != record["score"]
    assert (record["env_steps"], record["seed"], record["policy"], record["starts"]) == (64, 3, "final", 2)
    config = read_config(RunFolder.open(sprint_baseline).config)
    assert _config(_parse(shlex.split(record["command"])[1:])) == config
    other = replace(
        config, stiffness=None, material="reactive", work_weight=0, edge_rule="mean_stiffness", initial="a b"
    )
    other = replace(
        other, ppo=replace(TINY, schedule=(0.25, 0.5), decay_learning_rate=False, selection="robust", eval_starts=3)
    )
    assert _config(_parse(shlex.split(command_of(other))[1:])) == other


def test_a_baseline_that_is_not_there_names_those_that_are(sprint_baseline, sprint):
    for asked, told in (
        ((sprint, "reactive"), "Sprint-v0 \\(invariant\\)"),
        (("Walkr",), "got 'Walkr'"),
        ((3,), "got 3"),
    ):
        with pytest.raises(ValueError, match=f"baseline.*{told}"):
            cm.baseline(*asked)
    with pytest.raises(ValueError, match="material: got 'soft'"):
        cm.baseline(sprint, material="soft")
    train(TrainConfig(sprint, BODY, ppo=replace(TINY, hidden=8)), run="one", num_threads=1)
    before = {path: path.read_bytes() for path in Path("package").iterdir()}
    with pytest.raises(ValueError, match="no training on random bodies"):
        store(Path("one"), folder=Path("package"))
    with pytest.raises(ValueError, match=r"none of final\.pt"):
        store(Path("nowhere"), folder=Path("package"))
    assert before == {path: path.read_bytes() for path in Path("package").iterdir()}


def test_training_begins_with_a_baseline_a_path_or_afresh(sprint_baseline, sprint):
    ppo = replace(TINY, learning_rate=1e-12, initial_std=0.5, final_std=0.5)  # weights stay next to where they begin
    config = TrainConfig(sprint, [BODY, OTHER], ppo=ppo, initial="baseline")
    state = load_baseline(sprint, "invariant").state
    result = train(config, run="warm", num_threads=1)
    score = evaluate(cm.baseline(sprint), SoftRobotEnv(sprint, [BODY, OTHER], 2)).score.mean()
    assert result.rows[0]["score"] == score  # before the first update
    assert close(result.policy["actor"], state["actor"])
    assert close(result.policy["critic"], state["critic"])
    assert result.actor.log_std.exp().tolist() == pytest.approx([0.5])  # whatever it was
    assert (result.actor.form["hidden"], result.actor.form["context"]) == (8, "attention")
    assert RunRecord.read("warm").initial == "baseline"
    independent = train(replace(config, initial="auto", ppo=replace(ppo, sharing="independent")), num_threads=1)
    assert independent.rows[0]["score"] == pytest.approx(score, abs=1e-5)  # each begins with it
    for settings, told in (
        ({"initial": "auto"}, "baseline"),
        ({"initial": "auto", "ppo": replace(ppo, hidden=16)}, "fresh"),
        ({"initial": "auto", "material": "reactive"}, "fresh"),
        ({"initial": "fresh"}, "fresh"),
        ({"initial": str(sprint_baseline / "best.pt")}, str(sprint_baseline / "best.pt")),
        ({"initial": sprint_baseline}, str(sprint_baseline)),
    ):
        run = RunFolder("other", {}, overwrite=True) if Path("other").exists() else "other"
        result = train(replace(config, **settings), run=run, num_threads=1)
        record = RunRecord.read("other")
        assert record.initial == told
        assert RunRecord.from_dict(record.as_dict()).initial == told
        assert (result.rows[0]["score"] == score) == (told != "fresh" and "best" not in told)
    stream = TrainConfig(sprint, random_bodies=(2, 3), ppo=replace(TINY, eval_worlds=2))
    train(stream, run="stream", num_threads=1)
    assert RunRecord.read("stream").initial == "fresh"  # where it may become the next baseline
    train(replace(stream, initial="baseline"), run="on", num_threads=1)
    assert RunRecord.read("on").initial == "baseline"
    given = {"initial": load_policy("warm").state, "num_threads": 1}
    train(replace(config, initial="auto"), run="given", **given)
    train(replace(config, initial="fresh"), run="before", **given)  # as runs are stored whose default that was
    assert RunRecord.read("before").initial == "policy"
    assert RunRecord.read("given").initial == "policy"
    with pytest.raises(ValueError, match="initial: got a policy, and 'baseline' in the settings too"):
        train(config, **given)
    assert TrainConfig(sprint).initial == "auto" == CodesignConfig().initial == SpecialistConfig().initial


def test_what_cannot_begin_is_refused_before_any_work(sprint_baseline, sprint):
    config = TrainConfig(sprint, [BODY, OTHER], ppo=TINY, initial="baseline")
    train(replace(config, initial="fresh", ppo=replace(TINY, sharing="independent")), run="two", num_threads=1)
    shared = TrainConfig(sprint, [BODY] * 3, ppo=replace(TINY, sharing="independent", num_worlds=6))
    for wrong, told in (
        (replace(config, material="reactive"), "baseline: got 'Sprint-v0' \\(reactive\\)"),
        (replace(config, task="Walker-v0"), "baseline: got 'Walker-v0'"),
        (replace(config, ppo=replace(TINY, hidden=16)), "hidden: got 16, .* has 8"),
        (replace(config, ppo=replace(TINY, context="none")), "context: got 'none', .* has 'attention'"),
        (replace(config, bodies=BODY, ppo=replace(TINY, network="mlp")), "network: got 'mlp', .* has 'voxel'"),
        (replace(config, initial="nowhere"), "nowhere has none of final.pt"),
        (replace(config, initial="baseline:Lifter-v0"), "baseline: got 'Lifter-v0' \\(invariant\\)"),
        (replace(config, initial=f"baseline:{sprint}:soft"), "material: got 'soft'"),
        (replace(config, initial=f"baseline:{sprint}:reactive:x"), "baseline:.* has none of final.pt"),
        (replace(shared, initial="two"), "policies of 2 designs"),
    ):
        with pytest.raises(ValueError, match=told):
            train(wrong, run="new", num_threads=1)
    with pytest.raises(ValueError, match=r"initial: got a policy, and 'baseline'"):
        train(config, run="new", initial=load_policy(sprint_baseline).state)
    for wrong in (3, None, ""):
        with pytest.raises(ValueError, match="initial: got"):
            TrainConfig(sprint, BODY, initial=wrong)
    assert not Path("new").exists()
    with make_trainer(replace(config, initial="fresh", material="reactive"), 1) as trainer:
        state = train(replace(config, bodies=BODY, initial="fresh", ppo=replace(TINY, network="mlp"))).policy
        with pytest.raises(ValueError, match="initial: the policy does not set stiffness"):
            trainer.start_from(state)


def test_training_begins_with_what_was_learned_in_another_task_or_setting(sprint_baseline, sprint):
    """At first it acts as there: without the features that are new, and with stiffness 1."""
    ppo = replace(TINY, learning_rate=1e-12, initial_std=0.5, final_std=0.5)
    there = evaluate(cm.baseline(sprint), SoftRobotEnv(sprint, [BODY, OTHER], 2)).score.mean()
    wider = replace(
        TrainConfig(sprint, [BODY, OTHER], ppo=ppo), material="reactive", initial=f"baseline:{sprint}:invariant"
    )
    result = train(wider, run="wider", num_threads=1)
    assert result.rows[0]["score"] == pytest.approx(there, abs=1e-6)
    assert result.actor.log_std.exp().tolist() == pytest.approx([0.5, 0.5])
    assert RunRecord.read("wider").initial == wider.initial
    narrower = replace(wider, material="invariant", initial="wider")
    begun = train(narrower, num_threads=1).rows[0]["score"]
    assert begun == pytest.approx(result.rows[-1]["score"], abs=1e-6)
    ppo = replace(ppo, sharing="independent")
    hill = replace(narrower, task="UpStepper-v0", initial=f"baseline:{sprint}", ppo=ppo)  # whose terrain is sensed
    with make_trainer(hill, 1) as trainer:
        state, known = load_baseline(sprint, "invariant").state, trainer.actor.state_dict()
        assert trainer.actor.form["task_features"] > 4
        for i in range(2):
            assert torch.equal(known["task.weight"][i, :, :4], state["actor"]["task.weight"])
            assert not known["task.weight"][i, :, 4:].any()
        trainer.update()
        assert trainer.actor.state_dict()["task.count"].tolist() == [[4], [4]]  # begun anew


def test_runs_of_before_go_on_as_fresh_ones(sprint):
    config = TrainConfig(sprint, BODY, ppo=replace(TINY, hidden=8), initial="fresh")
    whole = train(config, run="run", num_threads=1)
    path = Path("run/config.json")
    settings = json.loads(path.read_text())
    del settings["initial"]
    path.write_text(json.dumps(settings))
    Path("run/final.pt").unlink()
    assert train(config, run="run", num_threads=1).rows == whole.rows
    with pytest.raises(ValueError, match="initial: got auto, the run has fresh"):
        train(replace(config, initial="auto"), run="run", num_threads=1)


def test_designs_begin_with_a_baseline_and_children_with_their_parents(sprint_baseline, sprint):
    ppo = BodyPPOConfig(32, 4, 8, epochs=1, minibatch=8, learning_rate=1e-12, initial_std=0.5, final_std=0.5)
    ppo = replace(ppo, eval_interval=0)
    config = CodesignConfig(sprint, material="invariant", shape=(2, 3), population=3, budget=5, ppo=ppo, seed=1)
    config = replace(config, initial="baseline", stiffness=0.5)
    state = load_baseline(sprint, "invariant").state
    for inherits in (False, True):
        run = RunFolder(f"evolved-{inherits}", {})
        result = codesign(replace(config, inherit=inherits, inherit_std=0.25 if inherits else None), run=run)
        assert result.finished
        assert len(result.rows) == 5
        for row in result.rows:
            policy = run.load(f"policy-{row['index']:04}")
            assert close(policy["actor"], state["actor"])
            std = 0.25 if inherits and row["parent"] is not None else 0.5
            assert policy["actor"]["log_std"].exp().tolist() == pytest.approx([std])
        assert RunRecord.read(run.path).initial == "baseline"
    for changes, told in (
        ({"material": "reactive", "stiffness": 1.0}, "baseline: got"),
        ({"ppo": replace(ppo, hidden=16)}, "hidden: got 16"),
        ({"initial": f"baseline:{sprint}:reactive"}, "baseline: got"),
    ):
        with pytest.raises(ValueError, match=told):
            codesign(replace(config, **changes), run="refused")
    assert not Path("refused").exists()
    fresh = replace(config, budget=3, initial="auto", material="reactive", stiffness=1.0, ppo=replace(ppo, hidden=4))
    assert codesign(fresh, run="fresh").policy["form"]["hidden"] == 4
    assert RunRecord.read("fresh").initial == "fresh"
    other = replace(config, task="Lifter-v0", material="reactive", stiffness=1.0, initial=str(sprint_baseline))
    lifting = codesign(replace(other, budget=3, shape=(2, 2))).policy
    assert torch.allclose(lifting["actor"]["encode.weight"], state["actor"]["encode.weight"], atol=1e-6)
    shared = codesign(replace(config, budget=3, ppo=replace(ppo, sharing="shared")))
    assert close(shared.policy["actor"], state["actor"])
