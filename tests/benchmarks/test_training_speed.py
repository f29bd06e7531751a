"""The benchmark of training speed: its rows, and tiny runs of both programs, EvoGym played by a fake."""

import importlib
import json
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from evogymcm.algos import PPOConfig

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SMALL = PPOConfig(total_steps=64, num_worlds=4, rollout_steps=8, epochs=2, minibatch=16, hidden=8, seed=5)


@pytest.fixture
def speed(monkeypatch) -> ModuleType:
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("training_speed")


@pytest.fixture(name="fake_evogym")
def _fake_evogym(fake_evogym):
    pytest.importorskip("stable_baselines3")
    return fake_evogym


@pytest.fixture
def tiny(speed):
    return speed.Options(body="HSH", materials=("invariant",), ppo=SMALL, pairs=3, seconds=0.02)


def rows_of(speed, options, capsys):
    speed.main(replace(options, json=True))
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_ours_is_the_default_run(speed):
    options = speed.Options()
    assert options.ppo == PPOConfig()
    assert options.task == "Walker-v0"
    assert options.materials == ("invariant", "reactive")


def test_a_row_for_each_setting(speed, tiny, capsys):
    rows = rows_of(speed, replace(tiny, materials=("invariant", "reactive"), threads=2), capsys)
    assert [row["material"] for row in rows] == ["invariant", "reactive"]
    for row in rows:
        expected = {"task": "Walker-v0", "body": "HSH", "worlds": 4, "threads": 2, "torch_threads": 1}
        assert expected.items() <= row.items()
        assert row["env_steps_per_s"] > 0
        assert 1 <= row["epochs"] <= 2
        assert row["versions"]["torch"]
        assert "ratio" not in row


def test_whole_updates_are_counted(speed, tiny, monkeypatch):
    """Time stands still but for a second an update, so that the rate is known."""
    runner, now = speed.Ours(tiny, speed.as_body("HSH"), "invariant"), [0.0]
    update = speed.Trainer.update

    def timed(trainer):
        now[0] += 1.0
        return update(trainer)

    monkeypatch.setattr(speed.Trainer, "update", timed)
    monkeypatch.setattr(speed.time, "perf_counter", lambda: now[0])
    assert runner.run(3.0) == SMALL.frames_per_update == 32
    assert len(runner.epochs) == 3
    runner.close()


def test_a_run_that_ends_is_followed_by_another(speed, tiny):
    runner = speed.Ours(tiny, speed.as_body("HSH"), "invariant")
    first = runner.trainer
    while runner.trainer is first:
        runner.run(1e-6)
    assert first.env_steps == SMALL.total_steps
    assert runner.trainer.config == replace(SMALL, seed=6)
    assert runner.trainer.env_steps == 32
    runner.close()


@pytest.mark.slow
def test_comparison_with_the_reference(speed, tiny, fake_evogym, capsys):
    (row,) = rows_of(speed, replace(tiny, against_evogym=fake_evogym, reference_threads=1), capsys)
    assert len(row["pairs"]) == 3
    assert row["ratio"] == sorted(row["pairs"])[1]
    assert row["reference_env_steps_per_s"] > 0
    assert row["reference_versions"]["stable-baselines3"]
    assert row["reference_versions"]["torch_threads"] == 1
    assert row["reference_ppo"]["batch_size"] == 4


@pytest.mark.slow
def test_the_reference_trains_on_the_steps_that_it_counts(speed, tiny, fake_evogym):
    """Whole rollouts of 128 steps; each has 128 gradient steps, of a tenth of a millisecond at the very least."""
    reference = speed.Reference(fake_evogym, replace(tiny, reference_threads=1), speed.as_body("HSH"))
    rates = [reference.run(1e-3) for _ in range(3)]  # one rollout each
    reference.close()
    assert int((fake_evogym.parent / "evogym" / "steps").read_text()) == 3 * 128
    assert 0 < max(rates) < 10_000


def test_an_interpreter_without_evogym_is_refused(speed, tiny, tmp_path):
    empty = tmp_path / "python"
    empty.write_text("#!/bin/sh\nexit 1\n", encoding="utf-8")
    empty.chmod(0o755)
    with pytest.raises(RuntimeError, match="evogym and stable-baselines3 could not be run"):
        speed.main(replace(tiny, against_evogym=empty))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pairs": 0}, "pairs: got 0"),
        ({"seconds": -1.0}, "seconds: got -1.0"),
        ({"threads": 0}, "threads: got 0"),
        ({"reference_threads": 0}, "reference_threads: got 0"),
        ({"materials": ()}, "materials: got none"),
    ],
)
def test_bad_options_are_refused(speed, changes, message):
    with pytest.raises(ValueError, match=message):
        speed.Options(**changes)


@pytest.mark.slow
def test_the_table_names_what_was_measured(speed, tiny, fake_evogym, capsys):
    speed.main(replace(tiny, against_evogym=fake_evogym, pairs=1))
    captured = capsys.readouterr()
    assert captured.out.startswith("Walker-v0")
    assert "reference" in captured.out
    assert "invariant, 4 worlds" in captured.err  # progress stays apart from results
