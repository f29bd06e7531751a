"""parallel_env: bodies as PettingZoo agents that end at different times, and new designs between episodes."""

import copy
import pickle
import warnings

import numpy as np
import pytest
import torch
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.test import parallel_api_test, parallel_seed_test
from torchrl.envs import PettingZooWrapper, check_env_specs

import evogymcm as cm
from evogymcm.envs import parallel_env
from tests.envs.lottery import LOTTERY
from tests.envs.tools import MATERIALS, SMALL, TALL, WIDE, make_engine

MIXED = (SMALL, WIDE, TALL)  # padded to 3x4
INFO = {"score", "return", "unstable", "reached", "com_x", "com_y"}


def make_env(task="Walker-v0", bodies=MIXED, **options):
    return parallel_env(task, bodies, **{"material": "reactive", "num_threads": 1} | options)


def sample(env, agents=None):
    return {agent: env.action_space(agent).sample() for agent in (env.agents if agents is None else agents)}


def seed_actions(env, seed=0):
    for i, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(seed + i)


def play(env, steps, seed=0, reset_seed=None, options=None):
    """What reset and every step returned, under random actions."""
    seed_actions(env, seed)
    shown = [env.reset(reset_seed, options)]
    for _ in range(steps):
        shown.append(env.step(sample(env)))
    return shown


def assert_same(got, expected):
    """Two trees of dicts, sequences, arrays and numbers are equal."""
    assert type(got) is type(expected)
    if isinstance(got, dict):
        assert got.keys() == expected.keys()
        for key in got:
            assert_same(got[key], expected[key])
    elif isinstance(got, list | tuple):
        assert len(got) == len(expected)
        for one, other in zip(got, expected, strict=True):
            assert_same(one, other)
    else:
        np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("task", [*sorted(cm.tasks), LOTTERY], ids=lambda task: getattr(task, "id", task))
def test_pettingzoos_own_tests(task, material):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(make_env(task, (SMALL, WIDE), material=material), num_cycles=12)
        parallel_seed_test(lambda: make_env(task, (SMALL, WIDE), material=material), num_cycles=12)


@pytest.mark.parametrize("material", MATERIALS)
def test_spaces_hold_what_is_given(material):
    env = make_env(material=material)
    assert isinstance(env, ParallelEnv)
    assert env.possible_agents == ["body_0", "body_1", "body_2"]
    assert env.agents == []
    heads = {"actuation", "stiffness"} if material == "reactive" else {"actuation"}
    for observations, *_, infos in play(env, 3):
        for agent in env.possible_agents:
            assert set(observations[agent]) == {"voxels", "types", "occupancy", "actuators", "task"}
            assert env.observation_space(agent).contains(observations[agent])
            assert observations[agent]["voxels"].shape == (12, 20)
            assert env.action_space(agent).spaces.keys() == heads
            assert infos[agent].keys() == INFO
            assert np.isfinite(list(infos[agent].values())).all()
    assert env.state_space.contains(env.state())
    occupancy = env.reset()[0]["body_1"]["occupancy"]
    assert occupancy.tolist() == [1, 1, 1, 1, 1, 0, 0, 1, 0, 0, 0, 0]


def test_seeds_may_be_numpys():
    env = parallel_env("Walker-v0", ["HH/VV"], seed=np.int64(3))
    assert env.np_random.random() == np.random.default_rng(3).random()


def test_masks_are_boxes():
    observation = make_env().observation_space("body_0")
    assert [observation[key] for key in ("occupancy", "actuators")] == [spaces.Box(0, 1, (12,), np.int8)] * 2


