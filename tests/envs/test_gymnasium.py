"""The Gymnasium environments: registration, checkers, autoreset modes, arguments, info, errors."""

import warnings
from dataclasses import replace
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import TimeLimit
from gymnasium.wrappers.vector import DictInfoToList
from torchrl.envs import GymEnv

import evogymcm as cm
from evogymcm.envs import GymnasiumEnv, GymnasiumVectorEnv
from evogymcm.sim.constants import Physics
from tests.envs.tools import PAPER_ROBOTS, SMALL, TALL, WIDE, make_engine, random_actions
from tests.registries import registered

pytestmark = pytest.mark.filterwarnings("error:.*is out of date:DeprecationWarning")  # v0 and v1 are different tasks

MATERIALS = ("invariant", "reactive")
GRID = cm.robots["Walk_Bot"].grid
MODES = ("NextStep", "SameStep", "Disabled")
IDLE = np.ones((2, 2, cm.robots["Walk_Bot"].n_actuators))  # actions of two steps of two worlds


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
        return make(short_task.id, SMALL, **options)

    assert steps_to_truncation(limited()) == 4
    assert steps_to_truncation(limited(max_episode_steps=3)) == 3
    assert steps_to_truncation(limited(max_episode_steps=6)) == 6
    assert steps_to_truncation(limited(max_episode_steps=-1)) is None
    assert steps_to_truncation(TimeLimit(limited().unwrapped, 6)) == 6
    assert steps_to_truncation(GymnasiumEnv(short_task, SMALL)) is None  # as EvoGym's classes
    assert make(max_episode_steps=1000).spec.max_episode_steps == 1000


def test_max_episode_steps_of_vector_environments(short_task):
    def limited(**options):
        return make_vec(short_task.id, SMALL, 2, **options)

    assert steps_to_truncation(limited()) == 4
    assert steps_to_truncation(limited(max_episode_steps=6)) == 6
    assert steps_to_truncation(limited(max_episode_steps=-1)) is None
    sync = gymnasium.make_vec(f"evogymcm/{short_task.id}", 2, "sync", body=SMALL, max_episode_steps=6)
    assert steps_to_truncation(sync) == 6
    for bad in (0, -2):
        with pytest.raises(ValueError, match=rf"max_episode_steps: got {bad}.*-1 for no limit"):
            limited(max_episode_steps=bad)


def test_no_task_is_called_out_of_date():
    versioned = [task for task in cm.tasks if f"{task[:-1]}1" in cm.tasks]
    assert len(versioned) >= 12
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for task in versioned:
            env = make(task, SMALL)
            assert env.unwrapped.engine.task.id == task
            assert gymnasium.make(env.spec).spec.id == f"evogymcm/{task}"
        make_vec("CaveCrawler-v0", num_envs=1)
    for unknown in ("CaveCrawler-v7", "Climber-v3"):
        with pytest.raises(gymnasium.error.UnregisteredEnv, match=unknown[-2:]):
            make(unknown)


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


def test_info_of_one_world_holds_numpy_values():
    env = make()
    _, info = env.reset()
    assert [type(info[key]) for key in ("unstable", "score", "return")] == [np.bool_, np.float64, np.float64]
    assert {key: value.dtype for key, value in env.step(env.action_space.sample())[4].items()} == {
        key: value.dtype for key, value in info.items()
    }
    rollout = GymEnv("evogymcm/Walker-v0", body=SMALL).auto_register_info_dict().rollout(3)
    assert rollout["next", "return"].shape == (3,)
    assert rollout["next", "com"].shape == (3, 2)


@pytest.mark.parametrize("mode", MODES)
def test_infos_of_vector_environments_become_lists(mode):
    vec = make_vec(num_envs=2, max_episode_steps=2, autoreset_mode=mode, physics={"gravity": 50.0})
    env, one = DictInfoToList(vec), make(physics={"gravity": 50.0}, max_episode_steps=2)
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


def test_specs_with_bodies_and_arrays_are_json():
    body = cm.Body("HHH/VVV", connections=[[0, 1, 0, 3, 4], [1, 2, 3, 4, 5]])
    field = np.random.default_rng(0).uniform(0.5, 2.0, body.shape)
    options = {"body": body, "stiffness": field, "physics": Physics(gravity=50.0), "max_episode_steps": 900}
    env = TimeLimit(make(**options), 800)
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec.max_episode_steps == 800
    vec = make_vec(num_envs=2, **options)
    vec_again = gymnasium.make_vec(EnvSpec.from_json(vec.spec.to_json()))
    assert vec_again.num_envs == 2
    grid = make(body=body.grid, connections=body.connections, stiffness=field, physics={"gravity": 50.0})
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
        make(physics={"mass": 1.0})


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
