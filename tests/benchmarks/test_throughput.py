"""The throughput benchmark: its cases, its rows, and tiny runs through every door."""

import importlib
import json
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
import torch

import evogymcm as cm

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def throughput(monkeypatch) -> ModuleType:
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("throughput")


@pytest.fixture
def runners(throughput) -> ModuleType:
    return importlib.import_module("_runners")


@pytest.fixture
def tiny(throughput):
    return throughput.Options(tasks=("Walker-v0",), body="HSH", worlds=3, pairs=3, seconds=0.02)


@pytest.fixture(autouse=True)
def _torch_threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def rows_of(throughput, options, capsys):
    throughput.main(replace(options, json=True))
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_the_default_is_the_standard_body_on_five_tasks(throughput):
    cases = throughput.cases(throughput.Options())
    assert [case.workload.task for case in cases] == list(throughput.TASKS)
    assert len(cases) == 5
    for case in cases:
        assert case.through == "core"
        assert case.workload.bodies == (cm.Body.from_text("HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"),)
        assert (case.workload.worlds, case.workload.threads, case.workload.material) == (64, 1, "invariant")


def test_the_table_of_speeds(throughput):
    cases = throughput.cases(throughput.Options(cases="speed", tasks=("nothing",)))
    loads = [case.workload for case in cases]
    assert any(len(set(load.bodies)) == 64 and load.worlds == 256 for load in loads)
    assert any(load.bodies[0].shape == (10, 10) for load in loads)
    assert any(load.worlds == 1 and case.through == "gymnasium" for load, case in zip(loads, cases, strict=True))
    assert any(case.with_one_thread and case.workload.threads == 2 and case.workload.worlds == 256 for case in cases)
    assert {load.task for load in loads} == set(throughput.TASKS)


def test_the_table_of_doors(throughput, runners):
    cases = throughput.cases(throughput.Options(cases="doors"))
    assert {case.through for case in cases} == set(runners.DOORS) - {"simulator"}
    assert all(case.with_simulator for case in cases)
    assert {case.workload.worlds for case in cases} == {64, 256}


def test_random_bodies(throughput):
    options = throughput.Options(tasks=("Walker-v0",), bodies=7, body_size=4, seed=3)
    (case,) = throughput.cases(options)
    assert len(set(case.workload.bodies)) == 7
    assert {body.shape for body in case.workload.bodies} == {(4, 4)}
    assert case.workload == throughput.cases(options)[0].workload  # the seed decides
    assert len(throughput.cases(replace(options, bodies=0))[0].workload.bodies) == 1


@pytest.mark.parametrize("material", ["invariant", "reactive"])
@pytest.mark.parametrize("door", ["core", "simulator", "gymnasium", "torchrl", "collector", "pettingzoo", "sb3"])
def test_every_door_runs(throughput, tiny, door, material, capsys):
    (row,) = rows_of(throughput, replace(tiny, through=door, material=material, pairs=1), capsys)
    assert row["env_steps_per_s"] > 0
    expected = {"task": "Walker-v0", "through": door, "material": material, "worlds": 3, "threads": 1, "bodies": 1}
    assert expected.items() <= row.items()
    assert row["body"] == "HSH"
    assert row["machine"]["cores"] >= 1
    assert row["versions"]["numba"]


def test_one_world_through_gymnasium_make(throughput, tiny, capsys):
    (row,) = rows_of(throughput, replace(tiny, through="gymnasium", worlds=1), capsys)
    assert row["worlds"] == 1


def test_ended_episodes_begin_anew(runners, throughput, tiny):
    runner = runners.make_runner("core", throughput.cases(tiny)[0].workload)
    runner.engine.length[1] = runner.engine.task.time_limit - 1
    runner.advance()
    assert runner.engine.length.tolist() == [1, 0, 1]


def test_steps_of_all_worlds_are_counted(runners, monkeypatch):
    """Time stands still but for an eighth of a second a step, so that the rate is known."""
    now = [0.0]

    class Sleeper(runners.Runner):
        steps_at_once = 10
        count = 0

        def advance(self):
            self.count += 1
            now[0] += 0.125

    monkeypatch.setattr(runners.time, "perf_counter", lambda: now[0])
    runner = Sleeper()
    assert runner.run(3.0) == 10 / 0.125
    assert runner.count >= 3.0 / 0.125


def test_comparison_with_evogym(throughput, tiny, fake_evogym, capsys):
    (row,) = rows_of(throughput, replace(tiny, against_evogym=fake_evogym), capsys)
    assert len(row["pairs"]) == 3
    assert row["ratio"] == sorted(row["pairs"])[1]
    assert row["evogym_env_steps_per_s"] > 0


@pytest.mark.slow
def test_comparison_with_a_process_for_each_world(throughput, tiny, capsys):
    (row,) = rows_of(throughput, replace(tiny, through="sb3", worlds=2, against_subproc=True), capsys)
    assert len(row["pairs"]) == 3
    assert row["subproc_env_steps_per_s"] > 0


def test_an_interpreter_without_evogym_is_refused(throughput, tiny, tmp_path):
    empty = tmp_path / "python"
    empty.write_text("#!/bin/sh\nexit 1\n", encoding="utf-8")
    empty.chmod(0o755)
    with pytest.raises(RuntimeError, match="evogym could not be run"):
        throughput.main(replace(tiny, against_evogym=empty))


def test_comparison_with_one_thread(throughput, tiny):
    (case,) = throughput.cases(replace(tiny, worlds=9, threads=2))
    row = throughput.measure(replace(case, with_one_thread=True), tiny)
    assert len(row["pairs"]) == 3
    assert "x" in throughput.table_line(row)


def test_comparison_with_the_simulator(throughput, tiny):
    (case,) = throughput.cases(tiny)
    row = throughput.measure(replace(case, with_simulator=True), tiny)
    assert row["over_simulator"] == sorted(row["pairs"])[1]


def test_the_table_names_what_was_measured(throughput, tiny, fake_evogym, capsys):
    throughput.main(replace(tiny, against_evogym=fake_evogym, body="HHHHHHHHHHHHHHHHHHHHHHHHHHHHHHHHHH"))
    captured = capsys.readouterr()
    assert captured.out.startswith("Walker-v0")
    assert "1x34 body" in captured.out
    assert "EvoGym" in captured.out
    assert "Walker-v0 through core" in captured.err  # progress stays apart from results
