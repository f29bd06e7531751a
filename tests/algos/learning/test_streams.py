"""Training on a stream of random bodies, judged on bodies that it never sees; and on another device."""

from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from evogymcm.algos import PPOConfig, RunFolder, load_policy, train
from evogymcm.algos.learning import TrainConfig
from evogymcm.algos.learning.bodies import RandomBodies, held_out_bodies
from evogymcm.algos.learning.training import make_trainer

TINY = PPOConfig(total_steps=768, num_worlds=8, rollout_steps=16, epochs=1, minibatch=64, hidden=8, eval_interval=0)
CONFIG = TrainConfig("Sprint-v0", random_bodies=(3, 3), ppo=replace(TINY, eval_worlds=5))

_GPU = pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU"))

pytestmark = pytest.mark.usefixtures("sprint")  # whose episodes have 12 env-steps


def test_training_meets_ever_new_bodies_and_evaluations_the_same_others():
    with make_trainer(CONFIG, num_threads=1) as trainer:
        seen, env = set(), trainer._env
        while not trainer.is_finished:
            seen |= {body.text for body in env.bodies}
            trainer.update()
        played = []
        make = trainer.make_eval_env
        trainer.make_eval_env = lambda **options: played.append(make(**options)) or played[-1]
        trainer.evaluate()
    assert len(seen) > 3 * TINY.num_worlds  # 8 episodes in each world
    held_out = [body.text for body in held_out_bodies((3, 3), 5)]
    assert [body.text for body in played[0].bodies] == held_out
    assert env.grid_shape == played[0].grid_shape == (3, 3)


def test_worlds_change_their_bodies_one_after_another():
    settings = replace(TINY, rollout_steps=1, num_worlds=6, minibatch=6)  # of episodes of 12 env-steps
    with make_trainer(replace(CONFIG, ppo=settings), num_threads=1) as trainer:
        engine, ended = trainer._env.engine, []
        assert sorted(engine.length.tolist()) == [0, 2, 4, 6, 8, 10]
        for _ in range(24):
            before = [body.text for body in engine.bodies]
            trainer.update()
            ended.append(sum(engine.length == 0))
            assert sum(body.text != old for body, old in zip(engine.bodies, before, strict=True)) <= ended[-1]
    assert max(ended) == 1  # none together
    assert sum(ended) == 12  # whole episodes, after the first


def test_the_others_may_be_played_from_several_starts():
    with make_trainer(CONFIG, num_threads=1) as one:
        alone = one.evaluate()
    several = replace(CONFIG, ppo=replace(CONFIG.ppo, eval_starts=2))
    with make_trainer(several, num_threads=1) as two:
        both = two.evaluate()
    assert both.starts.shape == (2, 5)
    np.testing.assert_array_equal(both.score, alone.score)
    assert (both.spread > 0).any()


def rngs(count):
    return [np.random.default_rng(seed) for seed in range(count)]


@pytest.mark.parametrize("device", ["cpu", _GPU])
def test_a_stopped_run_goes_on_with_the_same_bodies(tmp_path, device):
    config = replace(CONFIG, ppo=replace(CONFIG.ppo, device=device, noise_correlation=0.5))
    whole = train(config, num_threads=1)
    calls = iter(range(100))
    train(config, run=tmp_path / "run", should_stop=lambda: next(calls) >= 2, num_threads=1)
    told = []
    folder = RunFolder(tmp_path / "run", asdict(config), resume=True)
    resumed = train(config, run=folder, num_threads=1, progress=lambda state: told.append(state.env_steps))
    assert resumed.finished
    assert told[0] == 2 * TINY.frames_per_update  # not from its start
    assert resumed.final.score.shape == (5,)
    tolerance = {"rtol": 0, "atol": 0} if device == "cpu" else {"rtol": 1e-3, "atol": 1e-4}  # a GPU adds in any order
    np.testing.assert_allclose(resumed.final.score, whole.final.score, **tolerance)
    policy = load_policy(tmp_path / "run")
    assert policy.make_env(bodies=["HH/VV"], num_threads=1).batch_size == (1,)
    with pytest.raises(ValueError, match="bodies: got none"):
        policy.make_env()


