"""The experiment with open-loop gaits: jobs, whole and stopped ones, what counts as reaching the paper's score."""

import json
from dataclasses import replace

import pytest

from benchmarks.experiments.gaits import SIZES, Gaits
from evogymcm import robots
from evogymcm.algos.gaits import GaitConfig
from evogymcm.algos.learning.bodies import held_out_bodies
from evogymcm.envs import tasks

SHORT = replace(tasks.as_task("Walker-v0"), time_limit=6)
TINY = Gaits(
    ("Walker-v0",), ("co-optimisation",), (3,), short_steps=100, held_out=2,
    gait=GaitConfig(env_steps=200, first=4, candidates=2, trial_steps=3),
)  # fmt: skip


def record(seed, scores, curves, **changes):
    """What searches for Walk_Bot return, with curves of (env-steps, seconds, length of trials, score)."""
    budgets = (50_000, 250_000)
    searches = [
        {"budget": budget, "scores": [score], "robust": [score - 1], "curve": curve}
        for budget, score, curve in zip(budgets, scores, curves, strict=False)
    ]
    told = {"task": "Walker-v0", "label": "control-only", "seed": seed, "finished": True, "bodies": ["H"]}
    return told | {"searches": searches} | changes


def test_jobs_are_those_of_table_one_and_random_bodies():
    jobs = SIZES["small"].jobs()
    assert len({job.name for job in jobs}) == len(jobs) == 6 * 2 * 5 + 64 // 4
    assert {job.searches[0].seed for job in jobs} == {0, 1, 2, 3, 4}
    assert jobs[0].bodies == (robots["Walk_Bot"].text,)
    assert {tuple(search.env_steps for search in job.searches) for job in jobs[:60]} == {(50_000, 250_000)}
    assert [text for job in jobs[60:] for text in job.bodies] == [body.text for body in held_out_bodies((5, 5))]
    assert {tuple(search.env_steps for search in job.searches) for job in jobs[60:]} == {(50_000,)}
    assert SIZES["small"].steps_per_run == 300_000


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gait": GaitConfig(env_steps=250_000, seed=1)}, "gait.seed"),
        ({"short_steps": 250_000}, "short_steps"),
        ({"held_out": 65}, "held_out"),
    ],
)
def test_bad_settings_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Gaits(**changes)


def test_a_job_is_done_once_and_starts_anew_where_it_was_stopped(tmp_path, monkeypatch):
    monkeypatch.setitem(tasks._REGISTRY, "Walker-v0", SHORT)
    robot, random = TINY.jobs()
    told = []
    calls = iter([False, False, True])
    stopped = robot.run(tmp_path, False, lambda *news: None, lambda: next(calls))
    assert (stopped["finished"], TINY.summarise([stopped])) == (False, [])
    assert not (tmp_path / robot.name / "result.json").exists()
    done = robot.run(tmp_path, True, lambda *news: told.append(news), lambda: False)
    short, long = done["searches"]
    assert short["env_steps"] <= 100 < long["env_steps"] <= 200
    assert [length for *_, length, _ in long["curve"]] == sorted(length for *_, length, _ in long["curve"])
    assert {length for *_, length, _ in long["curve"]} == {3, 6}
    assert long["curve"][-1][0] == long["env_steps"]
    assert done["env_steps"] == short["env_steps"] + long["env_steps"]
    assert long["scores"][0] == pytest.approx(
        long["curve"][-1][-1], abs=1e-4
    )  # of whole episodes, from the exact start
    assert long["robust"] != long["scores"]
    again = robot.run(tmp_path, True, lambda *news: told.append(news), lambda: True)
    assert again == json.loads(json.dumps(done))
    assert told[-1][0] == done["env_steps"]
    of_bodies = random.run(tmp_path, False, lambda *news: None, lambda: False)
    rows = TINY.summarise([done, of_bodies])
    assert [row.get("held_out") for row in rows] == [None, 2]
    assert rows[1]["scores"] == of_bodies["searches"][0]["scores"]
    json.dumps(rows, allow_nan=False)


def test_the_papers_score_is_reached_by_whole_trials_of_the_shorter_search():
    early = [10_000, 1.0, 150, 9.9]  # a trial that is no whole episode
    runs = [
        record(0, (9.5, 9.6), ([early, [30_000, 3.0, 500, 9.5]], [])),
        record(
            1, (9.0, 9.6), ([early, [30_000, 3.0, 500, 9.0]], [[130_000, 14.0, 500, 9.2], [140_000, 15.0, 500, 9.6]])
        ),
        record(2, (9.0, 9.1), ([early, [50_000, 5.0, 500, 9.0]], [[130_000, 14.0, 500, 9.1]])),
    ]
    (row,) = Gaits().summarise(runs)
    assert (row["reached"], row["steps_to_paper"], row["seconds_to_paper"]) == (2, 140_000, 15.0)
    (row,) = Gaits().summarise([runs[0], runs[2], record(3, (1.0, 1.0), ([], []), finished=False)])
    assert (row["reached"], row["steps_to_paper"]) == (1, None)
    text = Gaits().table([row])
    assert "fairer" in text.split("\n\n")[0]
    assert [cell.strip() for cell in text.splitlines()[-1].strip("|").split("|")] == [
        "Walker-v0", "control-only", "2", "9.25 (0.35)", "8.25 (0.35)", "9.35 (0.35)", "8.35 (0.35)",
        "9.46 (0.03)", "1 of 2", "-", "-",
    ]  # fmt: skip


def test_random_bodies_have_a_table_of_their_own_and_no_curve(tmp_path):
    bodies = [record(0, [scores[0]], [[]], bodies=["H", "V"]) for scores in ((1.0,), (4.0,))]
    for run, scores in zip(bodies, ([1.0, 2.0], [4.0, 5.0]), strict=True):
        run["searches"][0] |= {"scores": scores, "robust": [score / 2 for score in scores]}
    (row,) = Gaits().summarise(bodies)
    line = Gaits().table([row]).splitlines()[-1].strip("|").split("|")
    assert [cell.strip() for cell in line if "to" not in cell] == [
        "4 of Walker-v0", "control-only", "50,000", "3.00", "3.00", "1.50"
    ]  # fmt: skip
    pytest.importorskip("matplotlib")
    Gaits().plot(bodies, tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()
    Gaits().plot([record(0, (9.0, 9.1), ([], [[10, 1.0, 150, 3.0], [20, 2.0, 500, 9.1]]))], tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 0
