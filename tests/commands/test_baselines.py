"""`evogymcm watch` and `train` with a baseline of the package."""

import json
import re
from pathlib import Path

import pytest

import evogymcm as cm
from evogymcm.__main__ import main
from evogymcm.algos import evaluate
from evogymcm.envs import SoftRobotEnv, TaskEngine, sine_gait
from tests.commands.tools import refused

BODY, OTHER = "HHH/V.V", "VHHH/S..R/V..V"


@pytest.mark.usefixtures("sprint_baseline")
def test_watch_moves_any_body_with_the_baseline_where_there_is_one(sprint, capsys):
    pytest.importorskip("matplotlib")
    shown = ["watch", sprint, "--body", BODY, OTHER, "--width", "64", "--height", "32", "--out", "run.png"]

    def watch(*options):
        assert main([*shown, *options]) == 0
        out = capsys.readouterr().out
        return out.splitlines()[0], [float(text) for text in re.findall(r"score (\S+)", out)]

    def rounded(scores):
        return [pytest.approx(score, abs=6e-4) for score in scores]

    env = SoftRobotEnv(sprint, [BODY, OTHER], 2, num_threads=1)
    moved = rounded(evaluate(cm.baseline(sprint), env).score)
    said = "moved by the package's baseline, a policy for any body"
    assert watch() == watch("--policy", "baseline") == (said, moved)
    waves = rounded(evaluate(sine_gait, TaskEngine(sprint, [BODY, OTHER])).score)
    assert watch("--policy", "sine") == ("moved by a sine wave", waves)
    assert waves != moved
    assert watch("--stiffness", "0.5")[1] != moved
    assert watch("--material", "reactive")[0] == "moved by a sine wave"  # there is none
    assert "the policy universal/final.pt" in watch("--policy", "universal")[0]
    assert "(invariant)" in refused(capsys, *shown, "--material", "reactive", "--policy", "baseline")
    assert "TASK: needed" in refused(capsys, "watch", "--policy", "baseline")


@pytest.mark.usefixtures("sprint_baseline")
def test_train_and_codesign_begin_with_what_is_asked_for(sprint, capsys):
    size = ["--total-steps", "64", "--num-worlds", "4", "--rollout-steps", "8"]
    train = ["train", sprint, "--body", BODY, *size, "--initial"]
    assert main([*train, "baseline", "--run", "one"]) == 0
    assert "begun   with the package's policy" in capsys.readouterr().out
    assert main([*train[:-1], "--run", "two"]) == 0
    assert main([*train, "universal/best.pt", "--run", "three"]) == 0
    began = [json.loads(Path(name, "result.json").read_text())["initial"] for name in ("one", "two", "three")]
    assert began == ["baseline", "baseline", "universal/best.pt"]
    assert main([*train, "fresh", "--run", "four"]) == 0
    assert "begun   with random weights" in capsys.readouterr().out
    assert main([*train, "baseline", "--run", "one", "--resume"]) == 0
    assert "hidden: got 4" in refused(capsys, *train, "baseline", "--hidden", "4", "--run", "new")
    evolve = ["codesign", sprint, "--population", "2", "--budget", "2", "--shape", "2", "2", "--initial", "baseline"]
    assert "(invariant)" in refused(capsys, *evolve, "--material", "reactive", "--run", "new")
    assert not Path("new").exists()
