"""`evogymcm train` and `watch` from end to end, on tiny budgets."""

import json
import re
import shlex
import signal
from pathlib import Path

import numpy as np
import pytest
import torch

from evogymcm import Body, as_body
from evogymcm.__main__ import main
from evogymcm.algos import RunFolder, evaluate, load_actor
from evogymcm.algos.learning.threads import exploration
from evogymcm.commands import _options
from evogymcm.commands._options import read_stiffness, write_stiffness
from evogymcm.envs import SoftRobotEnv
from evogymcm.sim.world import World, WorldObject
from tests.commands.tools import refused

BODY, OTHER = "HHH/V.V", "VHH/S.R"
TINY = ["--total-steps", "64", "--num-worlds", "4", "--rollout-steps", "8", "--hidden", "8", "--eval-interval", "32"]


def number(text, name):
    """The number that follows a word at the start of a line."""
    return float(re.search(rf"^{name} +(\S+?)[: ]", text + " ", re.MULTILINE)[1])


def test_a_run_from_end_to_end(sprint, capsys, tmp_path):
    assert main(["train", sprint, "--body", BODY, *TINY]) == 0
    out, err = capsys.readouterr()
    run = tmp_path / "runs" / "Sprint-v0-invariant-seed0"
    config = json.loads((run / "config.json").read_text())
    assert (config["task"], config["bodies"], config["material"]) == (sprint, [BODY], "invariant")
    assert config["ppo"]["total_steps"] == 64

    env = SoftRobotEnv(sprint, BODY, 1, num_threads=1)
    alone = evaluate(load_actor(RunFolder.open(run).load("final")), env)
    assert number(out, "score") == pytest.approx(alone.score[0], abs=6e-4)
    assert f"of at most {alone.ceiling[0]:.2f}" in out
    rows = [json.loads(line) for line in (run / "curve.jsonl").read_text().splitlines()]
    scores = [row["score"] for row in rows if "score" in row]
    assert len(scores) == 3
    assert number(out, "best") == pytest.approx(max(scores), abs=6e-4)
    assert "the largest score of 3 evaluations" in out
    result = json.loads((run / "result.json").read_text())
    assert result["final"]["score"] == alone.score[0] == scores[-1]
    assert "64.0/64.0" in err
    assert "env-steps/s" in err
    assert "evogymcm watch --policy runs/Sprint-v0-invariant-seed0" in out
    assert "evogymcm report runs/Sprint-v0-invariant-seed0" in out


def test_random_bodies_of_one_stiffness_learn_and_others_are_scored(sprint, capsys, tmp_path):
    command = ["train", sprint, "--random-bodies", "3", "2", "--material", "invariant", "--eval-worlds", "3", *TINY]
    assert "stiffness" in refused(capsys, *command, "--stiffness", "1,1/1,1/1,1")
    assert main([*command, "--stiffness", "0.5", "--run", "random"]) == 0
    out = capsys.readouterr().out
    config = json.loads((tmp_path / "random" / "config.json").read_text())
    assert (config["bodies"], config["random_bodies"], config["stiffness"]) == ([], [3, 2], 0.5)
    result = json.loads((tmp_path / "random" / "result.json").read_text())
    assert number(out, "score") == pytest.approx(result["final"]["score"], abs=6e-4)


def test_the_robust_score_is_told_where_there_are_several_starts(sprint, capsys):
    assert main(["train", sprint, "--body", BODY, *TINY, "--eval-starts", "2", "--selection", "robust"]) == 0
    final = json.loads(Path("runs/Sprint-v0-invariant-seed0/result.json").read_text())["final"]
    out = capsys.readouterr().out
    assert number(out, "robust") == pytest.approx(final["robust_score"], abs=6e-4)
    assert f"± {final['spread']:.3f}: the score from 2 starts" in out
    assert final["spread"] > 0
    assert "needs eval_starts" in refused(capsys, "train", sprint, "--body", BODY, *TINY, "--selection", "robust")


