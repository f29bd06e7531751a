"""Experiments B and C: equal budgets, summary, table and figures."""

from dataclasses import replace

import pytest

from benchmarks.experiments.evolved_robots import ARMS, SIZES_B, SIZES_C, EvolvedRobots
from benchmarks.experiments.paper import PUBLISHED_BODIES
from evogymcm.algos.codesign import CodesignConfig, cost_of

ALL = EvolvedRobots(("Walker-v0",), ARMS, (0,))


def record(arm, seed, points, **changes):
    body = {"body": "HV/SR", "connections": None, "stiffness": [[0.5, 1.0], [2.0, 1.5]], "fitness": points[-1][1]}
    return {
        "task": "Walker-v0", "label": arm, "seed": seed, "n_designs": 4, "curve": points, "best": body,
        "best_return": 4.25,
    } | changes  # fmt: skip


PLAIN = {"body": "HHH/H.H", "connections": None, "stiffness": None, "fitness": 1.0}


@pytest.mark.parametrize("sizes", [SIZES_B, SIZES_C], ids=["B", "C"])
def test_arms_have_the_same_budget(sizes):
    for experiment in sizes.values():
        jobs = experiment.jobs()
        assert len({job.name for job in jobs}) == len(jobs)
        fields = ("population", "budget", "max_env_steps", "ppo")
        assert len({tuple(getattr(job.config, name) for name in fields) for job in jobs}) == 1
    assert sizes["paper"].codesign.budget == PUBLISHED_BODIES
    assert len(sizes["paper"].jobs()) == 36


def test_the_cost_of_a_run_counts_env_steps_of_all_kinds():
    paper = SIZES_C["paper"]
    costs = [cost_of(job.config) for job in paper.jobs()]
    assert {cost.search > 0 for cost, job in zip(costs, paper.jobs(), strict=True) if job.arm == "invariant"} == {True}
    assert paper.steps_per_run == max(cost.total for cost in costs)
    assert SIZES_B["small"].steps_per_run == 600_000


def test_returns_stand_beside_published_ones_where_as_many_bodies_were_trained():
    few = record("fixed", 0, [[100, 1.0], [200, 3.0]])
    assert "published" not in ALL.table(ALL.summarise([few]))
    shown = ALL.table(ALL.summarise([few | {"n_designs": 100}, record("reactive", 0, [[200, 3.0]])]))
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in shown.splitlines()]
    assert rows[2][-4:] == ["3.00", "200", "4.25", "10.55"]
    assert rows[3][-2:] == ["", ""]


def test_runs_are_compared_where_the_shortest_ends():
    runs = [record("fixed", 0, [[100, 1.0], [200, 3.0], [400, 7.0]]), record("fixed", 1, [[150, 2.0], [300, 4.0]])]
    runs.append(record("reactive", 0, [[120, 5.0], [350, 6.0]]))
    fixed, reactive = ALL.summarise(runs)
    assert (fixed["scores"], fixed["env_steps"]) == ([3.0, 4.0], 300)
    assert reactive["scores"] == [5.0]
    assert (fixed["ends"], fixed["end_steps"], reactive["ends"]) == ([7.0, 4.0], 350, [6.0])
    shown = ALL.table([fixed, reactive])
    assert "3.50 (0.71)" in shown
    assert "7.00 4.00" in shown


def cells(text):
    """The cells of each line of all tables of a text, by the first two of them."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if "|" in line]
    return {tuple(line[:2]): line[2:] for line in lines}


def test_best_designs_are_measured_and_compared_by_seed():
    bodies = {"fixed": ("HHH/H.H", "HHH/HHH"), "reactive": ("H../H..", "HH./HH."), "invariant": ("HHH/H.H", "HHH/HHH")}
    field = [[0.5, 2.0, 0.5], [2.0, 1.0, 2.0]]
    runs = [
        record(arm, i, [[1, 1.0]], best=PLAIN | {"body": body, "stiffness": field if arm == "invariant" else None})
        for arm in ARMS
        for i, body in reversed(list(enumerate(bodies[arm])))
    ]
    alone = record("reactive", 7, [[100, 1.0]], best=runs[0]["best"])  # without its pair
    shown = cells(ALL.table(ALL.summarise([*runs, alone])))
    assert shown["Walker-v0", "fixed"][-6:] == [
        "5.50 (0.71)", "3.00 (0.00)", "2.00 (0.00)", "1.50 (0.71)", "2.00 (1.41)", "1.50 (0.71)",
    ]  # fmt: skip
    assert shown["Walker-v0", "reactive"][0] == "3"
    gains = shown["Walker-v0", "2"]  # of the table that comes last, invariant minus fixed
    assert gains[0] == "+0.00 [+0.00, +0.00]"
    only = cells(ALL.table(ALL.summarise([run for run in runs if run["label"] != "invariant"])))
    assert only["Walker-v0", "2"][:2] == ["-2.50 [-3.00, -2.00]", "-1.50 [-2.00, -1.00]"]
    assert only["P, mean over tasks", "2"][0] == "0.00 [0.00, 0.00]"
    # The middle column over the rest: 2, and sqrt(2). Below over above: 2 over 2^(-1/3), and 2^(2/3) over that.
    assert shown["Walker-v0", "invariant"] == ["2", "1.68 [1.41, 2.00]", "2", "2.24 [2.00, 2.52]", "2"]


def test_the_share_of_policies_that_anticipate():
    def played(seed, low, high, impacts=20):
        signals = {"n_impacts": impacts, "rise_interval": (low, high)}
        return record("reactive", seed, [[100, 1.0]], signals=signals)

    runs = [played(0, 0.1, 0.2), played(1, -0.1, 0.2), played(2, -0.3, -0.1), played(3, 0.1, 0.2, impacts=9)]
    text = ALL.table(ALL.summarise(runs))
    assert cells(text)["Walker-v0", "3 of 4"] == ["1", "33% [6%, 79%]", "1", "33% [6%, 79%]"]
    assert "all tasks" not in text
    assert "impact" not in ALL.table(ALL.summarise([record("fixed", 0, [[100, 1.0]])]))


def test_figures_leave_out_runs_stopped_before_their_first_score(tmp_path):
    image = pytest.importorskip("matplotlib.image")
    early = record("fixed", 0, [[100, 1.0]], best=None, curve=[])
    ALL.plot([early], tmp_path / "curves.png")
    assert not list(tmp_path.iterdir())
    assert ALL.summarise([early]) == []
    runs = [record(arm, seed, [[100, 1.0], [200, 2.0 + seed]]) for arm in ARMS for seed in range(2)]
    ALL.plot([early, *runs], tmp_path / "curves.png")
    few = [record("invariant", 0, [[100, 1.0]]), record("fixed", 0, [[100, 1.0]], best=PLAIN)]
    ALL.plot(few, tmp_path / "few.png")  # too few for a mean in any cell
    for name in ("curves.png", "curves-designs.png", "curves-stiffness.png", "few-stiffness.png"):
        assert image.imread(tmp_path / name).std() > 0.02


def test_settings_that_arms_decide_are_not_set_beside_them():
    with pytest.raises(ValueError, match="comes from tasks"):
        replace(ALL, codesign=replace(ALL.codesign, task="BridgeWalker-v0"))
    with pytest.raises(ValueError, match="here arms decide"):
        replace(ALL, codesign=CodesignConfig())
    fixed, reactive, invariant = (job.config for job in ALL.jobs())
    assert (fixed.material, fixed.search, reactive.material) == ("invariant", None, "reactive")
    assert invariant == replace(fixed, search=invariant.search)