@pytest.mark.parametrize("material", MATERIALS)
def test_the_flat_form_is_the_other_one_flattened(material):
    env, flat = make_env(LOTTERY, material=material), make_env(LOTTERY, material=material, flat=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(make_env(LOTTERY, material=material, flat=True), num_cycles=12)
        parallel_seed_test(lambda: make_env("Walker-v0", material=material, flat=True), num_cycles=3)
    views = [env.observation_space("body_1"), env.action_space("body_1")]
    vectors = [flat.observation_space("body_1"), flat.action_space("body_1")]
    assert vectors == [spaces.flatten_space(space) for space in views]
    assert all(type(space) is spaces.Box and space.dtype == np.float32 for space in vectors)

    def assert_flattened(got, expected):
        assert got.keys() == expected.keys()
        for agent in got:
            assert vectors[0].contains(got[agent])
            np.testing.assert_array_equal(got[agent], spaces.flatten(views[0], expected[agent]))

    assert_flattened(flat.reset(seed=3)[0], env.reset(seed=3)[0])
    seed_actions(flat)
    while flat.agents:
        actions = sample(flat)
        shown = flat.step(actions)
        expected = env.step({agent: spaces.unflatten(views[1], action) for agent, action in actions.items()})
        assert_flattened(shown[0], expected[0])
        assert_same(shown[1:], expected[1:])
    designs = {"bodies": [TALL, WIDE, SMALL]}
    assert_flattened(flat.reset(1, designs)[0], env.reset(1, designs)[0])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.ones(12), r"action of body_1: got shape \(12,\), expected \(actuation,\) \+ \(stiffness,\) = \(24,\)"),
        (np.ones((2, 12)), r"got shape \(2, 12\)"),
        ({"actuation": np.ones(12)}, "body_1: got .*expected numbers"),
        (None, r"got shape \(\)"),
    ],
)
def test_bad_flat_actions(action, message):
    env = make_env(flat=True)
    env.reset()
    with pytest.raises(ValueError, match=message):
        env.step(sample(env) | {"body_1": action})
    assert not env.engine.length.any()


def test_wrappers_find_a_generator_that_seeds_decide():
    env = make_env()
    draws = []
    for seed in (3, 3, None):
        env.reset(seed)
        draws.append(env.unwrapped.np_random.integers(1000, size=4).tolist())  # as SuperSuit's frame_skip does
    assert draws[0] == draws[1] != draws[2]


@pytest.mark.parametrize("material", MATERIALS)
def test_steps_are_those_of_the_engine(material):
    env, engine = make_env("DownStepper-v0", material=material), make_engine("DownStepper-v0", MIXED, material=material)
    env.reset()
    for _ in range(6):
        actions = sample(env)
        observations, rewards, terminated, truncated, infos = env.step(actions)
        engine.step(*(np.stack([actions[a][head] for a in env.possible_agents]) for head in actions["body_0"]))
        for i, agent in enumerate(env.possible_agents):
            np.testing.assert_array_equal(observations[agent]["voxels"], engine.voxels[i])
            np.testing.assert_array_equal(observations[agent]["task"], engine.features[i].astype(np.float32))
            assert (rewards[agent], terminated[agent], truncated[agent]) == (engine.reward[i], False, False)
            assert (infos[agent]["com_x"], infos[agent]["com_y"]) == tuple(engine.com[i])
            assert (infos[agent]["score"], infos[agent]["return"]) == (engine.score[i], engine.returns[i])


def test_bodies_end_at_their_own_time():
    env = make_env(LOTTERY)
    env.reset(seed=1)
    lengths = dict.fromkeys(env.possible_agents, 0)
    while env.agents:
        live = env.agents
        size, points = env.state().shape, [env.engine.simulator.positions(world=i) for i in range(3)]
        # entries of bodies that have ended are ignored
        observations, rewards, terminated, truncated, infos = env.step(sample(env, env.possible_agents))
        assert all(list(given) == live for given in (observations, rewards, terminated, truncated, infos))
        assert env.agents == [agent for agent in live if not terminated[agent]]
        for i, agent in enumerate(env.possible_agents):
            lengths[agent] += agent in live
            has_moved = (env.engine.simulator.positions(world=i) != points[i]).any()
            assert has_moved == (agent in live)  # no step in vain
        assert env.state().shape == size
    assert len(set(lengths.values())) > 1
    assert list(lengths.values()) == env.engine.length.tolist()
    assert env.step({}) == ({}, {}, {}, {}, {})
    env.reset()
    assert env.agents == env.possible_agents
    assert not env.engine.length.any()


