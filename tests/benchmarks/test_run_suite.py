"""The training suite: presets, command line, report; and a tiny run from end to end."""

import contextlib
import importlib
import json
import queue
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from evogymcm import robot_tasks

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def _module(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A module of the benchmarks folder, found as the scripts there find it."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module(name)


@pytest.fixture
def suite(monkeypatch) -> ModuleType:
    return _module("_suite", monkeypatch)


@pytest.fixture
def report(monkeypatch) -> ModuleType:
    return _module("_report", monkeypatch)


@pytest.fixture
def run_suite(monkeypatch) -> ModuleType:
    return _module("run_suite", monkeypatch)


def _record(arm: str, seed: int, score: float, *, finished: bool = True) -> dict:
    """What a run on Walker-v0 returns."""
    return {
        "task": "Walker-v0", "arm": arm, "seed": seed, "robot": "Walk_Bot", "finished": finished, "env_steps": 1000,
        "untrained": {"score": 0.1, "return": 0.1}, "best_score": score + 0.5, "ceiling": 9.55,
        "final": {"score": score, "return": score + 1, "fraction_of_ceiling": score / 9.55} if finished else None,
        "curve": [[0, 0.0, 0.1], [1000, 2.0, score]],
    }  # fmt: skip


def test_the_papers_robots_stand_on_their_tasks(suite):
    assert {row.robot: task for task, row in suite.PAPER.items()}.items() <= dict(robot_tasks).items()


def test_presets(suite):
    assert len(suite.PRESETS["paper"].jobs()) == 36
    assert suite.PRESETS["paper"].ppo.total_steps == 1_000_000
    assert len(suite.PRESETS["walker"].jobs()) == 3
    for preset in suite.PRESETS.values():
        names = [job.name for job in preset.jobs()]
        assert len(set(names)) == len(names)


def test_unknown_tasks_and_arms_are_refused(suite):
    with pytest.raises(ValueError, match="Hopper"):
        replace(suite.PRESETS["quick"], tasks=("Hopper-v0",))
    with pytest.raises(ValueError, match="both"):
        replace(suite.PRESETS["quick"], arms=("both",))


def test_command_line_changes_the_preset(run_suite, suite):
    options = run_suite.Options("paper", tasks=("Walker-v0",), seeds=(7,), total_steps=500, num_worlds=3)
    changed = options.suite()
    assert changed.tasks == ("Walker-v0",)
    assert changed.arms == tuple(suite.ARMS)
    assert [job.ppo.seed for job in changed.jobs()] == [7, 7]
    assert (changed.ppo.total_steps, changed.ppo.num_worlds) == (500, 3)


def test_summary_keeps_last_and_best_apart(report):
    runs = [_record("co-optimisation", 0, 9.0), _record("co-optimisation", 1, 9.4), _record("control-only", 0, 8.0)]
    runs.append(_record("control-only", 1, 1.0, finished=False))  # counts nowhere
    control, both = report.summarise(runs)
    assert (control["seeds"], control["final_score"], control["final_score_std"]) == (1, 8.0, None)
    assert both["final_score"] == pytest.approx(9.2)
    assert both["final_score_std"] == pytest.approx(0.2828, abs=1e-4)
    assert both["best_score"] == pytest.approx(9.7)
    assert both["paper_score"] == 9.55


def test_table_sets_the_paper_beside(report):
    text = report.table(report.summarise([_record("co-optimisation", 0, 9.0), _record("co-optimisation", 1, 9.4)]))
    assert "9.20 (0.28)" in text
    assert "9.55 (0.01)" in text
    assert "96.3%" in text
    assert "untrained" in text


def test_figure(report, tmp_path):
    pytest.importorskip("matplotlib")
    report.plot([_record("co-optimisation", 0, 9.0), _record("control-only", 0, 8.0)], tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000


def test_an_existing_folder_is_refused(run_suite, tmp_path, capsys):
    (tmp_path / "something").touch()
    assert run_suite.main(run_suite.Options(output=tmp_path)) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_a_failed_run_does_not_take_the_others_with_it(run_suite, tmp_path, monkeypatch, capsys):
    def run_job(job, folder, resume):
        if job.arm == "control-only":
            raise OSError("disk full")
        return _record(job.arm, job.ppo.seed, 9.0)

    @contextlib.contextmanager
    def threads(count):
        with ThreadPoolExecutor(count) as pool:
            yield pool, run_suite._Link(queue.Queue(), threading.Event())

    monkeypatch.setattr(run_suite, "_run_job", run_job)
    monkeypatch.setattr(run_suite, "_workers", threads)
    assert run_suite.main(run_suite.Options(output=tmp_path / "run")) == 1
    output = capsys.readouterr()
    assert "disk full" in output.err
    assert "Walker-v0-control-only-seed0 failed" in output.err
    assert "--resume" in output.out
    runs = json.loads((tmp_path / "run" / "results.json").read_text())["runs"]
    assert [run["arm"] for run in runs] == ["co-optimisation"]


def test_machine(monkeypatch):
    machine = _module("_machine", monkeypatch)
    assert machine.machine()["cores"] >= 1
    assert machine.versions()["torch"]
    json.dumps([machine.machine(), machine.versions(), machine.commit()])


@pytest.mark.slow
def test_a_tiny_suite_from_end_to_end(tmp_path):
    pytest.importorskip("evogymcm.envs.torchrl")
    command = [sys.executable, str(BENCHMARKS / "run_suite.py"), "--preset", "quick", "--output", str(tmp_path / "run")]
    command += ["--total-steps", "300", "--num-worlds", "2"]
    first = subprocess.run(command, capture_output=True, text=True, check=False)
    assert first.returncode == 0, first.stderr
    assert str(tmp_path / "run") in first.stdout
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert [run["env_steps"] for run in results["runs"]] == [320, 320]
    assert {row["arm"] for row in results["summary"]} == {"control-only", "co-optimisation"}
    assert (tmp_path / "run" / "curves.png").exists()
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    again = subprocess.run([*command, "--resume"], capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert json.loads((tmp_path / "run" / "results.json").read_text())["summary"] == results["summary"]
