"""The comparison of speeds with stored ratios: what is reported, what is stored, and that what is measured can run."""

import importlib
import json
from pathlib import Path

import pytest
import torch

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def speed(monkeypatch, tmp_path):
    """The program, with two entries that need no time: one has a ratio of 4, and the other the next of a list."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    module = importlib.import_module("speed_baseline")
    monkeypatch.setattr(module, "BASELINE", tmp_path / "speed.json")
    monkeypatch.setattr(module, "ENTRIES", {"steady": (), "changing": ()})
    module.given = []
    monkeypatch.setattr(module, "measure", lambda name, options: 4.0 if name == "steady" else module.given.pop(0))
    before = torch.get_num_threads()
    yield module
    torch.set_num_threads(before)


def test_the_median_is_stored_with_a_tolerance_that_grows_with_the_spread(speed):
    speed.given = [2.0, 1.0, 3.0]
    assert speed.main(speed.Options(write=True, runs=3)) == 0
    stored = json.loads(speed.BASELINE.read_text())
    assert stored["runs"] == 3
    assert {"machine", "commit", "versions"} <= stored.keys()
    assert stored["entries"] == {
        "steady": {"ratio": 4.0, "tolerance": 1.25},
        "changing": {"ratio": 2.0, "tolerance": 4.0},  # (2 / 1) ** 2
    }


@pytest.mark.parametrize(
    ("given", "status"),
    [([0.7], 0), ([9.0], 0), ([0.6, 0.6, 0.6], 1), ([0.6, 0.6, 0.7], 0)],
    ids=["within the tolerance", "faster", "slow every time", "slow but once"],
)
def test_what_is_slow_every_time_is_reported(speed, given, status, capsys):
    entries = {"steady": {"ratio": 4.0, "tolerance": 1.25}, "changing": {"ratio": 1.0, "tolerance": 1.5}}
    speed.BASELINE.write_text(json.dumps({"entries": entries}))
    speed.given = list(given)
    assert speed.main(speed.Options()) == status
    steady, changing = capsys.readouterr().out.splitlines()
    assert "SLOWER" not in steady
    assert ("SLOWER: allowed x0.67" in changing) == bool(status)
    assert speed.given == []  # measured again only as long as it is slow


def test_entries_without_a_stored_ratio_are_refused_before_measuring(speed):
    speed.BASELINE.write_text(json.dumps({"entries": {"steady": {"ratio": 4.0, "tolerance": 1.25}}}))
    with pytest.raises(ValueError, match=r"\['changing'\] .*--write"):
        speed.main(speed.Options())
    with pytest.raises(ValueError, match=r"only: got \['other'\], allowed are beginnings of \['steady', 'changing'\]"):
        speed.Options(only=("other",))


def test_the_stored_ratios_are_those_of_today_s_entries(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    module = importlib.import_module("speed_baseline")
    stored = json.loads(module.BASELINE.read_text(encoding="utf-8"))
    assert list(stored["entries"]) == list(module.ENTRIES)
    assert all(entry["tolerance"] >= 1.25 for entry in stored["entries"].values())
    assert "+" not in stored["commit"]  # of a tree without changes


def test_a_ratio_is_the_speed_of_one_thing_in_multiples_of_the_other(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    module = importlib.import_module("speed_baseline")

    def work(times):
        return module._Repeat(lambda: [sum(range(2000)) for _ in range(times)])

    monkeypatch.setattr(module, "ENTRIES", {"one / five": (lambda: work(1), lambda: work(5))})
    assert 3.0 < module.measure("one / five", module.Options(pairs=3, seconds=0.02)) < 8.0
