"""The sharing benchmark: equal budgets, warm starts, exact resuming, paired intervals; a tiny run from end to end."""

from dataclasses import replace

import pytest
import torch

from benchmarks.experiments import sharing
from benchmarks.experiments.sharing import Sharing
from evogymcm.algos.learning import take_state
from evogymcm.algos.runs import RunFolder
from evogymcm.envs import tasks

SHORT = replace(tasks.as_task("Walker-v0"), time_limit=6)


@pytest.fixture
def short_episodes(monkeypatch):
    monkeypatch.setitem(tasks._REGISTRY, "Walker-v0", SHORT)


def tiny(**changes):
    settings = {"bodies": 3, "unseen": 2, "total_steps": 192, "finetune_steps": 64, "worlds": 1, "seed": 1}
    return Sharing(**settings | changes)


def run(experiment, arm, folder, resume=False, should_stop=lambda: False):
    told = []
    job = next(job for job in experiment.jobs() if job.arm == arm)
    record = job.run(folder, resume, lambda steps, score: told.append((steps, score)), should_stop)
    return record, told


def arm(name, scores, training=()):
    known = {
        p: {"finished": True, "env_steps": 1000, "best_scores": [5.0, 7.0], "curve": [[0.0, 0.0], [1.0, 1.0]]}
        for p in training
    }
    return {"label": name, "finished": True, "scores": scores, "training": known}


def test_bodies_are_seeded_and_all_different():
    designs = Sharing().designs()
    assert {name: len(group) for name, group in designs.items()} == {"seen": 32, "unseen": 16}
    assert len({design.body for group in designs.values() for design in group}) == 48
    assert designs == Sharing().designs()
    assert designs != Sharing(seed=1).designs()
    assert designs["unseen"] == Sharing(bodies=8).designs()["unseen"]


def test_fine_tuning_goes_on_from_the_end_of_the_schedules():
    experiment = Sharing()
    shared, tuned, scratch = (experiment.ppo(policy) for policy in ("shared", "fine-tuned", "scratch"))
    assert tuned.initial_std == shared.final_std
    assert tuned.learning_rate == shared.learning_rate / 4
    assert (scratch.initial_std, scratch.learning_rate) == (shared.initial_std, shared.learning_rate)
    assert tuned.total_steps == scratch.total_steps == 50_000
    assert shared.minibatch * experiment.bodies == 512


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The shared arm from end to end: its folder, its record, what it told, and what each training started from."""
    folder, given = tmp_path_factory.mktemp("whole"), {}
    with pytest.MonkeyPatch.context() as patch:
        train_designs = sharing.train_designs

        def spy(make_env, designs, ppo, *, initial, **options):
            given[ppo.sharing] = initial
            return train_designs(make_env, designs, ppo, initial=initial, **options)

        patch.setattr(sharing, "train_designs", spy)
        patch.setitem(tasks._REGISTRY, "Walker-v0", SHORT)
        return folder, *run(tiny(), "shared", folder), given


def test_fine_tuning_starts_from_the_shared_weights(whole):
    folder, record, told, given = whole
    assert given["shared"] is None
    last = RunFolder.open(folder / "shared" / "shared").load("final")["actor"]
    assert len(given["independent"]) == 2
    assert all(torch.equal(policy["actor"][key], last[key]) for policy in given["independent"] for key in last)
    assert {bodies: set(scores) for bodies, scores in record["scores"].items()} == {
        "seen": {"untrained", "shared"}, "unseen": {"untrained", "zero-shot", "fine-tuned"}
    }  # fmt: skip
    assert record["finished"]
    assert told[-1][0] == tiny().steps_per_run == 192 + 128
    tuned = torch.load(folder / "shared" / "fine-tuned" / "final.pt", weights_only=True)["actor"]
    assert not torch.equal(take_state(tuned, 0)["heads.weight"], take_state(tuned, 1)["heads.weight"])


@pytest.mark.usefixtures("short_episodes")
def test_both_arms_have_the_same_budget(tmp_path):
    experiment = tiny(total_steps=200, finetune_steps=70)  # in whole rollouts of every body: 288 and 192
    shared, _ = run(experiment, "shared", tmp_path)
    independent, told = run(experiment, "independent", tmp_path)
    steps = [[part["env_steps"] for part in record["training"].values()] for record in (shared, independent)]
    assert steps == [[288, 192], [288, 192]]
    assert told[-1][0] == experiment.steps_per_run == 480
    assert all(len(scores) == 2 for record in (shared, independent) for scores in record["scores"]["unseen"].values())
    assert shared["scores"]["seen"]["shared"] != independent["scores"]["seen"]["independent"]


@pytest.mark.usefixtures("short_episodes")
def test_a_stopped_arm_resumes_exactly(whole, tmp_path):
    experiment = tiny()
    for updates in (1, 2):  # within shared training, then within fine-tuning
        calls = iter(range(100))
        stopped, _ = run(
            experiment, "shared", tmp_path / "run", resume=True, should_stop=lambda c=calls, n=updates: next(c) >= n
        )
        assert not stopped["finished"]
    assert "zero-shot" in stopped["scores"]["unseen"]
    assert "fine-tuned" not in stopped["scores"]["unseen"]
    resumed, _ = run(experiment, "shared", tmp_path / "run", resume=True)
    assert resumed["finished"]
    assert resumed["scores"] == whole[1]["scores"]


def test_differences_on_the_same_bodies_are_paired():
    spread = [0.0, 4.0, 8.0]
    shared = arm("shared", {"seen": {"shared": [x + 1 for x in spread]}, "unseen": {"zero-shot": spread}}, ["shared"])
    independent = arm("independent", {"seen": {"independent": spread}, "unseen": {}})
    rows = Sharing().summarise([shared, independent])
    paired, gap = [row for row in rows if "difference" in row]
    assert (paired["mean"], paired["interval"], paired["better_on"]) == (1.0, (1.0, 1.0), "3 of 3")
    assert gap["mean"] == -1.0
    assert gap["interval"][0] < -3 < 3 < gap["interval"][1]  # of different bodies: nothing cancels


def test_table_and_figure(tmp_path):
    scores = {"seen": {"untrained": [0.0, 0.5], "shared": [4.0, 6.5]}, "unseen": {}}
    arms = [arm("shared", scores, ["shared"])]
    text = Sharing().table(Sharing().summarise(arms))
    row = next(line for line in text.splitlines() if "| shared" in line)
    assert [cell.strip() for cell in row.strip("|").split("|")] == [
        "2 seen", "shared", "1,000", "5.25", "4.00 to 6.50", "5.25", "6.00"
    ]  # fmt: skip
    assert "difference" not in text  # there is nothing to compare
    both = [*arms, arm("independent", {"seen": {"independent": [1, 2]}})]
    assert "difference" in Sharing().table(Sharing().summarise(both))
    pytest.importorskip("matplotlib")
    arms[0]["training"]["scratch"] = {"curve": [[0.0, 0.1], [100.0, 2.0]]}
    Sharing().plot(arms, tmp_path / "scores.png")
    Sharing().plot([], tmp_path / "none.png")  # all arms failed
    assert (tmp_path / "scores.png").stat().st_size > (tmp_path / "none.png").stat().st_size > 0
