"""FlatPopulationEnv: the flat PettingZoo form as a batch of populations, each with one end; BenchMARL's task of it."""

import importlib
import sys

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import RewardSum, TransformedEnv, check_env_specs

from evogymcm.envs import parallel_env
from evogymcm.envs.flat_population import FlatPopulationEnv
from tests.envs.lottery import LOTTERY
from tests.envs.tools import MATERIALS, SMALL, TALL, WIDE

MIXED = (SMALL, WIDE, TALL)


def make_env(task=LOTTERY, copies=2, **options):
    return FlatPopulationEnv(task, MIXED, copies, **{"material": "reactive", "num_threads": 1} | options)


@pytest.mark.parametrize("material", MATERIALS)
def test_specs(material):
    env = make_env(material=material)
    check_env_specs(env)
    check_env_specs(TransformedEnv(env, RewardSum(reset_keys=["_reset"])), break_when_any_done="both")
    assert env.group_map == {"bodies": ["body_0", "body_1", "body_2"]}


def test_copies_are_flat_parallel_environments_whose_ended_bodies_wait():
    env = make_env(seed=5)
    torch.manual_seed(0)
    data = env.rollout(24, break_when_any_done=False)
    for copy in range(2):
        alone = parallel_env(LOTTERY, MIXED, material="reactive", flat=True, num_threads=1)
        shown, ends = np.stack(list(alone.reset(seed=5 + 3 * copy)[0].values())), 0
        for step in data[copy]:
            group, after = step["bodies"], step["next", "bodies"]
            np.testing.assert_array_equal(group["observation"], shown)
            live = list(alone.agents)
            actions = dict(zip(alone.possible_agents, group["action"].numpy(), strict=True))
            seen, rewards, terminated, truncated, _ = alone.step(actions)
            for i, agent in enumerate(alone.possible_agents):
                if agent not in live:  # it waits
                    assert after["reward"][i] == 0
                    assert after["done"][i]
                    assert torch.equal(after["observation"][i], group["observation"][i])
                    continue
                np.testing.assert_array_equal(after["observation"][i], seen[agent])
                shown[i] = seen[agent]
                assert after["reward"][i] == np.float32(rewards[agent])
                assert (after["terminated"][i], after["truncated"][i]) == (terminated[agent], truncated[agent])
            assert step["next", "done"] == (not alone.agents)
            assert step["next", "terminated"] == (not alone.agents)
            if not alone.agents:
                ends += 1
                shown = np.stack(list(alone.reset()[0].values()))
        assert ends > 1


def test_time_limits_truncate_the_population():
    data = make_env("Walker-v0", 1).rollout(3)
    assert not data["next", "done"].any()
    env = make_env("Walker-v0", 1)
    env.reset()
    env.engine.length[:] = 499
    after = env.rand_step()["next"]
    assert after["done"].all()
    assert after["truncated"].all()
    assert not after["terminated"].any()
    assert after["bodies", "truncated"].all()


def test_copies_step_alone():
    env = make_env("Walker-v0")
    before = env.reset()
    action = env.rand_action(before)["bodies", "action"]
    flags = TensorDict({"bodies": {"action": action}, "_step": torch.tensor([[True], [False]])}, [2])
    after = env._step(flags)
    assert (after["bodies", "observation"] != before["bodies", "observation"]).any(-1).any(-1).tolist() == [True, False]
    assert env.engine.length.tolist() == [1, 1, 1, 0, 0, 0]


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="copies: got 0"):
        make_env(copies=0)
    env = make_env()
    start = env.reset()
    with pytest.raises(ValueError, match="action: got None, expected a tensor"):
        env._step(start)
    start["bodies", "action"] = torch.ones(2, 3, 5)
    with pytest.raises(ValueError, match=r"action: got shape \(2, 3, 5\), expected a tensor \(2, 3, 24\)"):
        env._step(start)


def test_the_extra_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "benchmarl.environments", None)
    monkeypatch.delitem(sys.modules, "evogymcm.envs.benchmarl", raising=False)
    module = importlib.import_module("evogymcm.envs.benchmarl")  # without an error: every module can be read
    with pytest.raises(ImportError, match=r"needs benchmarl: pip install evogymcm\[benchmarl\]"):
        module.BenchMARLTask("Walker-v0", MIXED)


def test_pictures():
    pytest.importorskip("pygame")
    env = make_env("Walker-v0")
    env.reset()
    picture = env.render(64, 32)
    assert picture.dtype == np.uint8
    assert picture.shape == (48, 96, 3)  # two and one below, at least 48 wide each
