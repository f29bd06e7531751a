"""PPO on the toy: it learns, repeats itself exactly, and can be stopped and resumed."""

import functools
import json
import os
import signal
from dataclasses import asdict, replace

import pytest
import torch

from evogymcm.algos import PPOConfig, RunFolder, Trainer, TrainingEnv, evaluate, load_actor, make_actor, train
from evogymcm.envs import SoftRobotEnv
from tests.algos.toy_env import SMALL, WIDE, ToyEnv

TINY = PPOConfig(total_steps=960, num_worlds=8, rollout_steps=20, epochs=2, minibatch=80, hidden=16, eval_interval=400)
make_toy = functools.partial(ToyEnv, bodies=SMALL)


def _weights(result) -> list[torch.Tensor]:
    return [value.clone() for net in (result.actor, result.critic) for value in net.state_dict().values()]


def _same(first: list[torch.Tensor], second: list[torch.Tensor]) -> bool:
    return all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_it_learns_to_walk():
    config = PPOConfig(
        total_steps=14_000, num_worlds=16, rollout_steps=40, minibatch=320, learning_rate=3e-3, gamma=0.9,
        reward_scale=10, hidden=32, eval_interval=0,
    )  # fmt: skip
    result = Trainer(make_toy, config).train()
    untrained, trained = result.rows[0]["score"], result.final.score.mean()
    assert untrained < 0.1
    assert trained > 0.5
    assert result.best_score == pytest.approx(trained)
    assert result.finished


def test_several_bodies_learn_in_one_batch():
    config = replace(TINY, eval_worlds=2)
    result = Trainer(functools.partial(ToyEnv, bodies=[SMALL, WIDE]), config).train()
    assert result.final.score.shape == (2,)


@pytest.mark.filterwarnings("error::FutureWarning")  # of TorchRL's collectors, about what a training does not need
@pytest.mark.parametrize("material", ["reactive", "invariant"])
def test_same_seed_same_policy(material):
    make = functools.partial(make_toy, material=material, noise=0.1)
    config = replace(TINY, total_steps=480)
    first, second = Trainer(make, config).train(), Trainer(make, config).train()
    assert _same(_weights(first), _weights(second))
    assert first.rows[-1]["score"] == second.rows[-1]["score"]
    assert not _same(_weights(first), _weights(Trainer(make, replace(config, seed=1)).train()))


def test_global_state_is_left_alone():
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    threads = torch.get_num_threads()
    load_actor(Trainer(make_toy, TINY).train().best)
    assert torch.equal(torch.rand(3), expected)
    assert torch.get_num_threads() == threads


def test_the_policy_of_a_run_that_is_over_draws_as_torch_is_seeded():
    actor, state, actions = Trainer(make_toy, replace(TINY, total_steps=160)).train().actor, make_toy().reset(), []
    for seed in (0, 0, 1):
        torch.manual_seed(seed)
        actions.append(actor(state.clone())["action", "actuation"])
    assert torch.equal(actions[0], actions[1])
    assert not torch.equal(actions[0], actions[2])


def test_rows_and_progress_tell_the_whole_run():
    told = []
    result = Trainer(make_toy, TINY).train(progress=told.append)
    assert [row["env_steps"] for row in result.rows] == list(range(0, 961, 160))
    assert [progress.row for progress in told] == result.rows
    assert [row["env_steps"] for row in result.rows if "score" in row] == [0, 480, 800, 960]
    assert all(row["kl"] == pytest.approx(0, abs=0.2) for row in result.rows[1:])


@pytest.fixture(scope="module")
def whole():
    """A run in an environment with noise, from its start to its end."""
    return Trainer(functools.partial(make_toy, noise=0.1), TINY).train()


@pytest.mark.parametrize("updates", [1, 4])
def test_a_stopped_run_goes_on_to_the_same_result(whole, tmp_path, updates):
    make = functools.partial(make_toy, noise=0.1)
    calls = iter(range(100))
    run = RunFolder(tmp_path / "run", asdict(TINY))
    stopped = Trainer(make, TINY).train(run=run, should_stop=lambda: next(calls) >= updates)
    assert not stopped.finished
    assert stopped.final is None
    assert stopped.env_steps == 160 * updates
    told = []
    resumed = Trainer(make, TINY).train(
        run=RunFolder(tmp_path / "run", asdict(TINY), resume=True), progress=told.append
    )
    assert told[0].env_steps == 160 * updates
    assert resumed.finished
    assert _same(_weights(whole), _weights(resumed))
    timeless = [{k: v for k, v in row.items() if k != "seconds"} for row in resumed.rows]
    assert timeless == [{k: v for k, v in row.items() if k != "seconds"} for row in whole.rows]


