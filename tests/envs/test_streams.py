"""Streams of bodies: which world gets which body and when, exactness, states, adapters, and what is refused."""

import io
import pickle
from dataclasses import replace
from itertools import cycle

import gymnasium
import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

import evogymcm as cm
from evogymcm import Body
from evogymcm.algos import PPOConfig, Trainer
from evogymcm.algos.analysis import GroundContact
from evogymcm.envs import Renderer, SoftRobotEnv, TaskEngine, Window, parallel_env, population_env
from evogymcm.sim.simulator import Simulator
from evogymcm.sim.world import World, WorldObject
from tests.envs.tools import SMALL, TALL, WIDE, assert_same, make_engine, outputs, random_actions

GRID = (4, 4)
SHORT = replace(cm.tasks["Walker-v0"], time_limit=3)  # so that episodes end


def draw(rng):
    """A body of any shape that fits in the grid."""
    return cm.sample_body((int(rng.integers(1, 5)), int(rng.integers(2, 5))), rng)


def draw_design(rng):
    """A body, every third one without some of its joints, and a stiffness field."""
    body = draw(rng)
    kind = rng.integers(3)
    if kind == 0:
        joined = body.connections
        body = Body(body.grid, joined[:, rng.random(joined.shape[1]) < 0.8])
    return body, rng.uniform(0.5, 2.0, body.shape) if kind else None


def stream(task="Walker-v0", bodies=draw, num_worlds=3, **options):
    return make_engine(task, bodies, num_worlds, **{"grid_shape": GRID} | options)


def texts(engine):
    return [body.text for body in engine.bodies]


def step(engine, actions, rows=slice(None)):
    actuation, stiffness = (values[rows] for values in actions)
    engine.step(actuation, stiffness if engine.material == "reactive" else None)
    return outputs(engine)


@pytest.mark.parametrize(
    ("task", "material"),
    [
        ("Walker-v0", "invariant"),
        ("Walker-v0", "reactive"),
        ("BridgeWalker-v0", "invariant"),
        ("Traverser-v0", "reactive"),
        ("Catcher-v0", "invariant"),
        ("AreaMaximizer-v0", "reactive"),
    ],
)
def test_a_stream_a_population_and_each_alone_are_equal_bit_for_bit(task, material):
    bodies = draw_design if material == "invariant" else draw
    batch = stream(task, bodies, material=material, seed=5)
    alone = [stream(task, bodies, 1, material=material, seed=5 + world) for world in range(3)]
    fields = [field.reshape(GRID)[: b.rows, : b.cols] for field, b in zip(batch.stiffness, batch.bodies, strict=True)]
    given = fields if material == "invariant" else None
    options = {"material": material, "grid_shape": GRID, "with_flat": False}
    population = make_engine(task, batch.bodies, stiffness=given, seed=5, **options)
    is_fixed = np.ones(3, bool)  # worlds whose body the population still has
    actuation, stiffness = random_actions(batch, 30)
    for k in range(30):
        actions = actuation[k], stiffness[k]
        shown, expected = step(batch, actions), step(population, actions)
        assert_same(shown, expected, is_fixed)
        for world, engine in enumerate(alone):
            assert_same({name: values[[world]] for name, values in shown.items()}, step(engine, actions, [world]))
        again = np.array([k % 7 == 6, k % 11 == 10, False])
        before, kept = texts(batch), outputs(batch)
        batch.reset(again)
        for world in np.flatnonzero(again):
            alone[world].reset()
            body, field = batch.bodies[world], batch.stiffness[world].reshape(GRID)
            single = make_engine(
                task,
                body,
                stiffness=field[: body.rows, : body.cols] if material == "invariant" else None,
                **options,
            )
            if task != "Catcher-v0":  # which has drawn another start
                assert_same({name: v[[world]] for name, v in outputs(batch).items()}, outputs(single))
                np.testing.assert_array_equal(batch.score_ceiling[[world]], single.score_ceiling)
        assert_same(outputs(batch), kept, ~again)
        assert all((one == other) or changed for one, other, changed in zip(before, texts(batch), again, strict=True))
        is_fixed &= ~again
    assert not is_fixed[:2].any()
    points = batch.snapshot.robot.relative
    for world, body in enumerate(batch.bodies):
        n = batch.simulator.positions("robot", world).shape[1]
        assert n <= 4 * body.n_voxels
        assert points[world, :, :n].any()
        assert not points[world, :, n:].any(), "left over from a larger body"


