"""`evogymcm evolve`: a run from its start to its report."""

import pytest

from evogymcm.__main__ import main
from tests.commands.tools import refused

QUICK = ("--shape", "3", "3", "--first", "4", "--survivors", "2", "--candidates", "2", "--max-env-steps", "2500")


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_robot_evolves_and_is_watched_and_reported(capsys):
    assert main(["evolve", "Walker-v0", "--run", "here", "--evolves-stiffness", *QUICK]) == 0
    told = capsys.readouterr().out
    score = told.split("score ")[1].split()[0].rstrip(":")
    body = told.split(": ")[1].split()[0]
    assert "robust" in told
    assert main(["watch", "--policy", "here", "--out", "walk.png", "--every", "500"]) == 0
    assert f"{body}: 500 env-steps, score {score}" in capsys.readouterr().out
    assert main(["report", "here", "--out", "report.html"]) == 0
    with open("report.html", encoding="utf-8") as file:
        page = file.read()
    assert "data:image/gif" in page
    assert body in page
    assert "(--resume)" in refused(capsys, "evolve", "Walker-v0", "--run", "here", *QUICK)


def test_arguments_that_cannot_be_used_are_told(capsys):
    assert "survivors: got 5" in refused(capsys, "evolve", "Walker-v0", "--first", "4", "--survivors", "5")
    assert "Nothing-v0" in refused(capsys, "evolve", "Nothing-v0")


@pytest.mark.slow
def test_its_best_designs_get_policies_that_are_watched_and_reported(capsys):
    assert main(["evolve", "Walker-v0", "--run", "here", *QUICK]) == 0
    capsys.readouterr()
    small = ("--count", "1", "--ppo.total-steps", "64", "--ppo.num-worlds", "2", "--ppo.rollout-steps", "32")
    assert main(["specialise", "here", *small]) == 0
    told = capsys.readouterr().out
    assert "in the search" in told
    robust = told.split("\nrobust ")[-1].split("\n")[0]
    assert "1 designs, invariant: 64 env-steps" in told
    assert "(--resume)" in refused(capsys, "specialise", "here", *small)
    assert main(["specialise", "here", *small, "--resume"]) == 0
    assert robust in capsys.readouterr().out
    assert main(["watch", "--policy", "here/specialists/best.pt", "--out", "walk.png", "--every", "500"]) == 0
    assert main(["report", "here/specialists", "--out", "report.html"]) == 0
    assert "run of train" in refused(capsys, "specialise", "here/specialists")
