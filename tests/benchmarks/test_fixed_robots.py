"""Experiment A and the comparison of contexts: summaries, tables, figures."""

import json

import numpy as np
import pytest

from benchmarks.experiments import figures
from benchmarks.experiments.contexts import Contexts
from benchmarks.experiments.fixed_robots import FixedRobots
from benchmarks.experiments.paper import PAPER
from benchmarks.experiments.training import mean_of_curve, rate
from evogymcm import robot_tasks
from evogymcm.algos.analysis import Recording, analyse_signals

A = FixedRobots()


def record(arm, seed, score, *, finished=True, **changes):
    """What a run on Walker-v0 returns."""
    return {
        "task": "Walker-v0", "label": arm, "seed": seed, "finished": finished, "env_steps": 1000,
        "final": {"score": score, "return": score + 1, "fraction_of_ceiling": score / 9.55} if finished else None,
        "curve": [[0, 0.1], [500, score + 0.5], [1000, score]], "times": [1.0, 6.0, 9.0], "env_steps_per_s": None,
    } | changes  # fmt: skip


def both_arms(seeds=3):
    """Control-only scores 8.0, 8.1 ...; co-optimisation 9.0, 9.3 ..."""
    scores = [("control-only", 8.0, 0.1), ("co-optimisation", 9.0, 0.3)]
    return [record(arm, seed, first + more * seed) for seed in range(seeds) for arm, first, more in scores]


def test_the_papers_robots_stand_on_their_tasks():
    assert {row.robot: task for task, row in PAPER.items()}.items() <= dict(robot_tasks).items()


def test_runs_begin_afresh_as_in_the_paper_or_with_what_is_asked_for():
    assert A.settings("Walker-v0", "reactive", 1).initial == "fresh"
    assert FixedRobots(initial="auto").settings("Walker-v0", "reactive", 1).initial == "auto"
    with pytest.raises(ValueError, match=r"policy: no-such has none of"):
        FixedRobots(initial="no-such")


def cells(text):
    """The cells of all tables of a text, table by table."""
    tables = [part.splitlines() for part in text.split("\n\n") if part.startswith("|")]
    assert all(len({len(line) for line in lines}) == 1 for lines in tables)  # columns stand one under another
    return [[[cell.strip() for cell in line.strip("|").split("|")] for line in lines] for lines in tables]


def test_summary_keeps_last_and_best_apart_and_leaves_unfinished_runs_out():
    runs = [record("co-optimisation", 0, 9.0), record("co-optimisation", 1, 9.4), record("control-only", 0, 8.0)]
    runs.append(record("control-only", 1, 1.0, finished=False))
    control, both = A.summarise(runs)
    assert (control["final"], control["best"], control["paper_score"]) == ([8.0], [8.5], 9.46)
    assert (both["final"], both["best"], both["untrained"]) == ([9.0, 9.4], [9.5, 9.9], 0.1)
    assert both["fraction_of_ceiling"] == pytest.approx(9.2 / 9.55)
    json.dumps([control, both], allow_nan=False)


def test_the_papers_score_is_reached_when_half_of_the_runs_have_reached_it():
    three = [record("control-only", seed, score) for seed, score in enumerate((9.5, 8.0, 9.0))]  # the paper's: 9.46
    (row,) = A.summarise(three)
    assert (row["steps_to_paper"], row["seconds_to_paper"]) == (500, 6.0)
    (row,) = A.summarise(three[1:2])
    assert (row["steps_to_paper"], row["seconds_to_paper"]) == (None, None)
    assert cells(A.table([row]))[0][2][-2:] == ["-", "-"]


def test_all_tasks_together_count_in_the_papers_units():
    runs = both_arms() + [run | {"task": "AreaMaximizer-v0"} for run in both_arms()]
    head, _, control, _, chance = cells(A.table(A.summarise(runs)))[2]
    assert head[0] == "over 2 tasks"
    pool = sorted([8.0 / 9.46, 8.1 / 9.46, 8.2 / 9.46, 8.0 / 0.62, 8.1 / 0.62, 8.2 / 0.62])
    assert control[1].startswith(f"{sum(pool[1:-1]) / 4:.2f} [")
    assert chance[1] == "1.00 [1.00, 1.00]"


