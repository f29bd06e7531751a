"""The Gymnasium vector environment: equal to single ones, with each autoreset mode, and answers as Gymnasium's own."""

from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList

import evogymcm as cm
from tests.envs.tools import MATERIALS, SMALL, TALL, draw, make_gymnasium, make_vec

MODES = ("NextStep", "SameStep", "Disabled")
IDLE = np.ones((2, 2, cm.robots["Walk_Bot"].n_actuators))  # actions of two steps of two worlds


@pytest.mark.parametrize("mode", MODES)
def test_infos_of_vector_environments_become_lists(mode):
    vec = make_vec(num_envs=2, max_episode_steps=2, autoreset_mode=mode, physics={"gravity": 50.0})
    env, one = DictInfoToList(vec), make_gymnasium(physics={"gravity": 50.0}, max_episode_steps=2)
    for infos, info in ((env.reset()[1], one.reset()[1]), *((env.step(a)[4], one.step(a[0])[4]) for a in IDLE)):
        finals = [each.get("final_info", each) for each in infos]
        assert [each["physics"] for each in finals] == [{"gravity": 50.0}] * 2
        for final in finals:
            assert final.keys() == info.keys()
            np.testing.assert_equal(final["return"], info["return"])
    assert ("final_info" in infos[0]) == (mode == "SameStep")


def same_values(got, expected):
    """Both are trees of the same keys, dtypes and values."""
    assert got.keys() == expected.keys()
    for key, value in expected.items():
        if isinstance(value, dict):
            same_values(got[key], value)
        elif value.dtype != object:
            assert got[key].dtype == value.dtype, key
            np.testing.assert_array_equal(got[key], value, err_msg=key)


def test_vector_environments_answer_as_gymnasiums_own():
    options = {"body": SMALL, "physics": {"gravity": 50.0}, "render_mode": "rgb_array"}
    options["render_options"] = {"width": 64, "height": 32}
    vec = make_vec(num_envs=2, **options)
    sync = gymnasium.make_vec("evogymcm/Walker-v0", 2, "sync", **options)
    for envs in (vec, sync):
        envs.reset(seed=0)
        envs.step(np.array([[0.6, 1.6, 1.0], [1.6, 0.6, 1.0]]))
        envs.set_attr("mark", ["a", "b"])
        envs.set_attr("common", 7)
    same_values(vec.reset(seed=1)[1], sync.reset(seed=1)[1])
    assert vec.get_attr("mark") == sync.get_attr("mark") == ("a", "b")
    assert vec.get_attr("common") == (7, 7)
    for name in ("render_mode", "action_space", "observation_space"):
        assert vec.get_attr(name) == sync.get_attr(name)
    for call in (
        ("render",),
        ("points", "robot"),
        ("get_pos_com_obs", "ground"),
        ("get_floor_obs", "robot", ["ground"], 2),
    ):
        np.testing.assert_array_equal(vec.call(*call), sync.call(*call))
    with pytest.raises(AttributeError, match="nonsense"):
        vec.call("nonsense")
    with pytest.raises(ValueError, match="got 3, expected one for each of 2"):
        vec.set_attr("mark", [1, 2, 3])


@pytest.mark.parametrize("material", MATERIALS)
def test_vector_equals_singles(material):
    n = 9
    vec = make_vec("DownStepper-v0", "Down_Bot", n, material=material)
    singles = [make_gymnasium("DownStepper-v0", "Down_Bot", material=material) for _ in range(n)]
    observations, infos = vec.reset(seed=0)
    for i, env in enumerate(singles):
        np.testing.assert_array_equal(env.reset()[0], observations[i])
    for actions in draw(vec.action_space, 6):
        assert actions.shape == (n, *vec.single_action_space.shape)
        observations, rewards, terminated, truncated, infos = vec.step(actions)
        assert rewards.dtype == np.float64
        for i, env in enumerate(singles):
            observation, reward, ended, cut, info = env.step(actions[i])
            np.testing.assert_array_equal(observations[i], observation)
            assert (rewards[i], terminated[i], truncated[i]) == (reward, ended, cut)
            for key in ("com", "score", "return", "unstable", "reached"):
                np.testing.assert_array_equal(infos[key][i], info[key])


def put_at_goal(vec, world):
    """Moves one robot so that its next step ends its episode."""
    engine = vec.unwrapped.engine
    engine.simulator.move("robot", (9.6, 0.0), world)
    engine.refresh()


def start(mode, num_envs=3):
    vec = make_vec(num_envs=num_envs, autoreset_mode=AutoresetMode(mode))
    assert vec.metadata["autoreset_mode"] == vec.unwrapped.autoreset_mode == AutoresetMode(mode)
    first, _ = vec.reset(seed=0)
    return vec, first, np.ones(vec.action_space.shape)


