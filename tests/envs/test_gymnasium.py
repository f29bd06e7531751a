"""The Gymnasium environments: registration, checkers, arguments, time limits, specs, info, errors."""

import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import TimeLimit
from torchrl.envs import GymEnv

import evogymcm as cm
from evogymcm.envs import GymnasiumEnv, GymnasiumVectorEnv
from evogymcm.sim.constants import Physics
from tests.envs.tools import (
    MATERIALS,
    PAPER_ROBOTS,
    SMALL,
    WIDE,
    draw,
    make_engine,
    make_gymnasium,
    make_vec,
    random_actions,
)
from tests.registries import registered

pytestmark = pytest.mark.filterwarnings("error:.*is out of date:DeprecationWarning")  # v0 and v1 are different tasks

GRID = cm.robots["Walk_Bot"].grid


@pytest.mark.parametrize("task", sorted(cm.tasks))
@pytest.mark.parametrize("material", MATERIALS)
def test_every_task_can_be_made(task, material):
    body = PAPER_ROBOTS.get(task, SMALL)
    env = make_gymnasium(task, body, material=material)
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
    env = make_gymnasium(task, PAPER_ROBOTS.get(task, SMALL), material=material)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized space")  # advice; EvoGym's range is not
        check_env(env.unwrapped, skip_render_check=True)  # it opens windows; test_render.py looks at pictures


@pytest.mark.parametrize("material", MATERIALS)
def test_action_space(material):
    space = make_gymnasium(body=SMALL, material=material).action_space  # HVH/S.R: three actuators, five voxels
    extra = (5 if material == "reactive" else 0) * [1]
    np.testing.assert_array_equal(space.low, [0.6] * 3 + [0.5 * one for one in extra])
    np.testing.assert_array_equal(space.high, [1.6] * 3 + [2.0 * one for one in extra])


@pytest.mark.parametrize("material", MATERIALS)
def test_flat_actions_are_row_major(material):
    env = make_gymnasium("DownStepper-v0", WIDE, material=material)
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
    env = make_gymnasium(body=GRID.tolist(), connections=connections)
    other = make_gymnasium(body=GRID.astype(float), connections=None)
    for a, b in zip(draw(env.action_space, 3), draw(other.action_space, 3), strict=True):
        np.testing.assert_array_equal(a, b)
    env.reset(seed=0)
    other.reset(seed=1)  # seeds change nothing here
    for action in draw(env.action_space, 4):
        np.testing.assert_array_equal(env.step(action)[0], other.step(action)[0])


def test_fewer_connections_make_another_robot():
    body = cm.Body("HH/HH")
    # Voxels 2 and 3 not joined: one point more below.
    env, cut = make_gymnasium(body=body), make_gymnasium(body=body, connections=[[0, 0, 1], [1, 2, 3]])
    sizes = [e.reset()[0].shape[0] for e in (env, cut)]
    assert sizes == [2 + 2 * 9, 2 + 2 * 10]
    vec = make_vec(body=body, connections=[[0, 0, 1], [1, 2, 3]], num_envs=2)
    assert vec.single_observation_space.shape == (22,)


@pytest.mark.parametrize("edge_rule", ["mean_factor", "mean_stiffness"])
def test_stiffness_and_edge_rule(edge_rule):
    field = np.random.default_rng(0).uniform(0.5, 2.0, GRID.shape)
    env = make_gymnasium(stiffness=field, edge_rule=edge_rule)
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
    env = make_gymnasium("CaveCrawler-v0", "Cave_Bot")
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


@pytest.fixture
def short_task():
    """A task of one's own whose episodes have four env-steps."""
    with registered(replace(cm.tasks["Walker-v0"], id="Short-v0", time_limit=4)) as name:
        yield cm.tasks[name]


def steps_to_truncation(env, most=8):
    """Env-steps of an idle episode until it is cut; None where it goes on."""
    env.reset()
    idle = np.ones(env.action_space.shape)
    for step in range(1, most + 1):
        _, reward, terminated, truncated, info = env.step(idle)
        assert not np.any(terminated)
        if np.all(truncated):
            np.testing.assert_allclose(info["return"], info["score"] + reward, rtol=0, atol=1e-15)
            return step
    return None


