"""Experiments B and C: presets, equal budgets, table and figures, and a tiny run from end to end."""

import importlib
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def suite(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("_codesign")


@pytest.fixture
def report(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("_codesign_report")


def record(arm, seed, points):
    body = {"body": "HV/SR", "connections": None, "stiffness": [[0.5, 1.0], [2.0, 1.5]], "fitness": points[-1][1]}
    return {"task": "Walker-v0", "arm": arm, "seed": seed, "bodies": 4, "curve": points, "best": body}


def test_presets_give_both_arms_the_same_budget(suite):
    for name, preset in suite.PRESETS.items():
        jobs = preset.jobs()
        assert len({job.name for job in jobs}) == len(jobs)
        is_hundred = name.startswith("hundred-bodies-")
        arms = {name.split("-")[-1]} if is_hundred else set(suite.EXPERIMENTS[preset.experiment])
        assert {job.config.arm for job in jobs} == arms
        assert len({replace(job.config, arm="fixed", task="", seed=0) for job in jobs}) == 1, name
    assert suite.PRESETS["reactive-paper"].base.budget == 100
    assert len(suite.PRESETS["invariant-paper"].jobs()) == 36


def test_the_cost_of_a_preset_counts_env_steps_of_all_kinds(suite):
    hundred = suite.PRESETS["hundred-bodies-invariant"]
    assert hundred.base.budget == suite.PUBLISHED_BODIES
    costs = [suite.cost_of(replace(hundred.base, task=task, arm="invariant")) for task in hundred.tasks]
    assert min(cost.search for cost in costs) > 0
    assert hundred.steps_per_run == max(cost.total for cost in costs)
    assert suite.PRESETS["reactive-small"].steps_per_run == 600_000


def test_returns_stand_beside_published_ones_where_as_many_bodies_were_trained(report):
    few = record("fixed", 0, [[100, 1.0], [200, 3.0]]) | {"best_return": 4.25}
    assert "published" not in report.table(report.summarise([few]))
    shown = report.table(report.summarise([few | {"bodies": 100}]))
    assert shown.splitlines()[1].split()[-4:] == ["3.00", "200", "4.25", "10.55"]


def test_wrong_arms_and_tasks_are_refused(suite):
    with pytest.raises(ValueError, match="arm: got"):
        replace(suite.PRESETS["reactive-quick"], arms=("invariant",))
    with pytest.raises(ValueError, match="task: got"):
        replace(suite.PRESETS["reactive-quick"], tasks=("Hopper-v0",))
    with pytest.raises(ValueError, match="experiment: got 'D'"):
        replace(suite.PRESETS["reactive-quick"], experiment="D")


def test_runs_are_compared_where_the_shortest_ends(report):
    points = [[100, 1.0], [200, 3.0], [400, 7.0]]
    assert report.best_at(points, [100, 199, 200, 1000]).tolist() == [1.0, 1.0, 3.0, 7.0]
    assert np.isnan(report.best_at(points, [99])[0])
    runs = [record("fixed", 0, points), record("fixed", 1, [[150, 2.0], [300, 4.0]])]
    runs.append(record("reactive", 0, [[120, 5.0], [350, 6.0]]))
    fixed, reactive = report.summarise(runs)
    assert (fixed["scores"], fixed["env_steps"]) == ([3.0, 4.0], 300)
    assert (fixed["mean"], reactive["mean"]) == (3.5, 5.0)
    assert (fixed["ends"], fixed["end_steps"], reactive["ends"]) == ([7.0, 4.0], 350, [6.0])
    shown = report.table([fixed, reactive])
    assert "3.50 (0.71)" in shown
    assert "7.00 4.00" in shown


def test_figures(report, tmp_path):
    pytest.importorskip("matplotlib")
    runs = [record(arm, seed, [[100, 1.0], [200, 2.0 + seed]]) for arm in ("fixed", "reactive") for seed in range(2)]
    report.plot(runs, tmp_path / "curves.png")
    report.draw_designs(runs, tmp_path / "designs.png")
    assert min((tmp_path / name).stat().st_size for name in ("curves.png", "designs.png")) > 5000


def test_runs_stopped_before_their_first_score_are_left_out(report, tmp_path):
    pytest.importorskip("matplotlib")
    early = record("fixed", 0, [[100, 1.0]]) | {"best": None, "curve": []}
    report.plot([early], tmp_path / "curves.png")
    report.draw_designs([early], tmp_path / "designs.png")
    assert not list(tmp_path.iterdir())
    assert report.summarise([early]) == []
    report.plot([early, record("fixed", 1, [[100, 1.0], [200, 2.0]])], tmp_path / "curves.png")
    assert (tmp_path / "curves.png").exists()


@pytest.mark.slow
def test_a_tiny_experiment_from_end_to_end(tmp_path):
    command = [sys.executable, str(BENCHMARKS / "run_suite.py"), "--preset", "invariant-quick", "--total-steps", "5000"]
    command += ["--tasks", "Walker-v0", "--body-steps", "512", "--output", str(tmp_path / "run")]
    first = subprocess.run(command, capture_output=True, text=True, check=False)
    assert first.returncode == 0, first.stderr
    assert "2 runs of 5,000 env-steps" in first.stderr
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert {row["arm"] for row in results["summary"]} == {"prescribed", "invariant"}
    assert all(run["env_steps"] >= 5000 for run in results["runs"])
    assert (tmp_path / "run" / "designs.png").exists()
    again = subprocess.run([*command, "--resume"], capture_output=True, text=True, check=False)
    assert json.loads((tmp_path / "run" / "results.json").read_text())["summary"] == results["summary"], again.stderr