def test_next_step_mode():
    vec, first, idle = start("NextStep")
    put_at_goal(vec, 1)
    observations, rewards, terminated, truncated, infos = vec.step(idle)
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert rewards[1] > 0.9
    assert infos["com"][1, 0] > 9.9
    last_return = infos["return"][1]
    assert last_return == rewards[1]
    # The next step ignores the action of the ended world, be it what it may, and shows its reset.
    actions = idle.copy()
    actions[1] = 1.6
    observations, rewards, terminated, truncated, infos = vec.step(actions)
    np.testing.assert_array_equal(observations[1], first[1])
    assert rewards[1] == 0.0
    assert not terminated.any()
    assert not truncated.any()
    assert infos["return"][1] == 0.0
    # From there on it goes as a fresh world does.
    fresh, _, _ = start("NextStep")
    wild = np.full(vec.action_space.shape, 1.3)
    np.testing.assert_array_equal(vec.step(wild)[0][1], fresh.step(wild)[0][1])


def test_same_step_mode():
    vec, first, idle = start("SameStep")
    put_at_goal(vec, 1)
    observations, rewards, terminated, _, infos = vec.step(idle)
    assert terminated.tolist() == [False, True, False]
    assert rewards[1] > 0.9
    np.testing.assert_array_equal(observations[1], first[1])
    assert infos["_final_obs"].tolist() == [False, True, False]
    assert infos["final_obs"][0] is None
    assert infos["final_obs"][1] in vec.single_observation_space
    assert (infos["final_obs"][1] != first[1]).any()
    assert infos["_final_info"].tolist() == [False, True, False]
    assert infos["final_info"]["return"][1] == rewards[1]
    assert infos["final_info"]["com"][1, 0] > 9.9
    assert infos["com"][1, 0] < 1.0
    assert infos["return"][1] == 0.0
    wild = np.full(vec.action_space.shape, 1.3)
    fresh, _, _ = start("SameStep")
    observations, _, terminated, _, infos = vec.step(wild)
    np.testing.assert_array_equal(observations[1], fresh.step(wild)[0][1])
    assert not terminated.any()
    assert "final_obs" not in infos


def test_disabled_mode():
    vec, first, idle = start("Disabled")
    put_at_goal(vec, 1)
    observations, _, terminated, _, _ = vec.step(idle)
    assert terminated.tolist() == [False, True, False]
    mask = np.array([False, True, False])
    again, infos = vec.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(again[1], first[1])
    np.testing.assert_array_equal(again[[0, 2]], observations[[0, 2]])
    assert infos["return"][1] == 0.0
    _, _, terminated, _, _ = vec.step(idle)
    assert not terminated.any()
    for bad in (np.zeros(3, bool), np.ones(2, bool), np.ones(3)):
        with pytest.raises(ValueError, match="reset_mask"):
            vec.reset(options={"reset_mask": bad})


@pytest.mark.parametrize("mode", MODES)
def test_time_limit_in_each_mode(mode):
    vec = make_vec(num_envs=2, max_episode_steps=3, autoreset_mode=AutoresetMode(mode))
    vec.reset()
    cuts = []
    for actions in draw(vec.action_space, 7):
        _, _, terminated, truncated, _ = vec.step(actions)
        assert not terminated.any()
        cuts.append(bool(truncated.all()))
        if mode == "Disabled" and truncated.any():
            vec.reset(options={"reset_mask": truncated})
    every_third = [False, False, True, False, False, True, False]
    assert cuts == ([False, False, True, False, False, False, True] if mode == "NextStep" else every_third)


def test_vector_environments_observations_are_fresh_memory():
    vec = make_vec(num_envs=2)
    kept = [vec.reset()[0]] + [vec.step(actions)[0] for actions in draw(vec.action_space, 3)]
    for a, b in pairwise(kept):
        assert not np.shares_memory(a, b)
        assert (a != b).any()


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_what_could_not_be_made_is_closed_without_a_word():
    with pytest.raises(ValueError, match="max_episode_steps"):
        make_vec(max_episode_steps=0)
    cls = type(make_vec(num_envs=1).unwrapped)
    cls.__new__(cls).close()


def test_vector_of_one_body_for_each_world():
    vec = make_vec(body=[SMALL, SMALL], num_envs=2)
    assert vec.num_envs == 2
    with pytest.raises(ValueError, match="equal bodies"):
        make_vec(body=[SMALL, TALL], num_envs=2)
    with pytest.raises(ValueError, match="got 2, expected 1 or num_envs = 3"):
        make_vec(body=[SMALL, SMALL], num_envs=3)