def test_random_bodies_have_the_stiffness_that_is_given():
    rng = np.random.default_rng(0)
    body, field = RandomBodies((4, 3), 0.5)(rng)
    assert body.shape == field.shape == (4, 3)
    assert np.array_equal(field == 0.5, body.occupancy)
    config = replace(CONFIG, task="Walker-v0", stiffness=0.5)
    with make_trainer(config, num_threads=1) as trainer:
        engine = trainer._env.engine
        assert np.array_equal(engine.stiffness == 0.5, engine.occupancy)
    assert RandomBodies((4, 3))(rng).shape == (4, 3)


def test_a_pool_is_so_many_bodies_in_every_run_those_of_smaller_pools_among_them():
    small, large = ({body.text for body in map(RandomBodies((5, 5), pool=n), rngs(200))} for n in (3, 5))
    assert (len(small), len(large)) == (3, 5)
    assert small < large
    assert not large & {body.text for body in held_out_bodies((5, 5))}
    with make_trainer(replace(CONFIG, pool=1), num_threads=1) as trainer:
        assert {body.text for body in trainer._env.engine.bodies} == {RandomBodies((3, 3), pool=1)(*rngs(1)).text}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"random_bodies": (5, 0)}, "random_bodies: got 0"),
        ({"random_bodies": 5}, "random_bodies: got 5"),
        ({"bodies": ("HH/VV",)}, r"random_bodies: got \(3, 3\) and bodies too"),
        ({"pool": 0}, "pool: got 0"),
        ({"pool": 2, "random_bodies": None}, "pool: got 2, but no random_bodies"),
        ({"stiffness": (((1.0, 1.0),),)}, "random bodies take one number"),
        ({"ppo": replace(TINY, sharing="independent")}, "a stream of bodies needs 'shared'"),
        ({"ppo": replace(TINY, device="cuda:99")}, "device: got 'cuda:99', which torch cannot use here"),
    ],
)
def test_what_does_not_go_together_is_said(wrong, said):
    with pytest.raises(ValueError, match=said):
        make_trainer(replace(CONFIG, **wrong), num_threads=1)


@pytest.mark.parametrize("device", ["cpu", _GPU])
def test_learning_on_a_device_is_that_on_the_processor_but_for_rounding(tmp_path, device):
    ppo, weights, scores = replace(CONFIG.ppo, total_steps=256, eval_interval=128), [], []
    for number, place in enumerate(("cpu", device)):
        config, run = replace(CONFIG, ppo=replace(ppo, device=place)), RunFolder(tmp_path / str(number), {})
        with make_trainer(config, num_threads=1) as trainer:
            scores.append(trainer.train(run=run).final.score)
        weights.append(run.load("final")["actor"])
        with make_trainer(config, num_threads=1) as stopped:
            stopped.load_state_dict(run.load("checkpoint")["trainer"])
            np.testing.assert_array_equal(stopped.evaluate().score, scores[-1])
    assert {value.device.type for values in weights for value in values.values()} == {"cpu"}
    tolerance = {"rtol": 0, "atol": 0} if device == "cpu" else {"rtol": 1e-2, "atol": 1e-3}
    torch.testing.assert_close(*weights, **tolerance)
    np.testing.assert_allclose(*scores, **tolerance)


def test_worlds_are_restored_to_the_device_of_their_environment(monkeypatch):
    """Torch's device "meta" stands in for a GPU: the tensors of a checkpoint lie on the processor."""
    with make_trainer(CONFIG, num_threads=1) as trainer:
        collector, state = trainer.collector, trainer.collector.state_dict()
        on_meta = SimpleNamespace(device=torch.device("meta"), load_state_dict=trainer._env.load_state_dict)
        monkeypatch.setattr(collector, "env", on_meta)
        collector.load_state_dict(state)
        restored = collector._carrier.exclude("collector")
    assert {value.device.type for value in restored.values(True, True)} == {"meta"}