def test_every_episode_of_a_stream_is_that_of_its_body():
    """Also the numbers that only steps show: springs, contacts, limits of a world that held other robots before."""
    engine = stream("BridgeWalker-v0", draw_design, 2, seed=1)
    actions = random_actions(engine, 8)
    for _ in range(5):
        engine.reset()
        fixed = [
            make_engine("BridgeWalker-v0", b, stiffness=f.reshape(GRID)[: b.rows, : b.cols], grid_shape=GRID)
            for b, f in zip(engine.bodies, engine.stiffness, strict=True)
        ]
        for k in range(8):
            shown = step(engine, (actions[0][k], actions[1][k]))
            for world, single in enumerate(fixed):
                expected = step(single, (actions[0][k], actions[1][k]), [world])
                expected.pop("flat")
                assert_same({name: values[[world]] for name, values in shown.items()}, expected)


def test_bodies_follow_from_the_seed_of_their_world_alone():
    engine, other = stream(seed=7), stream("Catcher-v0", num_worlds=1, seed=8)
    first = texts(engine)
    engine.reset()
    assert texts(engine) == first, "no episode has begun with them"
    assert texts(other) == first[1:2], "the task does not matter"
    engine.reset(np.array([True, False, True]))
    assert texts(engine)[1] == first[1]
    second = texts(engine)
    engine.reset()
    other.reset()
    other.reset()
    assert texts(engine)[1] == texts(other)[0]
    assert texts(engine)[0] != second[0]
    engine.set_seed(7)
    engine.reset()
    assert texts(engine) == first
    engine.set_seed([9, 8, 7])
    engine.reset()
    assert texts(engine)[1:] == [first[1], first[0]]


def test_an_iterator_gives_bodies_in_the_order_of_resets():
    engine = stream(bodies=iter([SMALL, TALL, WIDE, (WIDE, np.full((2, 4), 2.0)), "Walk_Bot"]), grid_shape=(5, 5))
    engine.set_seed(3)
    engine.reset()
    assert texts(engine) == [SMALL, TALL, WIDE]
    engine.reset(np.array([False, True, False]))
    assert texts(engine) == [SMALL, WIDE, WIDE]
    assert engine.stiffness[1].max() == 2.0
    assert engine.stiffness[2].max() == 1.0
    with pytest.raises(ValueError, match="state: the place of an iterator cannot be saved"):
        engine.state()
    engine.step(np.ones((3, 25)))
    before = outputs(engine)
    with pytest.raises(ValueError, match=r"the stream has ended after 5; give one without an end"):
        engine.reset(np.array([True, False, True]))
    assert_same(outputs(engine), before)
    assert texts(engine) == [SMALL, WIDE, WIDE]


@pytest.mark.parametrize("task", ["Walker-v0", "Catcher-v0"])
def test_a_saved_stream_goes_on_with_the_same_bodies(task):
    engine, resumed = (stream(task, draw_design, seed=seed) for seed in (1, 2))
    actuation, _ = random_actions(engine, 10)
    for k in range(3):
        engine.step(actuation[k])
        engine.reset(np.array([True, False, k == 1]))
    resumed.set_state(pickle.loads(pickle.dumps(engine.state())))
    copied = pickle.loads(pickle.dumps(engine))
    for k in range(3, 10):
        for other in (resumed, copied):
            assert texts(other) == texts(engine)
            assert_same(outputs(other), outputs(engine))
            np.testing.assert_array_equal(other.score_ceiling, engine.score_ceiling)
        for each in (engine, resumed, copied):
            each.step(actuation[k])
            each.reset(np.array([k % 3 == 0, k % 4 == 0, False]))


def test_torchrl_environments_follow_the_stream():
    env = SoftRobotEnv(SHORT, draw, 4, material="reactive", seed=2, num_threads=1, grid_shape=GRID)
    check_env_specs(env)
    assert "observation" not in env.observation_spec.keys()
    assert (env.num_designs, env.changes_bodies) == (4, True)
    env.set_seed(2)
    state = env.reset()
    seen = []
    for _ in range(8):
        seen.append(tuple(env.bodies))
        cells = torch.zeros(4, *GRID, dtype=torch.uint8)
        for world, body in enumerate(env.bodies):
            cells[world, : body.rows, : body.cols] = torch.tensor(body.grid)
        assert torch.equal(state["types"][..., 0], cells.flatten(1))
        assert torch.equal(state["occupancy"], cells.flatten(1) > 0)
        assert torch.equal(state["actuators"], cells.flatten(1) > 2)
        earlier, action = state["types"].clone(), env.rand_action(state)
        result, state = env.step_and_maybe_reset(action)
        assert torch.equal(result["next", "types"], earlier), "an episode ends with its own body"
        assert torch.equal(result["types"], earlier)
    assert len(set(seen)) == 3
    again = SoftRobotEnv(SHORT, draw, 4, material="reactive", seed=2, num_threads=1, grid_shape=GRID)
    again.reset()
    assert again.bodies == seen[0]


