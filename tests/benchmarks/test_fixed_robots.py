"""Experiment A and the comparison of contexts: summaries, tables, figures."""

import json

import numpy as np
import pytest

from benchmarks.experiments import figures
from benchmarks.experiments.contexts import Contexts
from benchmarks.experiments.fixed_robots import FixedRobots, overall
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
        "curve": [[0, 0.1], [500, score + 0.5], [1000, score]], "env_steps_per_s": None,
    } | changes  # fmt: skip


def both_arms(seeds=3):
    """Control-only scores 8.0, 8.1 ...; co-optimisation 9.0, 9.3 ..."""
    scores = [("control-only", 8.0, 0.1), ("co-optimisation", 9.0, 0.3)]
    return [record(arm, seed, first + more * seed) for seed in range(seeds) for arm, first, more in scores]


def test_the_papers_robots_stand_on_their_tasks():
    assert {row.robot: task for task, row in PAPER.items()}.items() <= dict(robot_tasks).items()


def test_summary_keeps_last_and_best_apart():
    runs = [record("co-optimisation", 0, 9.0), record("co-optimisation", 1, 9.4), record("control-only", 0, 8.0)]
    runs.append(record("control-only", 1, 1.0, finished=False))  # counts nowhere
    control, both = A.summarise(runs)
    assert (control["seeds"], control["final_score"], control["final_score_std"]) == (1, 8.0, None)
    assert both["final_score"] == pytest.approx(9.2)
    assert both["final_score_std"] == pytest.approx(0.2828, abs=1e-4)
    assert both["best_score"] == pytest.approx(9.7)
    assert both["paper_score"] == 9.55


def test_summary_compares_the_arms():
    control, both = A.summarise(both_arms())
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


def test_all_tasks_together_count_in_the_papers_units():
    runs = both_arms() + [run | {"task": "AreaMaximizer-v0"} for run in both_arms()]
    total = overall(A.summarise(runs))
    assert total["tasks"] == ["Walker-v0", "AreaMaximizer-v0"]
    pool = sorted([8.0 / 9.46, 8.1 / 9.46, 8.2 / 9.46, 8.0 / 0.62, 8.1 / 0.62, 8.2 / 0.62])
    assert total["control-only"]["final"][0] == pytest.approx(sum(pool[1:-1]) / 4)
    assert total["improvement"]["final"][0] == 1.0


def test_tables_set_the_paper_beside_and_say_how_far_intervals_can_be_trusted():
    text = A.table(A.summarise(both_arms()))
    tables = [part.splitlines() for part in text.split("\n\n") if part.startswith("|")]
    assert [len(lines) for lines in tables] == [4, 3, 5]
    assert all(len({len(line) for line in lines}) == 1 for lines in tables)
    cells = [cell.strip() for cell in tables[0][3].strip("|").split("|")]
    assert cells == [
        "Walker-v0", "co-optimisation", "3", "1,000", "0.10", "9.30 (0.30)", "97.4%", "9.55 (0.01)", "9.80 (0.30)"
    ]  # fmt: skip
    assert "+1.20 [" in text
    assert "3 seeds an arm" in text
    assert "80% of cases" in text
    single = A.table(A.summarise(both_arms(1)))
    assert "+1.00" in single
    assert "[" not in single
    assert "One seed" in single


def test_one_arm_alone_has_nothing_to_compare():
    rows = A.summarise([record("co-optimisation", 0, 9.0)])
    assert "gain" not in rows[0]
    assert overall(rows) == {}
    assert "minus" not in A.table(rows)


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
    assert (body["arm"], body["mean"], body["scores"], body["env_steps_per_s"]) == ("body", 5.0, [4.0, 6.0], 20.0)
    assert (plain["arm"], plain["std"], plain["mean_of_curve"]) == ("mlp", None, 1.025)
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
