"""The Gymnasium environments: registration, checkers, autoreset modes, arguments, info, errors."""

import warnings
from dataclasses import replace
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import evogymcm as cm
from evogymcm.envs import GymnasiumEnv, GymnasiumVectorEnv
from tests.envs.tools import PAPER_ROBOTS, SMALL, TALL, WIDE, make_engine, random_actions

# Gymnasium advises to take the newest version; here versions are different tasks, as in EvoGym.
pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")

MATERIALS = ("invariant", "reactive")
GRID = cm.robots["Walk_Bot"].grid
MODES = ("NextStep", "SameStep", "Disabled")


def make(task="Walker-v0", body="Walk_Bot", **options):
    return gymnasium.make(f"evogymcm/{task}", body=body, **options)


def make_vec(task="Walker-v0", body="Walk_Bot", num_envs=4, **options):
    return gymnasium.make_vec(f"evogymcm/{task}", num_envs=num_envs, body=body, **{"num_threads": 1} | options)


def draw(space, steps, seed=0):
    space.seed(seed)
    return [space.sample() for _ in range(steps)]


@pytest.mark.parametrize("task", sorted(cm.tasks))
@pytest.mark.parametrize("material", MATERIALS)
def test_every_task_can_be_made(task, material):
    body = PAPER_ROBOTS.get(task, SMALL)
    env = make(task, body, material=material)
    observation, info = env.reset(seed=0)
    assert observation in env.observation_space
    assert set(info) == {"com", "unstable", "reached", "score", "return"}
    n = cm.as_body(body).n_actuators
    n_voxels = cm.as_body(body).n_voxels
    assert env.action_space.shape == (n + n_voxels if material == "reactive" else n,)
    assert env.action_space.dtype == np.float64
    assert env.spec.max_episode_steps == cm.tasks[task].time_limit
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert observation in env.observation_space
    assert isinstance(reward, float)
    assert isinstance(terminated, bool)
    assert isinstance(truncated, bool)
    assert set(info) == {"com", "unstable", "reached", "score", "return"}


@pytest.mark.parametrize("task", sorted(cm.tasks))
@pytest.mark.parametrize("material", MATERIALS)
def test_gymnasiums_own_checker(task, material):
    env = make(task, PAPER_ROBOTS.get(task, SMALL), material=material)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized space")  # advice; EvoGym's range is not
        check_env(env.unwrapped, skip_render_check=True)  # it opens windows; test_render.py looks at pictures


@pytest.mark.parametrize("material", MATERIALS)
def test_action_space(material):
    space = make(body=SMALL, material=material).action_space  # HVH/S.R: three actuators, five voxels
    extra = (5 if material == "reactive" else 0) * [1]
    np.testing.assert_array_equal(space.low, [0.6] * 3 + [0.5 * one for one in extra])
    np.testing.assert_array_equal(space.high, [1.6] * 3 + [2.0 * one for one in extra])


@pytest.mark.parametrize("material", MATERIALS)
def test_flat_actions_are_row_major(material):
    env = make("DownStepper-v0", WIDE, material=material)
    engine = make_engine("DownStepper-v0", WIDE, material=material)
    observation, _ = env.reset()
    np.testing.assert_array_equal(observation, engine.flat[0])
    for actuation, stiffness in zip(*random_actions(engine, 6), strict=True):
        action = actuation[engine.actuators]
        if material == "reactive":
            action = np.concatenate([action, stiffness[engine.occupancy]])
        observation, reward, terminated, truncated, info = env.step(action)
        engine.step(actuation, stiffness if material == "reactive" else None)
        np.testing.assert_array_equal(observation, engine.flat[0])
        assert reward == engine.reward[0]
        assert (terminated, truncated) == (False, False)
        assert (info["score"], info["return"], info["unstable"]) == (engine.score[0], engine.returns[0], False)
        np.testing.assert_array_equal(info["com"], engine.com[0])


def test_evogyms_arguments_by_position_and_as_lists():
    connections = cm.Body(GRID).connections
    env = make(body=GRID.tolist(), connections=connections)
    other = make(body=GRID.astype(float), connections=None)
    for a, b in zip(draw(env.action_space, 3), draw(other.action_space, 3), strict=True):
        np.testing.assert_array_equal(a, b)
    env.reset(seed=0)
    other.reset(seed=1)  # seeds change nothing here
    for action in draw(env.action_space, 4):
        np.testing.assert_array_equal(env.step(action)[0], other.step(action)[0])


def test_fewer_connections_make_another_robot():
    body = cm.Body("HH/HH")
    # Voxels 2 and 3 not joined: one point more below.
    env, cut = make(body=body), make(body=body, connections=[[0, 0, 1], [1, 2, 3]])
    sizes = [e.reset()[0].shape[0] for e in (env, cut)]
    assert sizes == [2 + 2 * 9, 2 + 2 * 10]
    vec = make_vec(body=body, connections=[[0, 0, 1], [1, 2, 3]], num_envs=2)
    assert vec.single_observation_space.shape == (22,)


