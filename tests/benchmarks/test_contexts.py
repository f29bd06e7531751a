"""The comparison of contexts: its runs, its measures, its table; and a tiny run from end to end."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def contexts(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("contexts")


def record(variant, seed, score, seconds=(2.0,), finished=True):
    return {
        "task": "Walker-v0", "variant": variant, "seed": seed, "finished": finished, "env_steps": 1000,
        "final": {"score": score}, "best_score": score + 0.5, "mean_of_curve": score / 2,
        "update_seconds": list(seconds), "frames_per_update": 100, "curve": [[0, 0.0, 0.0], [1000, 1.0, score]],
    }  # fmt: skip


def test_every_variant_has_the_same_budget(contexts):
    jobs = contexts.Options().comparison().jobs()
    assert len({job.name for job in jobs}) == len(jobs) == 2 * 5 * 2
    assert {(job.ppo.network, job.ppo.context) for job in jobs if job.variant != "mlp"} == {
        ("voxel", name) for name in ("none", "body", "message", "attention")
    }
    assert {job.ppo.network for job in jobs if job.variant == "mlp"} == {"mlp"}
    assert {(job.ppo.total_steps, job.ppo.num_worlds, job.arm) for job in jobs} == {(300_000, 64, "co-optimisation")}
    assert {job.arm for job in contexts.Options(material="invariant").comparison().jobs()} == {"control-only"}


def test_bad_settings_are_refused(contexts, tmp_path, capsys):
    for changes, message in (
        ({"variants": ("cnn",)}, "cnn"),
        ({"tasks": ("Hopper-v0",)}, "Hopper"),
        ({"seeds": ()}, ""),
    ):
        assert contexts.main(contexts.Options(output=tmp_path / "run", **changes)) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    (tmp_path / "something").touch()
    assert contexts.main(contexts.Options(output=tmp_path)) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_mean_of_curve_is_the_area_over_env_steps(contexts):
    assert contexts.mean_of_curve([[0, 0.0, 0.0], [100, 1.0, 4.0], [400, 9.0, 4.0]]) == pytest.approx(3.5)
    assert contexts.mean_of_curve([[0, 0.0, 2.5]]) == 2.5


def test_rates_leave_out_the_first_update_and_evaluations(contexts):
    rows = [{"seconds": 1.0, "score": 0.0}, {"seconds": 9.0}, {"seconds": 11.0}, {"seconds": 16.0, "score": 1.0}]
    assert contexts.update_seconds([*rows, {"seconds": 19.0}]) == [2.0, 3.0]


def test_summary_and_table(contexts, tmp_path):
    runs = [record("mlp", 0, 1.0), record("body", 0, 4.0, (4.0, 8.0)), record("body", 1, 6.0, (5.0,))]
    runs.append(record("none", 0, 9.0, finished=False))  # counts nowhere
    body, plain = contexts.summarise(runs)
    assert (body["variant"], body["mean"], body["scores"], body["env_steps_per_s"]) == ("body", 5.0, [4.0, 6.0], 20.0)
    assert (plain["variant"], plain["std"], plain["mean_of_curve"]) == ("mlp", None, 0.5)
    assert "5.00 (1.41)" in contexts.table([body, plain])
    pytest.importorskip("matplotlib")
    contexts.plot(runs, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 5000


@pytest.mark.slow
def test_a_tiny_comparison_from_end_to_end(tmp_path):
    command = [sys.executable, str(BENCHMARKS / "contexts.py"), "--output", str(tmp_path / "run"), "--seeds", "0"]
    command += ["--tasks", "Walker-v0", "--variants", "attention", "mlp", "--total-steps", "96", "--num-worlds", "1"]
    first = subprocess.run(command, capture_output=True, text=True, check=False)
    assert first.returncode == 0, first.stderr
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert [row["variant"] for row in results["summary"]] == ["attention", "mlp"]
    assert all(run["env_steps"] == 96 for run in results["runs"])
    assert (tmp_path / "run" / "curves.png").exists()
    assert subprocess.run(command, capture_output=True, check=False).returncode == 2
    again = subprocess.run([*command, "--resume"], capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert json.loads((tmp_path / "run" / "results.json").read_text())["summary"] == results["summary"]
