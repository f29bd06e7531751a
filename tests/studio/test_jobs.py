"""Work in processes of their own: it goes on, stops, is found again, dies and is resumed, and loses nothing."""

import json
import os
import signal
import time
from dataclasses import asdict, replace

import numpy as np
import pytest

from evogymcm.algos import PPOConfig, RunFolder, TrainConfig, load_policy, train
from evogymcm.algos.codesign import BodyPPOConfig, CodesignConfig, SearchConfig, codesign
from evogymcm.sim.world import World
from evogymcm.studio.evolving import SMALL, Evolution
from evogymcm.studio.improving import MaterialImprovement
from evogymcm.studio.learning import Learning
from evogymcm.studio.notes import Note
from evogymcm.studio.player import Player

BODY = "HHH/V.V"
FIELD = np.linspace(0.5, 2, 6).reshape(2, 3)
TINY = {"num_worlds": 2, "rollout_steps": 16, "minibatch": 16, "epochs": 1, "hidden": 4}
PPO = PPOConfig(total_steps=256, eval_interval=64, **TINY)
SEARCH = SearchConfig(rounds=6, candidates=4, acceptance="paper", probability=0.5, sigma=0.4)
VALLEY = "F....................F\nFFFFFFFFFFFFFFFFFFFFFF"


def wait_for(condition, seconds=300):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def work_here(job, stop_after=None):
    """Does a job's work in this process, where tests have tasks of their own; stops when asked for the nth time."""
    run = RunFolder(job.folder, asdict(job.config), resume=True)
    if not (job.folder / "job.json").exists():
        job._prepare(run)
    asked = []

    def should_stop():
        asked.append(0)
        return len(asked) == stop_after

    return job.work(run, should_stop, lambda told: None)


def table(job):
    return [{key: value for key, value in row.items() if key != "seconds"} for row in job.files.rows()]


def test_learning_is_a_training_run_that_stops_and_goes_on(sprint):
    learning = Learning("run", BODY, FIELD, sprint, ppo=PPO)
    assert learning.status()["state"] == "new"
    assert learning.status()["curve"] == []
    assert learning.policy is None
    assert not work_here(learning, stop_after=4)
    found = Learning.open("run")
    status = found.status()
    assert (status["state"], status["error"], status["env_steps"], status["total"]) == ("stopped", None, 96, 256)
    newest = load_policy(found.policy)  # newer than the best, and not the last
    assert found.policy.name == "checkpoint.pt"
    player = Player(BODY, FIELD, sprint, policy=newest)
    player.step(3)
    assert work_here(found)
    done = found.status()
    assert (done["state"], done["env_steps"], found.policy.name) == ("finished", 256, "final.pt")
    assert done["curve"][: len(status["curve"])] == status["curve"]
    alone = Learning("alone", BODY, FIELD, sprint, ppo=PPO)
    train(TrainConfig(sprint, BODY, stiffness=(FIELD,), ppo=PPO), run="alone")  # from elsewhere, as the command does
    assert alone.status()["state"] == "finished"
    assert table(alone) == table(found)


def test_learning_may_begin_with_the_policy_of_another_body(sprint):
    first = Learning("first", BODY, FIELD, sprint, ppo=replace(PPO, total_steps=64, hidden=6))
    work_here(first)
    given = load_policy("first").state["actor"]["heads.weight"]
    second = Learning("second", "HHHH/V..V", None, sprint, ppo=PPO, initial="first")
    assert second.config.ppo.hidden == 6
    assert not work_here(second, stop_after=1)  # before an update
    now = load_policy(second.policy).state["actor"]["heads.weight"]
    assert now.tolist() == given.tolist()
    assert work_here(Learning.open("second"))
    for initial, options in (("sine", {}), ("first", {"material": "reactive"}), ("first", {"task": "Carrier-v0"})):
        with pytest.raises(ValueError, match=r"initial|material|task features"):
            Learning("third", BODY, **({"task": sprint} | options), initial=initial).start()


@pytest.mark.parametrize("policy", ["sine", "run"])
def test_improvement_never_loses_score_and_goes_on_where_it_was(sprint, policy):
    if policy == "run":
        work_here(Learning("run", BODY, FIELD, sprint, ppo=replace(PPO, total_steps=64)))
    whole, parts = (MaterialImprovement(name, BODY, FIELD, sprint, policy, SEARCH) for name in ("whole", "parts"))
    assert work_here(whole)
    assert not work_here(parts, stop_after=3)
    found = MaterialImprovement.open("parts")
    assert (found.status()["state"], found.status()["round"], found.status()["total"]) == ("stopped", 2, 6)
    assert work_here(found)
    assert found.status() == whole.status()
    status = found.status()
    scores = [score for _, score in status["curve"]]
    assert scores == sorted(scores)
    assert status["gain"] == scores[-1] - scores[0] > 0
    player = Player(BODY, status["stiffness"], sprint, policy=policy)
    while not player.has_ended:
        player.step()
    assert player.frame()["score"] == pytest.approx(status["score"], rel=1e-9)


