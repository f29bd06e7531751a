"""The training suite: presets, command line, report; and a tiny run from end to end."""

import contextlib
import importlib
import json
import queue
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from evogymcm import robot_tasks, robots
from evogymcm.algos.analysis import Recording

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


def _both_arms(seeds: int = 3) -> list[dict]:
    """Control-only scores 8.0, 8.1 ...; co-optimisation 9.0, 9.3 ..."""
    scores = [("control-only", 8.0, 0.1), ("co-optimisation", 9.0, 0.3)]
    return [_record(arm, seed, first + more * seed) for seed in range(seeds) for arm, first, more in scores]


def test_summary_compares_the_arms(report):
    control, both = report.summarise(_both_arms())
    assert "gain" not in control
    gain = both["gain"]
    assert gain["final"] == pytest.approx(9.3 - 8.1)
    low, high = gain["final_interval"]
    assert 9.0 - 8.2 <= low < gain["final"] < high <= 9.6 - 8.0
    assert gain["best"] == pytest.approx(gain["final"])  # each best is half a point above the last
    assert (gain["final_improvement"], gain["best_improvement"]) == (1.0, 1.0)
    assert gain["paper"] == pytest.approx(9.55 - 9.46)
    assert both["final_scores"] == pytest.approx([9.0, 9.3, 9.6])
    json.dumps([control, both], allow_nan=False)


def test_all_tasks_together_count_in_the_papers_units(report):
    runs = _both_arms() + [run | {"task": "AreaMaximizer-v0"} for run in _both_arms()]
    total = report.overall(report.summarise(runs))
    assert total["tasks"] == ["Walker-v0", "AreaMaximizer-v0"]
    pool = sorted([8.0 / 9.46, 8.1 / 9.46, 8.2 / 9.46, 8.0 / 0.62, 8.1 / 0.62, 8.2 / 0.62])
    value = total["control-only"]["final"]["interquartile_mean"]
    assert value == pytest.approx(sum(pool[1:-1]) / 4)
    assert total["improvement"]["final"]["probability"] == 1.0
    json.dumps(total, allow_nan=False)


def test_one_arm_alone_has_nothing_to_compare(report):
    rows = report.summarise([_record("co-optimisation", 0, 9.0)])
    assert "gain" not in rows[0]
    assert report.overall(rows) == {}
    assert "minus" not in report.table(rows)


def test_table_says_how_far_the_intervals_can_be_trusted(report):
    text = report.table(report.summarise(_both_arms())).replace("\n", " ")
    assert "+1.20 [" in text
    assert "+0.09" in text  # the paper's
    assert "3 seeds an arm" in text
    assert "80% of cases" in text
    single = report.table(report.summarise(_both_arms(1)))
    assert "+1.00" in single
    assert "[" not in single
    assert "One seed" in single


def test_markdown_holds_the_same_cells(report):
    rows = report.summarise(_both_arms())
    text = report.markdown(rows)
    tables = [[line for line in part.splitlines() if line.startswith("|")] for part in text.split("\n\n")]
    assert [len(lines) for lines in tables] == [4, 3, 5, 0]
    for lines in tables:
        assert len({line.count("|") for line in lines}) <= 1
    assert (
        "| Walker-v0 | co-optimisation | 3 | 1,000 | 0.10 | 9.30 (0.30) | 97.4% | 9.55 (0.01) | 9.80 (0.30) |" in text
    )
    plain = report.table(rows).replace("\n", " ")
    for cell in text.replace("\n", "|").split("|"):
        assert cell.strip("- ") in plain


def test_figure(report, tmp_path):
    pytest.importorskip("matplotlib")
    report.plot(_both_arms(2), tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000


def test_the_band_reaches_as_far_as_the_shortest_run(report):
    long = np.array([[0, 100, 200, 300], [0.0, 1.0, 2.0, 3.0]])
    short = np.array([[0, 150], [2.0, 2.0]])
    steps, scores = report.common_curve([long, short])
    assert steps.tolist() == [0, 100, 150]
    assert scores.tolist() == [[0.0, 1.0, 1.5], [2.0, 2.0, 2.0]]


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


@pytest.mark.parametrize("steps", [300, 1])
def test_figure_of_signals(monkeypatch, tmp_path, steps):
    pytest.importorskip("matplotlib")
    signals = _module("_signals", monkeypatch)
    t = np.arange(steps)
    both = 1 + 0.3 * np.stack([np.sin(t / 3), np.cos(t / 3)], 1)
    actuation = np.where([True, False], both, np.nan)
    contact = np.stack([t % 20 < 8, t < 0], 1)
    recording = Recording(
        "Walker-v0", np.array([[0, 0], [1, 2]]), np.array([True, False]), actuation, both, contact, 1.0
    )
    signals.plot(signals.analyse_signals(recording), tmp_path / "signals.png")
    assert (tmp_path / "signals.png").stat().st_size > 20_000
    assert [path.name for path in tmp_path.iterdir()] == ["signals.png"]  # no unfinished file beside it


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
    signals = _check_signals(tmp_path / "run", results["runs"])
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    again = subprocess.run([*command, "--resume"], capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert json.loads((tmp_path / "run" / "results.json").read_text())["summary"] == results["summary"]
    script = [sys.executable, str(BENCHMARKS / "analyse_signals.py")]
    signals.unlink()
    done = subprocess.run([*script, str(signals.parent)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert signals.parent.name in done.stdout
    assert signals.exists()
    wrong = tmp_path / "run" / "Walker-v0-control-only-seed0"
    done = subprocess.run([*script, str(wrong), str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "control-only" in done.stderr
    assert "config.json" in done.stderr


@pytest.mark.slow
def test_a_killed_suite_leaves_no_worker_behind(tmp_path):
    command = [sys.executable, str(BENCHMARKS / "run_suite.py"), "--preset", "quick", "--output", str(tmp_path / "run")]
    suite = subprocess.Popen([*command, "--processes", "1"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    while suite.poll() is None and not list(tmp_path.glob("run/*/curve.jsonl")):
        time.sleep(0.1)
    suite.kill()
    suite.communicate(timeout=20)  # until no process holds its output any more
    (curve,) = tmp_path.glob("run/*/curve.jsonl")
    assert len(curve.read_text().splitlines()) < 200  # it had not come to its end


def _check_signals(folder: Path, runs: list[dict]) -> Path:
    """Only the run with stiffness control has signals, of an episode that scores as the run's last policy."""
    (run,) = [run for run in runs if run["arm"] == "co-optimisation"]
    assert [("signals" in other) for other in runs].count(True) == 1
    path = folder / "Walker-v0-co-optimisation-seed0" / "signals.json"
    assert not (folder / "Walker-v0-control-only-seed0" / "signals.json").exists()
    record = json.loads(path.read_text())
    assert record["score"] == pytest.approx(run["final"]["score"], abs=1e-4)
    assert run["signals"]["score"] == run["final"]["score"]
    assert len(record["voxels"]) == robots["Walk_Bot"].n_voxels
    assert {len(voxel["stiffness"]) for voxel in record["voxels"]} == {500}
    assert json.loads((path.parent / "result.json").read_text())["signals"]["n_impacts"] == run["signals"]["n_impacts"]
    return path