def test_tables_set_the_paper_beside_and_say_how_far_intervals_can_be_trusted():
    text = A.table(A.summarise(both_arms()))
    scores, gains, overall = cells(text)
    assert [len(scores), len(gains), len(overall)] == [4, 3, 5]
    assert scores[3] == [
        "Walker-v0", "co-optimisation", "3", "1,000", "0.10", "9.30 (0.30)", "97.4%", "9.55 (0.01)", "9.80 (0.30)",
        "500", "6",
    ]  # fmt: skip
    task, seeds, final, chance, best, best_chance, paper = gains[2]
    assert (task, seeds, chance, best_chance, paper) == ("Walker-v0", "3", "1.00", "1.00", "+0.09")
    low, high = map(float, final.removeprefix("+1.20 [").removesuffix("]").split(", "))
    assert 9.0 - 8.2 <= low < 1.2 < high <= 9.6 - 8.0
    assert best == final  # each best is half a point above the last
    assert "With 3 seeds an arm they are too narrow" in text
    assert "80% of cases" in text
    single = A.table(A.summarise(both_arms(1)))
    assert "+1.00" in single
    assert "[" not in single
    assert "One seed" in single


def test_one_arm_alone_has_nothing_to_compare():
    assert len(cells(A.table(A.summarise([record("co-optimisation", 0, 9.0)])))) == 1


def test_contexts_have_the_same_budget_and_settings_of_their_own():
    jobs = Contexts().jobs()
    assert len({job.name for job in jobs}) == len(jobs) == 2 * 5 * 3
    assert {(job.arm, job.config.ppo.network, job.config.ppo.context) for job in jobs} == {
        ("none", "voxel", "none"), ("body", "voxel", "body"), ("message", "voxel", "message"),
        ("attention", "voxel", "attention"), ("mlp", "mlp", "body"),
    }  # fmt: skip
    assert {(job.config.ppo.total_steps, job.config.material) for job in jobs} == {(1_000_000, "reactive")}
    assert {job.config.material for job in Contexts(material="invariant").jobs()} == {"invariant"}


def test_contexts_are_summarised_over_finished_runs():
    runs = [record("mlp", 0, 1.0), record("body", 0, 4.0, env_steps_per_s=10.0)]
    runs += [record("body", 1, 6.0, env_steps_per_s=30.0), record("none", 0, 9.0, finished=False)]
    body, plain = Contexts().summarise(runs)
    assert (body["arm"], body["scores"], body["env_steps_per_s"]) == ("body", [4.0, 6.0], 20.0)
    assert (plain["arm"], plain["scores"], plain["mean_of_curve"]) == ("mlp", [1.0], 1.025)
    assert "5.00 (1.41)" in Contexts().table([body, plain])


def test_mean_of_curve_is_the_area_over_env_steps():
    assert mean_of_curve([[0, 0.0], [100, 4.0], [400, 4.0]]) == pytest.approx(3.5)
    assert mean_of_curve([[0, 2.5]]) == 2.5


def test_rates_leave_out_the_first_update_and_evaluations():
    rows = [{"seconds": 1.0, "score": 0.0}, {"seconds": 9.0}, {"seconds": 11.0}, {"seconds": 16.0, "score": 1.0}]
    assert rate([*rows, {"seconds": 21.0}, {"seconds": 24.0}], 60) == 20.0  # of 2, 5 and 3 seconds
    assert rate(rows[:2], 60) is None


def test_figures(tmp_path):
    image = pytest.importorskip("matplotlib.image")
    for steps in (150, 1):
        t = np.arange(steps)
        both = 1 + 0.3 * np.stack([np.sin(t / 3), np.cos(t / 3)], 1)
        actuation = np.where([True, False], both, np.nan)
        contact = np.stack([t % 20 < 8, t < 0], 1)
        cells, is_actuator = np.array([[0, 0], [1, 2]]), np.array([True, False])
        recording = Recording("Walker-v0", cells, is_actuator, actuation, both, contact, 1.0)
        figures.signals(analyse_signals(recording), tmp_path / f"signals-{steps}.png")
    A.plot(both_arms(2), tmp_path / "curves.png")
    A.plot([record("control-only", 0, 1.0, curve=[])], tmp_path / "nothing.png")
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["curves.png", "signals-1.png", "signals-150.png"]  # no unfinished file
    assert all(image.imread(path).std() > 0.02 for path in tmp_path.iterdir())