def test_saved_torchrl_environments_go_on_exactly():
    for make in (
        lambda seed: SoftRobotEnv(SHORT, draw_design, 3, seed=seed, num_threads=1, grid_shape=GRID),
        lambda seed: population_env(SHORT, draw_design, seed=seed, num_threads=1, grid_shape=GRID, num_bodies=3),
    ):
        env, other = make(1), make(2)
        env.rollout(5, break_when_any_done=False)
        file = io.BytesIO()
        torch.save(env.state_dict(), file)
        file.seek(0)
        other.load_state_dict(torch.load(file, weights_only=True))
        assert other.bodies == env.bodies
        for each in (env, other):
            torch.manual_seed(0)
            each.data = each.rollout(7, break_when_any_done=False, auto_reset=True)
        assert (env.data == other.data).all()


def test_agents_of_a_population_get_new_bodies_when_they_restart():
    env = population_env(SHORT, draw, 2, grid_shape=GRID, num_bodies=3, seed=4, num_threads=1)
    worlds = SoftRobotEnv(SHORT, draw, 6, grid_shape=GRID, seed=4, num_threads=1)
    assert env.agent_names == ["body_0", "body_1", "body_2"]
    assert env.bodies == env.worlds.bodies[:3] != env.worlds.bodies[3:], "copies are populations of their own"
    state, flat = env.reset(), worlds.reset()
    flags = torch.tensor([[False, True, False], [False, False, True]])
    for data in (state["bodies"], flat.reshape(2, 3)):
        assert (data["types"] == state["bodies", "types"]).all()
    before = env.worlds.bodies
    state["bodies", "_reset"] = flags[..., None]
    flat["_reset"] = flags.reshape(6, 1)
    state, flat = env.reset(state), worlds.reset(flat)
    assert torch.equal(state["bodies", "voxels"].flatten(0, 1), flat["voxels"])
    assert [one is other for one, other in zip(env.worlds.bodies, before, strict=True)] == (~flags).flatten().tolist()


def test_a_task_may_watch_the_robot_of_a_stream_but_not_look_at_its_points():
    engine = stream(replace(SHORT, watches=("robot",)), seed=3)
    for _ in range(4):
        watched, robot = engine.snapshot.objects["robot"], engine.snapshot.robot
        np.testing.assert_array_equal(watched.relative, robot.relative)
        np.testing.assert_array_equal(watched.com, robot.com)
        engine.step(np.ones((3, 16)))
        engine.reset()
    looking = replace(SHORT, floor=Window(("ground", "robot")))
    make_engine(looking, [SMALL, SMALL])
    for bodies in ([SMALL, TALL], draw):
        with pytest.raises(ValueError, match="floor: objects: a window over the robot itself needs bodies that are"):
            make_engine(looking, bodies, grid_shape=GRID)


def test_a_policy_learns_from_a_stream():
    def make_env(**options):
        return SoftRobotEnv(SHORT, draw, material="reactive", num_threads=1, grid_shape=GRID, **options)

    result = Trainer(make_env, PPOConfig(total_steps=32, num_worlds=4, rollout_steps=4, eval_worlds=2)).train()
    first = make_env(num_worlds=2, seed=0)
    assert len(result.final.score) == len(first.bodies)
    with pytest.raises(ValueError, match="a stream of bodies needs 'shared'"):
        Trainer(make_env, PPOConfig(total_steps=32, num_worlds=4, sharing="independent")).train()


def test_tables_of_former_robots_are_given_back():
    ground = World.load("Walker-v0").objects
    rng = np.random.default_rng(0)
    robots = [WorldObject("robot", draw(rng).grid, (1, 1)) for _ in range(60)]
    simulator = Simulator([(robot, *ground) for robot in robots[:8]], num_threads=1, grid_shape=GRID)
    for turn in range(3):
        for number, robot in enumerate(robots):
            simulator.set_robot(robot, (number + turn) % 8)
        storage = simulator.storage
        assert len(storage.ints) == len(storage.floats) <= 10
        assert len(storage.terrain_ints) == 1
    with pytest.raises(ValueError, match=r"grid_shape: got \(4, 4\), the robots need at least \(4, 5\)"):
        simulator.set_robot(WorldObject("robot", cm.robots["Walk_Bot"].grid, (1, 1)), 0)


