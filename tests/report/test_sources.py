"""What lies in folders, and which runs are seeds of one arm."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from evogymcm.algos import RunFolder
from evogymcm.algos.codesign import Codesign, SearchConfig
from evogymcm.algos.runs import RunRecord
from evogymcm.report.sources import make_arms, read_source, read_sources
from tests.report.conftest import TINY

RESULTS = sorted(
    path
    for path in (Path(__file__).resolve().parents[2] / "benchmarks" / "results").glob("*/results.json")
    if "kind" in json.loads(path.read_text(encoding="utf-8"))["runs"][0]  # others hold scores of policies, no runs
)


def test_a_training_run(training):
    source = read_source(training / "reactive-1")
    (run,) = source.runs
    assert (source.kind, source.planned) == ("training run", None)
    assert run.kind == "train"
    assert (run.task, run.label, run.seed, run.body) == ("Dart-v0", "reactive", 1, "HVH/S.R")
    assert (run.finished, run.env_steps) == (True, 64)
    rows = [json.loads(line) for line in (training / "reactive-1" / "curve.jsonl").read_text().splitlines()]
    scores = [row["score"] for row in rows if "score" in row]
    assert len(scores) == 3
    assert (run.untrained, run.final_of("score"), run.best_score) == (scores[0], scores[-1], max(scores))
    assert run.final_of("return") == rows[-1]["return"]


def test_a_stopped_training_run_has_no_final_score(training, tmp_path):
    folder = tmp_path / "stopped"
    shutil.copytree(training / "reactive-0", folder)
    for name in ("final.pt", "result.json"):
        (folder / name).unlink()
    table = folder / "curve.jsonl"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:-1]) + '{"env_steps": 64, "sco')
    (run,) = read_source(folder).runs
    assert (run.finished, run.final, run.env_steps) == (False, None, 32)
    assert run.best_score is not None


def test_a_co_design_run(evolved):
    source = read_source(evolved / "invariant-0")
    (run,) = source.runs
    assert source.kind == "co-design run"
    assert run.kind == "codesign"
    assert (run.label, run.seed, run.n_designs, run.finished) == ("invariant", 0, 6, True)
    rows = [json.loads(line) for line in (evolved / "invariant-0" / "curve.jsonl").read_text().splitlines()]
    assert len(rows) > 6
    assert run.curve[-1] == (rows[-1]["env_steps"], rows[-1]["best"])
    assert run.ranked()[0]["fitness"] == rows[-1]["best"] == max(row["fitness"] for row in rows)


def test_a_suite_by_its_results_alone(suite):
    source = read_source(suite)
    assert (source.kind, source.planned, len(source.runs)) == ("experiment A", 6, 6)
    assert source.paper["Walker-v0", "control-only"] == (9.46, 0.03)
    control, both = make_arms([source])
    assert [run.final_of("score") for run in both.runs] == [9.0, 9.25, 9.5]
    assert [run.best_score for run in control.runs] == [8.5, 8.75, 9.0]
    assert control.paper == {"Walker-v0": (9.46, 0.03)}


def test_a_suite_under_way_is_read_from_its_folders(evolved, tmp_path):
    folder = tmp_path / "under-way"
    shutil.copytree(evolved, folder)
    config = {"experiment": "C", "tasks": ["Dart-v0"], "arms": ["prescribed", "invariant"], "seeds": [0, 1]}
    (folder / "config.json").write_text(json.dumps(config))
    source = read_source(folder)
    assert (source.kind, source.planned, len(source.runs)) == ("experiment C", 4, 3)


@pytest.mark.parametrize("folder", [path.parent for path in RESULTS], ids=lambda path: path.name)
def test_results_of_the_repository_are_shown_whole(folder):
    recorded = json.loads((folder / "results.json").read_text())
    source = read_source(folder)
    assert len(source.runs) == len(recorded["runs"])
    assert [run.finished for run in source.runs].count(True) == [run["finished"] for run in recorded["runs"]].count(
        True
    )
    arms = make_arms([source])
    assert sorted(id(run) for arm in arms for run in arm.runs) == sorted(map(id, source.runs))
    assert len({arm.label for arm in arms}) == len(arms)
    if folder.name == "contexts":
        assert (source.kind, source.planned) == ("experiment contexts", 20)
        assert [(arm.label, len(arm.runs)) for arm in arms] == [
            (variant, 4) for variant in ("none", "body", "message", "attention", "mlp")
        ]


@pytest.mark.parametrize("method", ["ga", "random", "qd"])
def test_co_design_is_finished_when_it_is(tmp_path, method):
    if method == "qd":
        pytest.importorskip("ribs")
    short = replace(TINY.ppo, total_steps=32, eval_interval=0)
    config = replace(TINY, material="invariant", search=SearchConfig(rounds=1), method=method, budget=4, ppo=short)
    state, seen = Codesign(config, RunFolder(tmp_path / "run", asdict(config))), []
    while not state.is_finished:
        assert state.advance()
        run = RunRecord.read(tmp_path / "run")
        assert run.finished == state.is_finished
        seen.append(run.n_designs)
    assert seen[-1] == 4
    (tmp_path / "run" / "codesign.pt").write_bytes(b"nonsense")
    with pytest.raises(ValueError, match="not the state of a co-design run"):
        RunRecord.read(tmp_path / "run")


def test_files_of_a_run_are_newer_than_what_an_earlier_sitting_said(training, tmp_path):
    folder = tmp_path / "reactive-0"
    shutil.copytree(training / "reactive-0", folder)
    early = {"task": "Dart-v0", "seed": 0, "finished": False, "env_steps": 32, "train_seconds": 0.0, "final": None}
    (folder / "result.json").write_text(json.dumps(early))
    run, whole = RunRecord.read(folder), RunRecord.read(training / "reactive-0")
    final = {name: value for name, value in whole.final.items() if name != "ceiling"}
    assert run == replace(whole, path=folder, final=final, origin={}, initial=None)
    (folder / "result.json").write_text(json.dumps(early | {"finished": True, "final": {"score": 7.0}}))
    assert RunRecord.read(folder, early).final_of("score") == 7.0  # the folder's record is newer than the suite's


def test_seeds_of_equal_settings_are_one_arm(training):
    arms = make_arms([read_source(training)])
    assert [(arm.label, len(arm.runs)) for arm in arms] == [("invariant", 2), ("reactive", 2)]
    assert len({arm.colour for arm in arms}) == 2
    apart = make_arms(read_sources([training / "reactive-0", training / "reactive-1"]))
    assert [(arm.label, len(arm.runs)) for arm in apart] == [("reactive", 2)]


def test_the_same_seed_twice_and_other_settings_stay_apart(training, tmp_path):
    shutil.copytree(training / "reactive-0", tmp_path / "again")
    arms = make_arms(read_sources([training / "reactive-0", tmp_path / "again"]))
    assert [arm.label for arm in arms] == ["reactive (reactive-0)", "reactive (again)"]
    config = json.loads((tmp_path / "again" / "config.json").read_text())
    config["ppo"] |= {"seed": 5, "learning_rate": 0.5}
    (tmp_path / "again" / "config.json").write_text(json.dumps(config))
    arms = make_arms(read_sources([training / "reactive-0", tmp_path / "again"]))
    assert [len(arm.runs) for arm in arms] == [1, 1]


def test_the_same_run_twice_in_one_folder_is_not_two_seeds(training, tmp_path):
    for name in ("one", "two"):
        shutil.copytree(training / "reactive-0", tmp_path / name)
    arms = make_arms([read_source(tmp_path, "both")])
    assert [(arm.label, len(arm.runs)) for arm in arms] == [("reactive (both/one)", 1), ("reactive (both/two)", 1)]


def test_equal_folder_names_are_told_apart(training, tmp_path):
    shutil.copytree(training / "reactive-0", tmp_path / "reactive-0")
    names = [source.name for source in read_sources([training / "reactive-0", tmp_path / "reactive-0"])]
    assert names == [f"{training.name}/reactive-0", f"{tmp_path.name}/reactive-0"]


def test_what_cannot_be_used_is_refused(training, tmp_path):
    with pytest.raises(ValueError, match="got none"):
        read_sources([])
    with pytest.raises(ValueError, match="more than once"):
        read_sources([training, training / "reactive-0" / ".."])
    with pytest.raises(ValueError, match="not a folder"):
        read_source(tmp_path / "missing")
    with pytest.raises(ValueError, match="holds neither a run"):
        read_source(tmp_path)
    (tmp_path / "curve.jsonl").write_text("")
    with pytest.raises(ValueError, match="without any score"):
        read_source(tmp_path)
    (tmp_path / "curve.jsonl").write_text("{]\n")
    with pytest.raises(ValueError, match="not a table of JSON rows"):
        read_source(tmp_path)
    (tmp_path / "config.json").write_text("{")
    with pytest.raises(ValueError, match="not JSON"):
        read_source(tmp_path)
    (tmp_path / "config.json").write_text("[1]")
    with pytest.raises(ValueError, match="got list, expected a JSON object"):
        read_source(tmp_path)