@pytest.mark.parametrize("edge_rule", ["mean_factor", "mean_stiffness"])
def test_stiffness_and_edge_rule(edge_rule):
    field = np.random.default_rng(0).uniform(0.5, 2.0, GRID.shape)
    env = make(stiffness=field, edge_rule=edge_rule)
    engine = make_engine("Walker-v0", "Walk_Bot", stiffness=field, edge_rule=edge_rule)
    env.reset()
    actuation, _ = random_actions(engine, 5)
    for values in actuation:
        observation = env.step(values[engine.actuators])[0]
        engine.step(values)
        np.testing.assert_array_equal(observation, engine.flat[0])
    plain = make_engine("Walker-v0", "Walk_Bot")
    for values in actuation:
        plain.step(values)
    assert (observation != plain.flat[0]).any()


def test_points_and_velocities():
    env = make("CaveCrawler-v0", "Cave_Bot")
    env.reset()
    _, _, _, _, info = env.step(np.full(8, 1.2))
    points = env.unwrapped.points("robot")
    assert points.shape == env.unwrapped.velocities("robot").shape == (2, 24)
    np.testing.assert_allclose(points.mean(1), info["com"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(env.unwrapped.points(), points)
    terrain = env.unwrapped.points("terrain")
    assert terrain.shape[0] == 2
    np.testing.assert_allclose([terrain.min(), terrain[0].max()], [0.0, 7.0], rtol=0, atol=1e-12)
    points[:] = 0.0  # a copy
    assert env.unwrapped.points().any()
    with pytest.raises((KeyError, ValueError), match="package"):
        env.unwrapped.points("package")


def test_time_limit_truncates():
    env = GymnasiumEnv(replace(cm.tasks["Walker-v0"], time_limit=3), SMALL)
    env.reset()
    ends = [env.step(np.ones(3))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_score_and_return_at_the_end():
    env = make(max_episode_steps=5)
    env.reset()
    rewards = []
    truncated = False
    for action in draw(env.action_space, 5):
        _, reward, _, truncated, info = env.step(action)
        rewards.append(reward)
    assert truncated
    np.testing.assert_allclose(info["return"], sum(rewards), rtol=0, atol=1e-15)
    np.testing.assert_allclose(info["score"], sum(rewards[:-1]), rtol=0, atol=1e-15)


@pytest.mark.parametrize("material", MATERIALS)
def test_vector_equals_singles(material):
    n = 9
    vec = make_vec("DownStepper-v0", "Down_Bot", n, material=material)
    singles = [make("DownStepper-v0", "Down_Bot", material=material) for _ in range(n)]
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


def test_vector_of_one_body_for_each_world():
    vec = make_vec(body=[SMALL, SMALL], num_envs=2)
    assert vec.num_envs == 2
    with pytest.raises(ValueError, match="equal bodies"):
        make_vec(body=[SMALL, TALL], num_envs=2)
    with pytest.raises(ValueError, match="got 2, expected 1 or num_envs = 3"):
        make_vec(body=[SMALL, SMALL], num_envs=3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"body": "H.H"}, "one piece"),
        ({"material": "active"}, "active.*invariant"),
        ({"stiffness": np.full(GRID.shape, 3.0)}, "0.5 to 2"),
        ({"stiffness": np.ones((2, 2))}, "shape"),
        ({"stiffness": np.ones(GRID.shape), "material": "reactive"}, "reactive"),
        ({"edge_rule": "mean"}, "mean_factor"),
        ({"connections": [[0], [9]]}, "connection"),
        ({"render_mode": "holograph"}, "holograph"),
    ],
)
def test_bad_arguments_are_named(options, message):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium's own, of the render mode
        for cls in (GymnasiumEnv, GymnasiumVectorEnv):
            with pytest.raises(ValueError, match=message):
                cls("Walker-v0", **{"body": "Walk_Bot"} | options)


def test_bad_actions_are_named():
    env = GymnasiumEnv("Walker-v0", SMALL)
    env.reset()
    with pytest.raises(ValueError, match=r"\(2,\).*\(3,\)"):
        env.step(np.ones(2))
    with pytest.raises(ValueError, match="NaN"):
        env.step(np.array([1.0, np.nan, 1.0]))
    vec = GymnasiumVectorEnv("Walker-v0", SMALL, 2)
    vec.reset()
    with pytest.raises(ValueError, match=r"action"):
        vec.step(np.ones((3, 3)))


def test_unknown_id():
    with pytest.raises(gymnasium.error.NameNotFound, match="Waker"):
        gymnasium.make("evogymcm/Waker-v0", body=SMALL)