def test_a_killed_run_goes_on_from_its_last_checkpoint(whole, tmp_path):
    make = functools.partial(make_toy, noise=0.1)

    def crash(progress):
        if progress.env_steps == 640:
            raise RuntimeError("power cut")

    run = RunFolder(tmp_path / "run", asdict(TINY))
    with pytest.raises(RuntimeError, match="power cut"):
        Trainer(make, TINY).train(run=run, progress=crash)
    assert run.rows()[-1]["env_steps"] == 640  # the checkpoint is of 480
    resumed = Trainer(make, TINY).train(run=RunFolder(tmp_path / "run", asdict(TINY), resume=True))
    assert _same(_weights(whole), _weights(resumed))
    assert [row["env_steps"] for row in resumed.rows] == [row["env_steps"] for row in whole.rows]


def test_every_environment_is_closed_after_a_failure_too():
    made, closed = [], []

    class Broken(ToyEnv):
        def __init__(self, *args, fails_at=10**9, **kwargs):
            super().__init__(*args, **kwargs)
            self.fails_at = fails_at
            made.append(self)

        def close(self, **kwargs):
            closed.append(self)
            super().close(**kwargs)

        def _step(self, tensordict):
            if self.steps.max() > self.fails_at:
                raise RuntimeError("blew up")
            return super()._step(tensordict)

    def crash(progress):
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        Trainer(Broken, TINY).train(progress=crash)  # after an evaluation
    with pytest.raises(RuntimeError, match="blew up"):
        Trainer(functools.partial(Broken, fails_at=30), TINY).train()  # within one
    with pytest.raises(ValueError, match="flat observation"):
        Trainer(functools.partial(Broken, bodies=[SMALL, WIDE]), replace(TINY, network="mlp")).train()
    assert {*map(id, made)} == {*map(id, closed)}
    assert len(made) == 5


def test_ctrl_c_ends_after_the_update_with_a_checkpoint(tmp_path):
    def press(progress):
        if progress.env_steps == 320:
            os.kill(os.getpid(), signal.SIGINT)

    run = RunFolder(tmp_path / "run", asdict(TINY))
    result = Trainer(make_toy, TINY).train(run=run, progress=press)
    assert not result.finished
    assert run.load("checkpoint")["trainer"]["env_steps"] == 320


def test_run_folder_holds_policies_that_load(tmp_path):
    run, seeds = RunFolder(tmp_path / "run", asdict(TINY)), []

    def make(*, num_worlds, seed):
        seeds.append(seed)
        return make_toy(num_worlds=num_worlds, seed=seed)

    result = Trainer(make, TINY).train(run=run)
    actor = make_actor(make_toy(num_worlds=1), TINY.hidden)
    actor.load_state_dict(run.load("final")["actor"])
    assert evaluate(actor, make_toy(num_worlds=1, seed=seeds[-1])).score[0] == result.final.score[0]
    best = run.load("best")
    actor.load_state_dict(best["actor"])
    assert evaluate(actor, make_toy(num_worlds=1, seed=seeds[-1])).score[0] == best["row"]["score"] == result.best_score
    assert run.rows() == json.loads(json.dumps(result.rows))
    again = Trainer(make_toy, TINY).train(run=RunFolder(tmp_path / "run", asdict(TINY), resume=True))
    assert again.env_steps == result.env_steps
    assert again.final.score[0] == result.final.score[0]


def test_bad_settings_are_refused():
    with pytest.raises(ValueError, match="epochs"):
        PPOConfig(epochs=0)
    with pytest.raises(ValueError, match="gamma"):
        PPOConfig(gamma=1.5)
    with pytest.raises(ValueError, match="seed"):
        PPOConfig(seed=-1)


def test_trainer_keeps_exploring_differently_each_update():
    trainer = Trainer(make_toy, TINY)
    trainer.update()
    first = trainer.collector.rollout()["action", "actuation"].clone()
    trainer.update()
    assert not torch.equal(first, trainer.collector.rollout()["action", "actuation"])
    trainer.close()


def test_training_environments_fulfil_their_contract():
    for env in (make_toy(), SoftRobotEnv("Walker-v0", ["HHH", "HH/VV"], num_threads=1)):
        assert isinstance(env, TrainingEnv)
        assert env.num_designs == len(set(env.bodies)) if isinstance(env, SoftRobotEnv) else 1
    assert not isinstance(object(), TrainingEnv)


def test_the_words_of_the_last_version_work_with_a_warning():
    short = replace(TINY, total_steps=160)
    whole = Trainer(make_toy, short).train()
    with pytest.warns(DeprecationWarning, match=r"Trainer\(make_env, ppo\).train\(\)"):
        result = train(make_toy, short)
    assert _same(_weights(result), _weights(whole))
    again = Trainer(make_toy, short).train(initial=whole.policy)  # which leaves the policy as it is
    with pytest.warns(DeprecationWarning, match="now called initial"):
        result = train(make_toy, short, start_from=whole.policy)
    assert _same(_weights(result), _weights(again))