def test_an_existing_run_is_refused_resumed_or_replaced(sprint, capsys, tmp_path):
    command = ["train", sprint, "--body", BODY, *TINY, "--run", "first"]
    assert main(command) == 0
    first = capsys.readouterr().out
    assert "--resume" in refused(capsys, *command)
    assert main([*command, "--resume"]) == 0  # it is finished: the same numbers again
    assert number(capsys.readouterr().out, "score") == number(first, "score")
    assert "seed" in refused(capsys, *command, "--resume", "--seed", "1")
    assert "only one" in refused(capsys, *command, "--resume", "--overwrite")
    (tmp_path / "first" / "note").touch()
    assert main([*command, "--overwrite"]) == 0
    assert not (tmp_path / "first" / "note").exists()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "note").touch()
    assert "not a run folder" in refused(capsys, *command[:-1], "other", "--overwrite")
    with RunFolder("first", json.loads(Path("first/config.json").read_text()), resume=True).lock():
        for flag in ("--resume", "--overwrite"):
            assert "first is in use" in refused(capsys, *command, flag)


def test_a_stopped_run_goes_on_to_the_same_policy(sprint, capsys, monkeypatch):
    command = ["train", sprint, "--body", BODY, *TINY]
    assert main([*command, "--run", "whole"]) == 0
    capsys.readouterr()

    def interrupt(bar, done, numbers):
        signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(_options.Bar, "show", interrupt)
        assert main([*command, "--run", "parts", "--overwrite"]) == 130
    out = capsys.readouterr().out
    again = out.splitlines()[-1].strip()
    assert again == f"evogymcm {shlex.join(command)} --run parts --resume"
    assert main(shlex.split(again)[1:]) == 0
    whole, parts = (torch.load(f"{name}/final.pt", weights_only=True) for name in ("whole", "parts"))
    assert whole["actor"].keys() == parts["actor"].keys()
    assert all(torch.equal(whole["actor"][key], parts["actor"][key]) for key in whole["actor"])


