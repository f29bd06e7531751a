"""The experiment with evolved gaits: jobs, whole and stopped ones, the tables, and what counts as reached."""

import json
from dataclasses import replace

import pytest

from benchmarks.experiments.evolved_gaits import SIZES, EvolvedGaits, mean_of_steps
from evogymcm.algos.codesign import EvolveConfig
from evogymcm.envs import tasks

SHORT = replace(tasks.as_task("Walker-v0"), time_limit=12)
TINY = EvolvedGaits(
    ("Walker-v0",),
    seeds=(3, 4),
    evolve=EvolveConfig(
        shape=(3, 3), max_env_steps=300, first=8, candidates=4, survivors=3, eval_starts=2, num_threads=1
    ),
)


def test_jobs_are_all_tasks_in_all_arms_with_equal_env_steps():
    jobs = SIZES["small"].jobs()
    assert len({job.name for job in jobs}) == len(jobs) == 6 * 3 * 5
    assert {(job.arm, job.config.material, job.config.evolves_stiffness) for job in jobs} == {
        ("fixed", "invariant", False),
        ("reactive", "reactive", False),
        ("invariant", "invariant", True),
    }
    assert {job.config.max_env_steps for job in jobs} == {SIZES["small"].steps_per_run}
    with pytest.raises(ValueError, match=r"evolve.seed: got 1"):
        EvolvedGaits(evolve=EvolveConfig(seed=1))


def test_runs_end_in_tables(tmp_path, monkeypatch):
    monkeypatch.setitem(tasks._REGISTRY, "Walker-v0", SHORT)
    told, runs = [], []
    first = TINY.jobs()[0]
    assert not first.run(tmp_path, False, lambda *news: None, lambda: True)["finished"]
    for job in TINY.jobs():
        run = job.run(tmp_path, job == first, lambda *news: told.append(news), lambda: False)
        assert run["finished"]
        runs.append(json.loads(json.dumps(run, allow_nan=False)))
    assert first.run(tmp_path, True, lambda *news: None, lambda: False)["best"] == runs[0]["best"]
    assert told[-1][1] == runs[-1]["best"]["fitness"]
    assert all(bool(run.get("signals")) == (run["label"] == "reactive") for run in runs)
    rows = TINY.summarise([*runs, runs[0] | {"finished": False}])
    assert [(row["arm"], row["reached"], len(row["scores"])) for row in rows] == [
        ("fixed", 0, 2), ("reactive", 0, 2), ("invariant", 0, 2)
    ]  # fmt: skip
    assert rows[0]["returns"] == [run["best"]["return"] for run in runs if run["label"] == "fixed"]
    text = TINY.table(rows)
    assert "reactive minus fixed" in text
    for run in runs:
        values = [value for _, value in run["returns"]]
        assert values[:-1] == sorted(set(values[:-1]))  # of what stands still, only the end
        assert run["curve"][-1][1] == max(value for _, value in run["curve"])
    assert "0 of 2" in text
    work = [
        line.split("|")[1:-1] for line in text.splitlines()[text[: text.index("work of best")].count("\n") + 2 :][:3]
    ]
    assert [cells[1].strip() for cells in work] == ["fixed", "reactive", "invariant"]
    assert [int(cells[4]) > 0 for cells in work] == [False, True, False]  # of stiffness
    pytest.importorskip("matplotlib")
    TINY.plot(runs, tmp_path / "curves.png")
    assert (tmp_path / "curves-designs.png").stat().st_size > 0


def test_a_curve_counts_from_each_point_on():
    assert mean_of_steps([[10, 1.0], [20, 3.0], [120, 9.0]], 40) == (10 * 1 + 20 * 3) / 40
    assert mean_of_steps([[50, 2.0]], 40) == 0.0


def test_published_returns_are_reached_where_a_return_is_at_least_as_high():
    best = {
        "fitness": 9.0,
        "robust_score": 8.9,
        "return": 10.2,
        "seed": 0,
        "body": "H",
        "connections": None,
        "stiffness": None,
    }
    told = {
        "task": "Walker-v0",
        "label": "fixed",
        "finished": True,
        "best": best,
        "env_steps": 50,
        "played": 9,
        "curve": [[10, 3.0]],
    }
    runs = [
        told | {"seed": 0, "seconds": 1.0, "returns": [[10, 3.0], [20, 10.55], [30, 10.6]]},
        told | {"seed": 1, "seconds": 1.0, "returns": [[10, 3.0], [40, 10.7]]},
        told | {"seed": 2, "seconds": None, "returns": [[10, 3.0], [40, 10.5]]},
    ]
    (row,) = EvolvedGaits().summarise(runs)
    assert (row["reached"], row["steps_to_published"], row["returns"]) == (2, 30, [10.2] * 3)
    (row,) = EvolvedGaits().summarise(runs[1:])
    assert (row["reached"], row["steps_to_published"]) == (1, None)
