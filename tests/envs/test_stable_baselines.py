"""SB3VecEnv: Stable-Baselines3's adapter to the batched simulator; that it trains, tests/clients shows."""

import copy
import importlib
import pickle
import sys

import gymnasium
import numpy as np
import pytest

import evogymcm  # noqa: F401 - registers the ids
from tests.envs.tools import SMALL

pytest.importorskip("stable_baselines3")
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor

from evogymcm.envs import SB3VecEnv


def test_vec_env_equals_stable_baselines_own():
    """Catcher draws where its ball starts, anew in every episode."""
    options = {"body": SMALL, "max_episode_steps": 5, "physics": {"gravity": 50.0}}
    own = make_vec_env("evogymcm/Catcher-v0", 3, seed=7, env_kwargs=options)
    batched = SB3VecEnv("Catcher-v0", num_envs=3, num_threads=1, **options)
    assert batched.seed(7) == [7, 8, 9]
    assert (batched.observation_space, batched.action_space) == (own.observation_space, own.action_space)
    np.testing.assert_array_equal(batched.reset(), own.reset())
    rng = np.random.default_rng(0)
    dones_seen = 0
    for _ in range(12):
        actions = rng.uniform(0.6, 1.6, (3, 3)).astype(np.float32)
        got, expected = batched.step(actions), own.step(actions)
        for a, b in zip(got[:3], expected[:3], strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        for info, other in zip(got[3], expected[3], strict=True):
            assert info.keys() == other.keys()
            for key in info.keys() - {"episode"}:
                np.testing.assert_equal(info[key], other[key], err_msg=key)
        dones_seen += got[2].sum()
    assert dones_seen == 6


def test_vec_env_speaks_to_each_world():
    env = SB3VecEnv("Walker-v0", SMALL, 3, num_threads=1, max_episode_steps=2)
    env.reset()
    env.step(np.array([[1.0] * 3, [0.6] * 3, [1.6] * 3]))
    points = env.env_method("points", "robot", indices=[2, 0])
    np.testing.assert_array_equal(points, env.envs.call("points", "robot")[::-2])
    assert (points[0] != points[1]).any()
    env.set_attr("mark", 4, indices=1)
    assert env.get_attr("mark", 1) == [4]
    assert env.has_attr("mark") is False
    assert env.env_method("get_time") == [1, 1, 1]
    assert env.env_is_wrapped(Monitor) == [True] * 3
    assert env.env_is_wrapped(gymnasium.wrappers.TimeLimit, 0) == [False]
    idle = np.ones((3, 3))
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        np.testing.assert_array_equal(other.step(idle)[2], [True] * 3)
    env.close()
    with pytest.raises(ValueError, match="autoreset_mode"):
        SB3VecEnv("Walker-v0", SMALL, 3, autoreset_mode="NextStep")


def test_vec_env_renders():
    pytest.importorskip("pygame")
    env = SB3VecEnv("Walker-v0", SMALL, 4, render_mode="rgb_array", render_options={"width": 64, "height": 32})
    env.reset()
    assert env.render().shape == (64, 128, 3)


def test_the_extra_is_named_where_it_is_missing(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("stable_baselines3")]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "evogymcm.envs.sb3")
    module = importlib.import_module("evogymcm.envs.sb3")  # without an error: every module can be read
    with pytest.raises(ImportError, match=r"needs stable-baselines3: pip install evogymcm\[sb3\]"):
        module.SB3VecEnv("Walker-v0", SMALL, 2)


def test_infos_tell_the_work_that_is_measured():
    env = SB3VecEnv("Walker-v0", SMALL, 2, material="reactive", work_weight=0, num_threads=1)
    env.reset()
    _, _, _, infos = env.step(np.stack([env.action_space.high, env.action_space.low]))
    for name, values in env.envs.engine.works.items():
        assert [info[name] for info in infos] == values.tolist()
    assert "actuation_work" in infos[0]
    env.close()