def test_nothing_is_touched_where_an_argument_is_bad(sprint, capsys, tmp_path):
    command = ["train", sprint, "--body", BODY, *TINY]
    for wrong, message in [
        (["train", "Walkr-v0"], "known are Walker-v0, "),
        ([*command, "--clip", "-1"], "clip"),
        ([*command, "--material", "reactive", "--stiffness", "1"], "reactive"),
        ([*command, "--body", "Wolk_Bot"], "Walk_Bot"),
        ([*command, "--body", BODY, OTHER, "--sharing", "independent", "--num-worlds", "3"], "multiple of 2"),
        ([*command, "--body", BODY, OTHER, "--network", "mlp"], "mlp"),
    ]:
        assert message in refused(capsys, *wrong)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_logger_is_named(sprint, capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(_options.sys.modules, "wandb", None)
    message = refused(capsys, "train", sprint, "--body", BODY, *TINY, "--logger", "wandb")
    assert "pip install evogymcm[wandb]" in message
    assert list(tmp_path.iterdir()) == []


def test_csv_logger_writes_into_the_run(sprint, tmp_path):
    main(["train", sprint, "--body", BODY, *TINY, "--run", "run", "--logger", "csv"])
    lines = (tmp_path / "run" / "csv" / "scalars" / "score.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines] == ["0", "32", "64"]


def test_tensorboard_logger_writes_into_the_run(sprint, tmp_path):
    pytest.importorskip("tensorboard")
    main(["train", sprint, "--body", BODY, *TINY, "--run", "run", "--logger", "tensorboard"])
    assert list((tmp_path / "run" / "tensorboard").glob("events*"))


@pytest.mark.slow
def test_wandb_logger_writes_into_the_run_without_a_network(sprint, tmp_path, monkeypatch):
    wandb = pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    main(["train", sprint, "--body", BODY, *TINY, "--run", "run", "--logger", "wandb"])
    assert wandb.run.name == "run"
    assert wandb.run.summary["env_steps"] == 64
    assert "score" in wandb.run.summary.keys()
    wandb.finish()
    assert list((tmp_path / "run" / "wandb").glob("offline-run-*/run-*.wandb"))


@pytest.mark.parametrize("sharing", ["shared", "independent"])
def test_several_bodies_with_fields_of_their_own(sprint, sharing, capsys):
    fields = ["2", "0.5,0.5,0.5/1,1,1.5"]
    command = ["train", sprint, "--body", BODY, OTHER, "--stiffness", *fields, *TINY]
    assert main([*command, "--sharing", sharing, "--run", "run"]) == 0
    out = capsys.readouterr().out
    shown = [float(text) for text in re.findall(r"^score +(\S+)", out, re.MULTILINE)]
    with open("run/config.json", encoding="utf-8") as file:
        config = json.load(file)
    assert config["stiffness"] == [[[2, 2, 2], [2, 1, 2]], [[0.5, 0.5, 0.5], [1, 1, 1.5]]]
    pytest.importorskip("matplotlib")
    size = ["--width", "64", "--height", "32", "--out", "run.png"]
    assert main(["watch", sprint, "--policy", "run", *size]) == 0  # bodies, fields and policies are the run's
    watched = [float(text) for text in re.findall(r"score (\S+)", capsys.readouterr().out)]
    assert watched == shown
    assert main(["watch", sprint, "--policy", "run", "--stiffness", "1", *size]) == 0
    assert [float(text) for text in re.findall(r"score (\S+)", capsys.readouterr().out)] != shown
    assert main(["watch", "--policy", "run/final.pt", *size]) == 0
    assert [float(text) for text in re.findall(r"score (\S+)", capsys.readouterr().out)] == shown
    if sharing == "independent":
        assert "one for each of 2 bodies" in refused(capsys, "watch", sprint, "--policy", "run", "--body", BODY, *size)


@pytest.mark.parametrize("options", [["--network", "mlp"], ["--context", "message"]])
def test_watch_plays_other_networks(sprint, options, capsys):
    pytest.importorskip("matplotlib")
    main(["train", sprint, "--body", BODY, *TINY, *options, "--run", "run"])
    score = number(capsys.readouterr().out, "score")
    size = ["--width", "64", "--height", "32", "--out", "run.png"]
    with exploration(True):  # of whoever calls
        assert main(["watch", sprint, "--policy", "run", *size]) == 0
    assert f"score {score:.3f}" in capsys.readouterr().out
    larger = ["watch", sprint, "--policy", "run", "--body", "HHHH/V..V/V..V", *size]
    if "mlp" in options:
        assert "flat observation" in refused(capsys, *larger)
    else:
        assert main(larger) == 0


def test_watch_refuses_what_cannot_be_played(sprint, capsys):
    pytest.importorskip("matplotlib")
    main(["train", sprint, "--body", BODY, *TINY, "--run", "run"])
    capsys.readouterr()
    assert "task features" in refused(capsys, "watch", "Lifter-v0", "--policy", "run", "--out", "run.png")
    Path("alone.pt").write_bytes(Path("run/final.pt").read_bytes())
    for wrong, message in [
        ([], "TASK: needed"),
        (["--policy", "alone.pt"], "does not say on which one"),
        (["--policy", "alone.pt", sprint], "bodies: got none"),
        (["--policy", "run/config.json"], "cannot be read"),
        (["--policy", "run", "--out", "run.jpg"], ".png, .mp4, .gif"),
        (["--policy", "run", "--out", "missing/run.png"], "missing does not exist"),
        (["--policy", "run", "--every", "0"], "every"),
    ]:
        assert message in refused(capsys, "watch", *wrong)
    for path in ("alone.pt", "run/checkpoint.pt"):  # the newest of a training that goes on
        assert main(["watch", sprint, "--policy", path, "--body", BODY, "--out", "run.png"]) == 0


def test_stiffness_is_read_as_it_is_written():
    bodies = [BODY, OTHER]
    assert read_stiffness([], bodies) is None
    one, other = read_stiffness(["2,1.5,1/0.5,7,1"], bodies[:1])[0], read_stiffness(["1.25"], bodies)[1]
    assert one.tolist() == [[2, 1.5, 1], [0.5, 1, 1]]  # the empty cell does not count
    assert (other[np.array([[1, 1, 1], [1, 0, 1]], bool)] == 1.25).all()
    assert write_stiffness(one, np.array([[1, 1, 1], [1, 0, 1]], bool)) == ["2.00 1.50 1.00", "0.50    . 1.00"]
    for wrong, message in (
        (["1", "1", "1"], "3 for 2 bodies"),
        (["soft"], "got 'soft'"),
        (["1,2/1"], "differ in length"),
        (["1,1/1,1"], "shape"),
        (["3"], "0.5"),
    ):
        with pytest.raises(ValueError, match=message):
            read_stiffness(wrong, bodies)


def test_bodies_and_worlds_come_from_files(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot, slit = as_body(OTHER), Body("HH/VV", [[0, 0, 1], [1, 2, 3]])
    np.savez("17.npz", robot.grid.astype(float), robot.connections)
    np.savez("slit.npz", slit.grid, slit.connections)
    world = World.load("Walker-v0").place(WorldObject("robot", robot.grid, (3, 1)))
    Path("hills.json").write_text(json.dumps(world.to_design_tool()))

    shown = ["watch", "--steps", "2", "--out", "last.png", "--width", "64", "--height", "32"]
    for arguments in (["Walker-v0", "--body", "17.npz"], ["--world", "hills.json"], ["hills.json"]):
        assert main([*shown, *arguments]) == 0
        assert f"{robot.text}: 2 env-steps" in capsys.readouterr().out
    assert (
        main([*shown, "--world", "hills.json", "--body", "HHH", "V.V/HHH", "slit.npz"]) == 0
    )  # two are no rows of one
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()[2:]] == ["HHH", "V.V/HHH", "HH/VV"]

    assert main(["train", "--world", "hills.json", *TINY, "--eval-interval", "0"]) == 0
    run = tmp_path / "runs" / "hills-invariant-seed0"
    config = json.loads((run / "config.json").read_text())
    assert (config["task"], config["bodies"]) == ("hills.json", [robot.text])  # its own, as rows
    for task in ([], ["hills.json"], ["--world", "hills.json"]):
        assert main([*shown, "--policy", str(run), *task]) == 0
    assert (
        main(["train", "Walker-v0", "--body", "17.npz", "slit.npz", *TINY, "--eval-interval", "0", "--run", "two"]) == 0
    )
    assert json.loads(Path("two/config.json").read_text())["bodies"] == [robot.text, "slit.npz"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train"], "TASK: needed"),
        (["watch"], "TASK: needed"),
        (["train", "--world", "none.json"], "'none.json': there is no such file"),
        (["train", "Thrower-v0", "--world", "none.json"], "got 'Thrower-v0' too"),
        (["watch", "none.txt"], "'none.txt': there is no such file"),
        (["watch", "Walker-v0", "--body", "none.npz"], "body 'none.npz': there is no such file"),
        (["train", "Walker-v0", "--body", "none.csv"], "nor a file (.npz, .npy, .txt, .json)"),
    ],
)
def test_files_that_are_not_there_are_refused(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert message in refused(capsys, *arguments)
    assert not list(tmp_path.iterdir())


def test_work_is_told_and_reported_where_it_is_asked_for(sprint, capsys):
    command = ["train", sprint, "--body", BODY, "--material", "reactive", *TINY, "--work-weight"]
    assert main([*command, "1e-5", "2e-5", "--run", "run"]) == 0
    out = capsys.readouterr().out
    assert json.loads(Path("run/config.json").read_text())["work_weight"] == [1e-5, 2e-5]
    final = json.loads(Path("run/result.json").read_text())["final"]
    assert f"work    {final['actuation_work']:,.0f} of actuation and {final['stiffness_work']:,.0f} of" in out
    assert final["actuation_work"] > 0
    rows = [json.loads(line) for line in Path("run/curve.jsonl").read_text().splitlines()]
    assert rows[-1]["net_stiffness_work"] == final["net_stiffness_work"]
    assert main([*command, "1e-5", "2e-5", "--run", "run", "--resume"]) == 0
    assert "work_weight" in refused(capsys, *command, "0", "--run", "run", "--resume")
    assert "work_weight: got -1" in refused(capsys, *command, "-1", "--run", "other")
    pytest.importorskip("plotly")
    assert main(["report", "run", "--no-animations"]) == 0
    assert f"{final['actuation_work']:,.0f}" in Path("report.html").read_text()