def test_pictures_and_contacts_are_of_the_present_body():
    engine = stream(bodies=cycle([TALL, SMALL, WIDE]), num_worlds=1)
    renderer, contact = Renderer(engine, 160, 80), GroundContact(engine)
    for body in (TALL, SMALL, WIDE, TALL):
        engine.reset()
        single = make_engine("Walker-v0", body, grid_shape=GRID)
        for _ in range(3):
            np.testing.assert_array_equal(renderer.frame(), Renderer(single, 160, 80).frame())
            np.testing.assert_array_equal(contact.now(), GroundContact(single).now())
            assert len(contact.cells) == Body(body).n_voxels


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bodies": draw, "grid_shape": None}, "grid_shape: a stream of bodies .* needs it"),
        ({"bodies": iter([SMALL]), "grid_shape": None}, "grid_shape: a stream of bodies .* needs it"),
        ({"bodies": draw, "grid_shape": (4, 0)}, r"grid_shape: got \(4, 0\), at least \(1, 1\)"),
        ({"bodies": draw, "grid_shape": 4}, r"grid_shape: got 4, expected \(rows, columns\)"),
        ({"bodies": [SMALL, TALL], "grid_shape": (3, 2)}, r"grid_shape: got \(3, 2\), at least \(3, 3\)"),
        ({"bodies": draw, "num_worlds": 0}, "num_worlds: got 0"),
        ({"bodies": draw, "stiffness": np.ones((4, 4))}, r"stiffness: a stream gives it with each body"),
        ({"bodies": cycle(["Walk_Bot"])}, r"'SHHHR/.*' of shape \(4, 5\), larger than grid_shape \(4, 4\)"),
        ({"bodies": cycle(["HS/.R/H."])}, "bodies: the stream gave 'HS/.R/H.': body .* one piece"),
        ({"bodies": lambda rng: None}, "bodies: the stream gave None"),
        ({"bodies": cycle([(SMALL, np.ones((3, 3)))])}, r"stiffness: got shape \(3, 3\), expected the body's \(2, 3\)"),
        ({"bodies": cycle([(SMALL, np.full((2, 3), 9.0))])}, "from 1.0 to 9.0"),
        ({"bodies": cycle([(SMALL, np.ones((2, 3)))]), "material": "reactive"}, "in the reactive setting it is part"),
        ({"bodies": iter([SMALL])}, "the stream has ended after 1"),
        ({"task": "Lifter-v0", "bodies": cycle(["H" * 12]), "grid_shape": (1, 12)}, "'HHHHHHHHHHHH' does not fit in L"),
    ],
)
def test_what_no_stream_can_be_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        stream(**{"num_worlds": 2} | options)


def test_a_body_that_does_not_fit_later_changes_nothing():
    engine = stream(bodies=iter([SMALL, TALL, WIDE, "Walk_Bot"]), num_worlds=2)
    engine.step(np.ones((2, 16)))
    before = outputs(engine)
    with pytest.raises(ValueError, match="larger than grid_shape"):
        engine.reset()
    assert_same(outputs(engine), before)


def test_environments_of_equal_bodies_refuse_a_stream():
    with pytest.raises(ValueError, match="grid: expected equally long rows of numbers, got <function"):
        gymnasium.make("evogymcm/Walker-v0", body=draw)
    for make in (
        lambda: gymnasium.make_vec("evogymcm/Walker-v0", num_envs=2, body=cycle([SMALL])),
        lambda: parallel_env("Walker-v0", draw),
    ):
        with pytest.raises(ValueError, match="a stream, which"):
            make()
    for options in ({}, {"num_bodies": 0}):
        with pytest.raises(
            ValueError, match=r"num_bodies \(needed under a stream\): got .*, expected a whole number of at least 1"
        ):
            population_env("Walker-v0", draw, grid_shape=GRID, **options)
    with pytest.raises(ValueError, match="num_bodies: got 3, allowed is 2, the number of bodies"):
        population_env("Walker-v0", [SMALL, TALL], num_bodies=3)


def test_a_grid_for_more_than_the_present_bodies():
    """Fixed bodies in a larger grid do the same; their cells stand elsewhere in it."""
    wide, narrow = make_engine(bodies=SMALL, grid_shape=(3, 5)), make_engine(bodies=SMALL)
    cells = np.flatnonzero(wide.occupancy[0])
    assert cells.tolist() == [0, 1, 2, 5, 7]
    actions = np.random.default_rng(0).uniform(0.6, 1.6, (6, 15))
    for row in actions:
        wide.step(row[None])
        narrow.step(row.reshape(3, 5)[None, :2, :3].reshape(1, 6))
        np.testing.assert_array_equal(wide.flat, narrow.flat)
    assert TaskEngine("Walker-v0", SMALL, grid_shape=[3, 5], num_threads=1).grid_shape == (3, 5)
