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


def test_figures_leave_out_runs_stopped_before_their_first_score(tmp_path):
    image = pytest.importorskip("matplotlib.image")
    early = record("fixed", 0, [[100, 1.0]], best=None, curve=[])
    ALL.plot([early], tmp_path / "curves.png")
    assert not list(tmp_path.iterdir())
    assert ALL.summarise([early]) == []
    runs = [record(arm, seed, [[100, 1.0], [200, 2.0 + seed]]) for arm in ARMS for seed in range(2)]
    ALL.plot([early, *runs], tmp_path / "curves.png")
    for name in ("curves.png", "curves-designs.png"):
        assert image.imread(tmp_path / name).std() > 0.02


def test_settings_that_arms_decide_are_not_set_beside_them():
    with pytest.raises(ValueError, match="comes from tasks"):
        replace(ALL, codesign=replace(ALL.codesign, task="BridgeWalker-v0"))
    with pytest.raises(ValueError, match="here arms decide"):
        replace(ALL, codesign=CodesignConfig())
    fixed, reactive, invariant = (job.config for job in ALL.jobs())
    assert (fixed.material, fixed.search, reactive.material) == ("invariant", None, "reactive")
    assert invariant == replace(fixed, search=invariant.search)
