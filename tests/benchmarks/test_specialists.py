"""The experiment with specialists: whole and stopped jobs, and the table."""

import json
from dataclasses import replace

import pytest

from benchmarks.experiments.specialists import SIZES, SpecialistsOfEvolution
from evogymcm.algos.codesign import BodyPPOConfig, EvolveConfig, SpecialistConfig
from evogymcm.envs import tasks

PPO = BodyPPOConfig(64, 4, 8, epochs=1, minibatch=16, eval_interval=0, eval_starts=2, selection="robust")
TINY = SpecialistsOfEvolution(
    ("Walker-v0",),
    ("fixed", "priced"),
    seeds=(3, 4),
    evolve=EvolveConfig(shape=(3, 3), max_env_steps=120, first=8, candidates=4, survivors=3, num_threads=1),
    specialists=SpecialistConfig(count=2, ppo=PPO),
)


@pytest.mark.slow
def test_runs_end_in_a_table(tmp_path, monkeypatch):
    monkeypatch.setitem(tasks._REGISTRY, "Walker-v0", replace(tasks.as_task("Walker-v0"), time_limit=12))
    first, *others = TINY.jobs()
    told, asked = [], iter([False] * 4)
    assert not first.run(tmp_path, False, lambda *news: None, lambda: True)["finished"]
    stopped = first.run(tmp_path, True, lambda *news: None, lambda: next(asked, True))  # in the training
    assert not stopped["finished"]
    assert stopped["specialists"]["designs"] == []
    runs = [first.run(tmp_path, True, lambda *news: told.append(news), lambda: False)]
    runs += [job.run(tmp_path, False, lambda *news: told.append(news), lambda: False) for job in others]
    runs = json.loads(json.dumps(runs, allow_nan=False))
    assert all(run["finished"] for run in runs)
    assert told[-1][0] == runs[-1]["env_steps"] + 2 * 64
    rows = TINY.summarise([*runs, stopped])
    assert [(row["arm"], row["designs"]) for row in rows] == [("fixed", 4), ("priced", 4)]
    for row, group in zip(rows, (runs[::2], runs[1::2]), strict=True):
        for i, run in enumerate(group):
            designs = run["specialists"]["designs"]
            assert len({design["body"] for design in designs}) == 2
            assert row["before"]["score"][i] in [design["before"]["score"] for design in designs]
            worth = [min(d[when]["score"], d[when]["return"]) for d in designs for when in ("before", "now")]
            assert min(row["either"][i]["score"], row["either"][i]["return"]) == max(worth)
    text = TINY.table(rows)
    assert text.count("Walker-v0") == 2
    assert "of 4" in text


def test_settings_are_those_of_the_fields():
    jobs = SIZES["small"].jobs()
    assert len({job.name for job in jobs}) == len(jobs) == 6 * 5
    assert {job.specialists.count for job in jobs} == {2}
    for wrong, told in (
        ({"specialists": replace(TINY.specialists, ppo=replace(PPO, seed=1))}, "specialists.ppo.seed: got 1"),
        ({"evolve": EvolveConfig(seed=1)}, r"evolve.seed: got 1"),
        ({"arms": ("soft",)}, "arms: got"),
    ):
        with pytest.raises(ValueError, match=told):
            replace(TINY, **wrong)
