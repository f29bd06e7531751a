"""`evogymcm gait`, and watching what it found."""

import pytest

from evogymcm.__main__ import main
from tests.commands.tools import refused

pytest.importorskip("cma")
QUICK = ("--first", "4", "--candidates", "2", "--trial-steps", "20", "--env-steps", "2500")


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_gait_is_found_and_watched(capsys):
    assert main(["gait", "Walker-v0", "--body", "HHH/V.V", "--stiffness", "2", "--out", "walk.json", *QUICK]) == 0
    told = capsys.readouterr().out
    assert "wrote walk.json" in told
    score = told.split("score ")[1].split()[0]
    assert main(["watch", "--policy", "walk.json", "--out", "walk.png", "--every", "500"]) == 0
    assert f"HHH/V.V: 500 env-steps, score {score}" in capsys.readouterr().out
    assert main(["watch", "--policy", "walk.json", "--body", "VVV/H.H", "--steps", "5", "--out", "other.png"]) == 0
    assert "VVV/H.H: 5 env-steps" in capsys.readouterr().out
    assert "with 'invariant'" in refused(capsys, "watch", "--policy", "walk.json", "--material", "reactive")


def test_arguments_that_cannot_be_used_are_told(capsys):
    assert "at least" in refused(capsys, "gait", "Walker-v0", "--env-steps", "100")
    assert ".json" in refused(capsys, "gait", "Walker-v0", "--out", "walk.pt")
    assert "does not exist" in refused(capsys, "gait", "Walker-v0", "--out", "no/walk.json")
    assert "reactive" in refused(capsys, "gait", "Walker-v0", "--material", "reactive", "--stiffness", "2")
