"""Specialists: whose they are, that they are trained alone, and what is told of them."""

from dataclasses import replace

import numpy as np
import pytest

from evogymcm.algos import RunFolder, RunRecord, load_policy
from evogymcm.algos.codesign import (
    BodyPPOConfig,
    CodesignConfig,
    EvolveConfig,
    SpecialistConfig,
    codesign,
    evolve,
    score_alone,
    specialise,
)
from evogymcm.algos.codesign.start import env_maker
from evogymcm.envs import tasks

PPO = BodyPPOConfig(64, 4, 8, epochs=1, minibatch=16, eval_interval=32, eval_starts=2, selection="robust")
CONFIG = SpecialistConfig(count=2, ppo=PPO)
EVOLUTION = EvolveConfig(
    shape=(3, 3), max_env_steps=120, first=12, candidates=4, survivors=4, eval_starts=2, seed=3, num_threads=1
)


@pytest.fixture(autouse=True)
def _short(monkeypatch, tmp_path):
    monkeypatch.setitem(tasks._REGISTRY, "Walker-v0", replace(tasks.as_task("Walker-v0"), time_limit=12))
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("changes", [{"material": "reactive", "work_weight": (0.0, 1e-3)}, {"evolves_stiffness": True}])
def test_the_best_survivors_get_policies_of_their_own(changes):
    evolved = evolve(replace(EVOLUTION, **changes), run="run")
    told = []
    found = specialise("run", CONFIG, progress=told.append, num_threads=1)
    assert found.finished
    assert found.rows[0]["index"] == evolved.best.index
    assert len({design.key for design in found.designs}) == 2
    assert told[-1].env_steps == 2 * 64
    assert found.env_steps > 2 * 64
    record = RunRecord.read("run/specialists")
    assert (record.kind, record.material, record.finished) == ("train", changes.get("material", "invariant"), True)
    assert record.bodies == tuple(row["body"] for row in found.rows)
    for i, (row, design) in enumerate(zip(found.rows, found.designs, strict=True)):
        before, now = found.table()[i]["before"], found.table()[i]["now"]
        assert before == {"score": row["robust_score"], "return": row["return"]}
        config = CodesignConfig(material=record.material, num_threads=1)
        alone = score_alone(env_maker(config), [design], [found.policies[i]], starts=8)
        assert (now["score"], now["return"]) == (alone.robust[0], alone.returns[0])
        if changes.get("evolves_stiffness"):
            assert np.array_equal(design.field, record.stiffness[i])
    assert RunFolder.open("run/specialists").read_json("specialists.json")["designs"] == found.table()
    assert load_policy("run/specialists/best.pt").make_env().num_designs == 2
    again = specialise("run", CONFIG, num_threads=1)  # which has been finished
    assert again.table() == found.table()
    assert again.env_steps == found.env_steps


@pytest.mark.slow
def test_a_stopped_training_goes_on_to_the_same_specialists():
    evolve(EVOLUTION, run="run")
    whole = specialise("run", CONFIG, run="whole", num_threads=2)
    stopped = specialise("run", CONFIG, should_stop=lambda: True, num_threads=1)
    assert not stopped.finished
    assert stopped.table() == []
    resumed = specialise("run", CONFIG, num_threads=1)
    assert resumed.table() == whole.table()
    assert resumed.env_steps == whole.env_steps
    with pytest.raises(ValueError, match="the run has"):
        specialise("run", replace(CONFIG, count=1))


def test_those_of_co_design_are_its_fittest():
    ppo = replace(PPO, eval_starts=1, selection="score")
    config = CodesignConfig("Walker-v0", material="invariant", shape=(3, 3), population=3, budget=3, ppo=ppo, seed=1)
    codesign(replace(config, stiffness=0.5, num_threads=1), run="run")
    found = specialise("run", replace(CONFIG, initial="run"), num_threads=1)
    ranked = sorted(RunRecord.read("run").rows, key=lambda row: -row["fitness"])
    assert [row["index"] for row in found.rows] == [row["index"] for row in ranked[:2]]
    assert found.table()[0]["before"]["score"] == ranked[0]["fitness"]
    assert set(np.unique(found.designs[0].field)) <= {0.5, 1.0}
    assert (found.designs[0].field[found.designs[0].body.occupancy] == 0.5).all()


def test_what_cannot_be_specialised_is_refused_before_any_work():
    evolve(EVOLUTION, run="run")
    specialise("run", CONFIG, num_threads=1)
    assert not evolve(EVOLUTION, run="begun", should_stop=lambda: True).finished
    for search, told in (
        ("run/specialists", "run of train"),
        ("nowhere", "nowhere"),
        ("begun", "no design that was scored"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=told):
            specialise(search, CONFIG, run="new")
    with pytest.raises(ValueError, match=r"nowhere has none of"):
        specialise("run", replace(CONFIG, initial="nowhere"), run="new")
    for wrong, told in (
        ({"count": 0}, "count: got 0"),
        ({"initial": ""}, "initial: got"),
        ({"ppo": replace(PPO, sharing="shared")}, "ppo.sharing: got 'shared'"),
        ({"ppo": 3}, "ppo: got"),
    ):
        with pytest.raises(ValueError, match=told):
            replace(CONFIG, **wrong)