def test_evolution_shows_its_family_tree(sprint):
    ppo = BodyPPOConfig(total_steps=32, eval_interval=0, **TINY)
    config = replace(SMALL, task=sprint, shape=(2, 3), population=3, budget=6, ppo=ppo, num_threads=1)
    evolution = Evolution("family", config)
    assert evolution.tree() == {"nodes": [], "edges": []}
    assert not work_here(evolution, stop_after=4)
    stopped = evolution.tree()["nodes"]
    assert 0 < len(stopped) < 6
    found = Evolution.open("family")
    assert found.config == config
    assert work_here(found)
    tree, status = found.tree(), found.status()
    assert (status["state"], status["n_designs"], status["budget"]) == ("finished", 6, 6)
    nodes = {node["index"]: node for node in tree["nodes"]}
    assert list(nodes) == list(range(6))
    assert {node["index"]: node["parent"] for node in tree["nodes"] if node["parent"] is not None} == {
        child: parent for parent, child in tree["edges"]
    }
    assert len(tree["edges"]) >= 1
    best = max(tree["nodes"], key=lambda node: node["score"])
    assert (best["is_best"], best["is_line"]) == (True, True)
    assert status["curve"][-1][1] == best["score"]
    player = Player(best["body"], best["stiffness"], sprint, policy=best["policy"])
    while not player.has_ended:
        player.step()
    assert player.frame()["score"] == best["score"]
    json.dumps(tree)


def test_a_job_that_cannot_be_done_says_so_before_there_is_a_folder(tmp_path):
    folder = tmp_path / "run"
    for make, match in (
        (lambda: Learning(folder, "H.H"), "one piece"),
        (lambda: Learning(folder, BODY, FIELD * 3), "stiffness"),
        (lambda: Learning(folder, BODY, FIELD, material="reactive"), "stiffness"),
        (lambda: Learning(folder, BODY, task="Walker-v9"), "task"),
        (lambda: Learning(folder, np.full((9, 9), 3), task="Climber-v0"), "fit"),
        (lambda: Learning(folder, BODY, task=tmp_path / "none.txt"), "no such file"),
        (lambda: Learning.open(folder), "holds no run"),
        (lambda: MaterialImprovement(folder, BODY, policy="random"), "policy"),
        (lambda: MaterialImprovement(folder, BODY, policy=tmp_path), "policy"),
        (lambda: MaterialImprovement(folder, BODY, FIELD[:1]), "stiffness"),
        (lambda: Evolution(folder, CodesignConfig("Walker-v9")), "task"),
        (lambda: Learning(folder, BODY).resume(), "no run to go on with"),
    ):
        with pytest.raises(ValueError, match=match):
            make().start()
    assert not folder.exists()
    codesign(CodesignConfig(budget=2, population=2), run=folder, should_stop=lambda: True)
    with pytest.raises(ValueError, match="no train run"):
        Learning.open(folder)
    with pytest.raises(FileExistsError):
        Learning(folder, BODY).start()


def test_a_run_keeps_its_own_copy_of_a_world(tmp_path):
    (tmp_path / "valley.txt").write_text(VALLEY)
    worlds = [tmp_path / "valley.txt", World.from_picture(VALLEY)]
    for number, world in enumerate(worlds):
        learning = Learning(tmp_path / f"run{number}", BODY, task=world, ppo=PPO)
        learning.check()
        learning._prepare(RunFolder(learning.folder, asdict(learning.config)))
        (tmp_path / "valley.txt").write_text("F")  # drawn anew meanwhile
        copy = World.load(Learning.open(learning.folder).config.task)
        assert copy["ground"].grid.shape == (2, 22)


def test_a_note_keeps_its_room(tmp_path):
    note = Note(tmp_path)
    assert note.read() == {}
    note.write({"state": "failed", "error": "ä" * 10_000})
    size = (tmp_path / "job.json").stat().st_size
    assert note.read()["state"] == "failed"
    assert note.read()["error"].startswith("ää")
    note.write({"state": "running"})
    assert note.read() == {"state": "running"}
    assert (tmp_path / "job.json").stat().st_size == size == 4096
    (tmp_path / "job.json").write_text("{")
    assert note.read() == {}


@pytest.mark.slow
def test_a_process_is_found_again_stops_is_killed_and_loses_nothing(tmp_path):
    def make(name):
        return MaterialImprovement(tmp_path / name, BODY, search=replace(SEARCH, rounds=12))

    job = make("run")
    job.start()
    assert job.status()["state"] == "running"
    wait_for(lambda: job.status()["round"] >= 1)
    found = MaterialImprovement.open(job.folder)  # as after a restart
    assert found.status()["state"] == "running"
    found.resume()  # it runs already
    assert found._process is None
    assert found.stop(60)
    status = found.status()
    assert (status["state"], status["error"]) == ("stopped", None)
    assert 1 <= status["round"] < 12
    assert job.status() == status
    found.resume()
    wait_for(lambda: found.status()["round"] > status["round"])
    os.kill(found._process.pid, signal.SIGKILL)
    wait_for(lambda: not found.is_running)
    assert found.status()["state"] == "killed"
    assert "killed" in MaterialImprovement.open(job.folder).status()["error"]
    full = found.folder / ".search.json.part"
    full.unlink(missing_ok=True)  # what it was writing when it died
    full.symlink_to("/dev/full")  # as on a full disk
    found.resume()
    wait_for(lambda: not found.is_running)
    failed = found.status()
    assert failed["state"] == "failed"
    assert "No space left" in failed["error"]
    assert failed["round"] >= status["round"]
    full.unlink(missing_ok=True)
    found.resume()
    wait_for(lambda: not found.is_running)
    whole = make("whole")
    work_here(whole)
    assert found.status() == whole.status()
    assert found.status()["state"] == "finished"
    found.resume()  # there is nothing left to do
    assert not found.is_running


@pytest.mark.slow
def test_a_training_in_a_process_stops_at_once_and_goes_on(tmp_path):
    learning = Learning(tmp_path / "run", BODY, FIELD, ppo=replace(PPO, total_steps=128, eval_interval=0))
    learning.start()
    assert learning.stop(300)  # before its first update
    assert learning.status()["state"] == "stopped"
    learning.resume()
    wait_for(lambda: not learning.is_running)
    assert (learning.status()["state"], learning.status()["env_steps"]) == ("finished", 128)
