"""Env-steps to the same score, from curves whose answers are known."""

import json
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import steps_to_reach

    yield steps_to_reach
    for name in ("steps_to_reach", "_codesign_report", "_codesign", "_suite", "_signals"):
        sys.modules.pop(name, None)


def run(curve, task="Walker-v0", arm="reactive"):
    return {"experiment": "B", "task": task, "arm": arm, "curve": curve}


def test_counts_are_read_from_the_mean_over_seeds(script):
    plain = [run([[100, 1.0], [400, 3.0]]), run([[200, 1.0], [400, 5.0]])]
    other = [run([[100, 2.0], [150, 4.0], [500, 6.0]]), run([[50, 4.0], [300, 4.5]])]
    (row,) = script.compare(plain, other)
    assert row["score"] == 4.0
    assert (row["steps"], row["other_steps"], row["share"]) == (400, 150, 0.375)
    assert row["other_steps_of_each_seed"] == [150, 50]
    assert row["other_final"] == 4.25  # at 300, where the shorter one ended


def test_what_is_never_reached_is_told(script):
    (row,) = script.compare([run([[100, 1.0], [400, 3.0]])], [run([[100, 2.0]])])
    assert row["other_steps"] is row["share"] is None
    assert "never" in script.table([row])


def test_arms_that_only_one_suite_has_are_left_out(script):
    assert script.compare([run([[1, 1.0]])], [run([[1, 1.0]], arm="fixed")]) == []


@pytest.mark.parametrize("content", [None, {"runs": [{"task": "Walker-v0", "curve": [[1, 2, 3]]}]}])
def test_folders_that_hold_no_codesign_are_refused(script, tmp_path, content, capsys):
    if content is not None:
        (tmp_path / "results.json").write_text(json.dumps(content))
    assert script.main([str(tmp_path), str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err
    assert script.main([]) == 2
