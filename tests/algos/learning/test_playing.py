"""Playing episodes: finished worlds wait at no cost, whatever holds the worlds and whatever acts in them."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn
from torchrl.envs import Compose, RewardSum, StepCounter, TransformedEnv

import evogymcm as cm
from evogymcm.algos import evaluate, make_actor, play
from evogymcm.algos.analysis import record_episode
from evogymcm.envs import Renderer, SoftRobotEnv, TaskEngine, parallel_env, population_env, sine_gait
from tests.envs.lottery import LOTTERY
from tests.envs.tools import SMALL, TALL, WIDE
from tests.registries import registered

BODIES = [SMALL, WIDE, TALL, WIDE, SMALL]  # episodes of the lottery end apart
OPTIONS = {"material": "reactive", "num_threads": 1, "seed": 3}


def make_lottery():
    return SoftRobotEnv(LOTTERY, BODIES, **OPTIONS)


@pytest.fixture(scope="module")
def actor():
    actor = make_actor(make_lottery(), generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        for parameter in actor.parameters():  # an untrained policy hardly moves
            parameter.mul_(3.0)
    return actor


@pytest.fixture(scope="module")
def known(actor):
    """Score, return and length of first episodes in worlds that restart at their ends, as collectors have them."""
    env, n = make_lottery(), len(BODIES)
    records = {key: np.zeros((n, 1)) for key in ("score", "return")}
    running, length = np.ones(n, bool), np.zeros(n, int)
    with torch.no_grad(), torch.random.fork_rng():
        state = env.reset()
        actor.eval()
        while running.any():
            state["action"] = actor.get_dist(state).mode
            step, state = env.step_and_maybe_reset(state)
            length += running
            ended = running & step["next", "done"].flatten().numpy()
            for key, values in records.items():
                values[ended] = step["next", key].numpy()[ended]
            running &= ~ended
    return records["score"].ravel(), records["return"].ravel(), length


def _transformed():
    return TransformedEnv(make_lottery(), Compose(RewardSum(), StepCounter()))


def _engine():
    return TaskEngine(LOTTERY, BODIES, **OPTIONS)


def _population():
    return population_env(LOTTERY, BODIES, **OPTIONS)


@pytest.mark.parametrize("make", [make_lottery, _transformed, _engine, _population])
def test_worlds_that_have_ended_are_not_simulated_and_draw_nothing(make, actor, known):
    env = make()
    engine = env if isinstance(env, TaskEngine) else env.engine
    if isinstance(env, TaskEngine):
        env.set_seed(OPTIONS["seed"])  # it has drawn when it was made
    result = evaluate(actor, env)
    score, returns, length = known
    assert len(set(length)) > 2
    np.testing.assert_array_equal(result.score, score)
    np.testing.assert_array_equal(result.returns, returns)
    np.testing.assert_array_equal(result.length, length)
    assert result.env_steps == length.sum() < len(length) * length.max()
    np.testing.assert_array_equal(engine.length, length)  # none has begun another episode
    fresh = _engine()  # which has drawn once
    assert [rng.bit_generator.state for rng in engine._rngs] == [rng.bit_generator.state for rng in fresh._rngs]


class _Fickle(TensorDictModuleBase):
    """A policy that has nothing to say in worlds that have ended."""

    in_keys, out_keys = ["voxels"], [("action", "actuation"), ("action", "stiffness")]

    def forward(self, tensordict):
        done, shape = tensordict["done"], tensordict["occupancy"].shape
        for key, value in zip(self.out_keys, (1.3, 0.7), strict=True):
            tensordict.set(key, torch.where(done, torch.nan, value).expand(shape))
        return tensordict


@pytest.mark.parametrize("make", [make_lottery, _engine])
def test_nothing_is_asked_of_the_actions_of_worlds_that_have_ended(make):
    assert np.isfinite(evaluate(_Fickle(), make()).returns).all()


MAKERS = {
    "engine": TaskEngine,
    "torchrl": SoftRobotEnv,
    "gymnasium": lambda task, body, **options: gymnasium.make(f"evogymcm/{task}", body=body, **options),
    "vector": lambda task, body, **options: gymnasium.make_vec(f"evogymcm/{task}", num_envs=1, body=body, **options),
    "pettingzoo": lambda task, body, **options: parallel_env(task, [body], **options),
    "population": lambda task, body, **options: population_env(task, [body], **options),
}


def test_evaluations_recordings_gaits_and_pictures_take_whatever_holds_worlds(actor):
    seen = {}
    with registered(replace(cm.tasks["Walker-v0"], id="Short-v0", time_limit=6)) as task:
        for kind, make in MAKERS.items():
            env = make(task, SMALL, material="reactive")
            renderer, shown = Renderer(env, 120, 60), []
            for now in play(sine_gait, env, steps=4):
                shown += [now.returns.copy(), renderer.frame(), *sine_gait(env)]
            assert (now.step, now.running.all()) == (4, True)
            for policy in (sine_gait, actor):
                result, recording = evaluate(policy, env), record_episode(policy, env)
                assert result.length == len(recording.stiffness) == 6
                assert recording.score == result.score[0]
                shown += [result.score, result.ceiling, recording.actuation, recording.stiffness, recording.contact]
            seen[kind] = shown
    for kind, shown in seen.items():
        for values, others in zip(shown, seen["engine"], strict=True):
            np.testing.assert_array_equal(values, others, err_msg=kind)


def test_what_cannot_be_played_is_refused_at_once(actor):
    engine = TaskEngine("Walker-v0", SMALL, material="reactive", with_voxels=False)
    with pytest.raises(ValueError, match="steps: got 0"):
        play(sine_gait, engine, steps=0)
    with pytest.raises(ValueError, match="policy: got dict"):
        play({}, engine)
    for take in (sine_gait, Renderer, lambda env: play(sine_gait, env), lambda env: play(actor, env)):
        with pytest.raises(ValueError, match=r"env: got str, expected a TaskEngine or an environment"):
            take("Walker-v0")
    with pytest.raises(ValueError, match="action: got None, expected"):
        evaluate(TensorDictModule(nn.Identity(), ["task"], ["out"]), engine)