def test_max_episode_steps_rules_over_the_tasks_limit(short_task):
    def limited(**options):
        return make_gymnasium(short_task.id, SMALL, **options)

    assert steps_to_truncation(limited()) == 4
    assert steps_to_truncation(limited(max_episode_steps=3)) == 3
    assert steps_to_truncation(limited(max_episode_steps=6)) == 6
    assert steps_to_truncation(limited(max_episode_steps=-1)) is None
    assert steps_to_truncation(TimeLimit(limited().unwrapped, 6)) == 6
    assert steps_to_truncation(GymnasiumEnv(short_task, SMALL)) is None  # as EvoGym's classes
    assert make_gymnasium(max_episode_steps=1000).spec.max_episode_steps == 1000


def test_max_episode_steps_of_vector_environments(short_task):
    def limited(**options):
        return make_vec(short_task.id, SMALL, 2, **options)

    assert steps_to_truncation(limited()) == 4
    assert steps_to_truncation(limited(max_episode_steps=6)) == 6
    assert steps_to_truncation(limited(max_episode_steps=-1)) is None
    sync = gymnasium.make_vec(f"evogymcm/{short_task.id}", 2, "sync", body=SMALL, max_episode_steps=6)
    assert steps_to_truncation(sync) == 6
    for bad in (0, -2):
        with pytest.raises(ValueError, match=rf"max_episode_steps \(-1 for no limit\): got {bad}"):
            limited(max_episode_steps=bad)


def test_no_task_is_called_out_of_date():
    versioned = [task for task in cm.tasks if f"{task[:-1]}1" in cm.tasks]
    assert len(versioned) >= 12
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for task in versioned:
            env = make_gymnasium(task, SMALL)
            assert env.unwrapped.engine.task.id == task
            assert gymnasium.make(env.spec).spec.id == f"evogymcm/{task}"
        make_vec("CaveCrawler-v0", num_envs=1)
    for unknown in ("CaveCrawler-v7", "Climber-v3"):
        with pytest.raises(gymnasium.error.UnregisteredEnv, match=unknown[-2:]):
            make_gymnasium(unknown)


def test_score_and_return_at_the_end():
    env = make_gymnasium(max_episode_steps=5)
    env.reset()
    rewards = []
    truncated = False
    for action in draw(env.action_space, 5):
        _, reward, _, truncated, info = env.step(action)
        rewards.append(reward)
    assert truncated
    np.testing.assert_allclose(info["return"], sum(rewards), rtol=0, atol=1e-15)
    np.testing.assert_allclose(info["score"], sum(rewards[:-1]), rtol=0, atol=1e-15)


def test_info_of_one_world_holds_numpy_values():
    env = make_gymnasium()
    _, info = env.reset()
    assert [type(info[key]) for key in ("unstable", "score", "return")] == [np.bool_, np.float64, np.float64]
    assert {key: value.dtype for key, value in env.step(env.action_space.sample())[4].items()} == {
        key: value.dtype for key, value in info.items()
    }
    rollout = GymEnv("evogymcm/Walker-v0", body=SMALL).auto_register_info_dict().rollout(3)
    assert rollout["next", "return"].shape == (3,)
    assert rollout["next", "com"].shape == (3, 2)


def test_specs_with_bodies_and_arrays_are_json():
    body = cm.Body("HHH/VVV", connections=[[0, 1, 0, 3, 4], [1, 2, 3, 4, 5]])
    field = np.random.default_rng(0).uniform(0.5, 2.0, body.shape)
    options = {"body": body, "stiffness": field, "physics": Physics(gravity=50.0), "max_episode_steps": 900}
    env = TimeLimit(make_gymnasium(**options), 800)
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec.max_episode_steps == 800
    vec = make_vec(num_envs=2, **options)
    vec_again = gymnasium.make_vec(EnvSpec.from_json(vec.spec.to_json()))
    assert vec_again.num_envs == 2
    grid = make_gymnasium(body=body.grid, connections=body.connections, stiffness=field, physics={"gravity": 50.0})
    grid_again = gymnasium.make(EnvSpec.from_json(grid.spec.to_json()))
    action = np.full(body.n_actuators, 1.4)
    env.reset()
    expected = env.step(action)[0]
    for other in (again, grid, grid_again):
        other.reset()
        np.testing.assert_array_equal(other.step(action)[0], expected)
    vec_again.reset()
    np.testing.assert_array_equal(vec_again.step(np.stack([action] * 2))[0], np.stack([expected] * 2))
    assert gymnasium.spec("evogymcm/Walker-v0").to_json()
    with pytest.raises(ValueError, match=r"physics: got \['mass'\], known are.*gravity"):
        make_gymnasium(physics={"mass": 1.0})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"connections": [[0], [9]]}, "connection"),
        ({"render_mode": "holograph"}, "holograph"),
        ({"render_options": {"hide_sun": True}}, "hide_sun.*hide_edges"),
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