def test_endings_do_not_touch_the_others():
    bodies = [SMALL] * 4
    env, alone = make_env(LOTTERY, bodies), make_env(LOTTERY, bodies[3:])
    env.reset(seed=1)
    alone.reset(seed=4)  # world 3's
    while "body_3" in env.agents:
        actions = sample(env)
        shown, expected = env.step(actions), alone.step({"body_0": actions["body_3"]})
        for part, other in zip(shown, expected, strict=True):
            assert_same(part["body_3"], other["body_0"])
    assert alone.agents == []


def test_seeds_are_obeyed():
    env, other = make_env(LOTTERY), make_env(LOTTERY, seed=7)
    first = play(env, 9, reset_seed=3)
    assert_same(play(other, 9, reset_seed=3), first)
    assert_same(play(env, 9, reset_seed=3), first)
    ends = [[list(step[0]) for step in play(env, 9, reset_seed=seed)] for seed in (3, 4, None, None)]
    assert len({str(end) for end in ends}) == 4  # None goes on with the present numbers
    assert_same(play(make_env(LOTTERY, seed=7), 9), play(make_env(LOTTERY, seed=7), 9))
    designs = {"bodies": [TALL, SMALL, SMALL]}
    shown = [
        play(env, 9, reset_seed=3, options=designs),
        play(make_env(LOTTERY, designs["bodies"], grid_shape=(3, 4)), 9, reset_seed=3),
    ]
    assert_same(*shown)


def test_nothing_given_is_changed_later():
    env = make_env()
    shown = play(env, 2)
    kept = copy.deepcopy(shown)
    for step in shown:
        for observation in step[0].values():
            for values in observation.values():
                assert values.flags.writeable
    env.step(sample(env))
    assert_same(shown, kept)
    for observation in shown[-1][0].values():
        for values in observation.values():
            values[:] = 0  # nor does the environment look at what it gave away
    env.reset()
    assert_same(play(env, 3)[1:], play(make_env(), 3)[1:])


def test_new_designs_between_episodes():
    env = make_env(material="invariant", bodies=[TALL, WIDE])
    same = [env.observation_space(agent) for agent in env.possible_agents]
    bodies = [SMALL, WIDE]
    fields = [
        np.where(cm.as_body(body).occupancy, factor, 1.0) for body, factor in zip(bodies, (0.7, 1.5), strict=True)
    ]
    play(env, 2)
    shown = play(env, 4, seed=2, options={"bodies": bodies, "stiffness": fields})
    fresh = make_env(material="invariant", bodies=bodies, stiffness=fields, grid_shape=(3, 4))
    assert_same(shown, play(fresh, 4, seed=2))
    assert [env.observation_space(agent) for agent in env.possible_agents] == same
    assert [body.text for body in env.bodies] == bodies
    assert_same(play(env, 4, seed=2), shown)  # they stay
    plain = play(env, 4, seed=2, options={"stiffness": None})
    assert_same(plain, play(make_env(material="invariant", bodies=bodies, grid_shape=(3, 4)), 4, seed=2))


def test_padding_changes_nothing_else():
    small, large = make_env(), make_env(grid_shape=(5, 5))
    cells = (np.arange(3)[:, None] * 5 + np.arange(4)).ravel()
    small.reset()
    large.reset()
    for _ in range(3):
        actions = sample(large)
        fewer = {agent: {head: values[cells] for head, values in action.items()} for agent, action in actions.items()}
        got, expected = large.step(actions), small.step(fewer)
        for agent in small.possible_agents:
            for key in ("voxels", "types", "occupancy", "actuators"):
                np.testing.assert_array_equal(got[0][agent][key][cells], expected[0][agent][key])
                assert not np.delete(got[0][agent][key], cells, 0).any()
        assert_same(got[1:], expected[1:])


