"""Runs side by side in threads are those of one after another, and leave the process as it was."""

import functools
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
import torch
from torchrl.envs.utils import ExplorationType, exploration_type, set_exploration_type

from evogymcm.algos import Trainer, evaluate, make_actor
from evogymcm.algos.learning.threads import exploration, limited_threads
from tests.algos.learning.test_training import TINY
from tests.algos.toy_env import ToyEnv

SHORT = replace(TINY, total_steps=480, eval_interval=160)
SETTINGS = [replace(SHORT, seed=3), replace(SHORT, seed=4, sharing="independent", noise_correlation=0.5)]
make_noisy = functools.partial(ToyEnv, noise=0.1)


@pytest.fixture
def two_threads():
    """Torch's default, as on any machine with several cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def in_new_thread(call):
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call).result()


def weights(result):
    return [value for net in (result.actor, result.critic) for value in net.state_dict().values()]


def test_two_runs_in_threads_are_those_of_each_alone(two_threads):
    alone = [Trainer(make_noisy, config).train() for config in SETTINGS]
    barrier = threading.Barrier(2, timeout=300)
    before = torch.get_rng_state()

    def run(config):
        return Trainer(make_noisy, config).train(progress=lambda state: barrier.wait())

    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(run, SETTINGS))
    for one, other in zip(alone, together, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(weights(one), weights(other), strict=True))
        assert [row.get("score") for row in one.rows] == [row.get("score") for row in other.rows]
    assert torch.equal(torch.get_rng_state(), before)
    assert exploration_type() is None
    assert torch.get_num_threads() == in_new_thread(torch.get_num_threads) == 2


def test_a_limit_on_threads_is_the_calling_threads_own(two_threads):
    begun, ended = threading.Event(), threading.Event()

    def ask():
        mine = [torch.get_num_threads()]
        begun.set()
        ended.wait(60)
        return [*mine, torch.get_num_threads()]

    with ThreadPoolExecutor(1) as other:
        answer = other.submit(ask)
        begun.wait(60)
        with limited_threads(1):
            assert torch.get_num_threads() == 1
            assert in_new_thread(torch.get_num_threads) == 2
            with limited_threads(3):
                assert torch.get_num_threads() == 3
            assert torch.get_num_threads() == 1
        ended.set()
        assert answer.result() == [2, 2]
    assert torch.get_num_threads() == in_new_thread(torch.get_num_threads) == 2


def test_exploring_is_each_threads_own_and_torchrls_type_is_put_back():
    env = make_noisy(num_worlds=2)
    actor, state = make_actor(env), env.reset()

    def act():
        return actor(state.clone())["action", "actuation"]

    begun, left = threading.Event(), threading.Event()

    def explore():
        with exploration(True):
            begun.set()
            left.wait(60)
            return act(), act()

    with set_exploration_type(ExplorationType.MEAN), ThreadPoolExecutor(1) as other:
        with exploration(False):
            random = other.submit(explore)
            begun.wait(60)
            assert torch.equal(act(), act())
        left.set()
        first, second = random.result()
        assert not torch.equal(first, second)
        assert exploration_type() is ExplorationType.MEAN
    assert exploration_type() is None
    assert not torch.equal(act(), act())
    evaluate(actor, env)
    assert exploration_type() is None