def test_copies_go_on_alike():
    env = make_env(LOTTERY)
    play(env, 2)
    twins = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = [env.step(sample(env)) for _ in range(4)]
    for twin in twins:
        assert_same([twin.step(sample(twin)) for _ in range(4)], expected)


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")
def test_torchrls_wrapper():
    env = PettingZooWrapper(make_env(LOTTERY), use_mask=True, done_on_any=False, return_state=True)
    check_env_specs(env)
    assert env.group_map == {"body": ["body_0", "body_1", "body_2"]}
    torch.manual_seed(0)
    env.set_seed(1)
    data = env.rollout(20, break_when_any_done=False)
    mask = data["body", "mask"]
    assert mask.any(1).all()
    assert not mask.all()
    assert data["next", "done"].any()
    assert data["body", "action", "stiffness"].shape == (20, 3, 12)
    assert set(data["body", "info"].keys()) == INFO


def test_unknown_render_modes_are_named():
    with pytest.raises(ValueError, match=r"render_mode: got 'ansi'.*rgb_array"):
        make_env(render_mode="ansi")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bodies": [SMALL]}, "got 1, this environment has 3 agents"),
        (
            {"bodies": [SMALL, SMALL, "HHHHH"]},
            r"grid_shape: got \(3, 4\), at least \(2, 5\) is needed for these",
        ),
        ({"bodies": [SMALL, SMALL, "RR"]}, "actuator"),
        ({"stiffness": [np.ones((2, 3))] * 3}, "reactive"),
    ],
)
def test_bad_designs_leave_the_environment_as_it_was(options, message):
    env = make_env()
    play(env, 1)
    seed_actions(env)
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)
    assert [body.text for body in env.bodies] == list(MIXED)
    env.step(sample(env))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda actions: actions.pop("body_1"), "got none for body_1, each"),
        (lambda actions: actions["body_1"].pop("stiffness"), r"body_1: got \['actuation'\], expected .*'stiffness'"),
        (lambda actions: actions.update(body_1=np.ones(12)), "body_1: got ndarray, expected a dict"),
        (lambda actions: actions["body_2"].update(actuation=np.ones(5)), r"actuation of body_2: got shape \(5,\).*12"),
        (
            lambda actions: actions["body_2"].update(stiffness=["much"] * 12),
            r"stiffness of body_2: got \['much'.*expected numbers",
        ),
        (lambda actions: actions["body_0"]["stiffness"].fill(np.nan), "stiffness: got NaN in world 0"),
    ],
)
def test_bad_actions(change, message):
    env = make_env()
    env.reset()
    actions = sample(env)
    change(actions)
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert not env.engine.length.any()


def test_render():
    pytest.importorskip("pygame")
    env = make_env(render_mode="rgb_array", render_options={"width": 320, "height": 160})
    env.reset()
    first = env.render()
    assert first.dtype == np.uint8
    assert first.shape[1:] == (320, 3)
    for _ in range(5):
        env.step(sample(env))
    assert (env.render() != first).any()
    env.reset(options={"bodies": [WIDE, SMALL, TALL]})
    assert (env.render() != first).any()
    env.close()
    assert make_env().render() is None


@pytest.mark.usefixtures("headless")
def test_window():
    pytest.importorskip("pygame")
    env = make_env(render_mode="human")
    env.reset()
    env.step(sample(env))
    assert env.render() is None
    env.close()
    env.close()
    env.step(sample(env))  # goes on without


def test_unknown_view():
    pytest.importorskip("pygame")
    with pytest.raises(ValueError, match="view: got 'x-ray'"):
        make_env(render_mode="rgb_array", render_options={"view": "x-ray"})
