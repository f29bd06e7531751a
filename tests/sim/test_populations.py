"""Worlds of different robots, that change: each does what it does alone, to the last bit, and costs little memory."""

import copy
import pickle
from weakref import ref

import numpy as np
import pytest

from evogymcm.body import sample_body
from evogymcm.sim import designs
from evogymcm.sim.kernels.readings import ORIENTATION, new_readings, read_object
from evogymcm.sim.kernels.trees import build_tree
from evogymcm.sim.topology import CACHED
from evogymcm.sim.world import ROBOT, World, WorldObject
from tests.sim.test_contact import assert_close, compare
from tests.sim.test_simulator import BODIES, assert_equal_bits, random_actions, run
from tests.sim.tools import STANDARD, all_state, grid_of, in_air, place_points, placed, run_substeps, simulator
from tests.sim.twin import Twin

PLACED = ("package", "peg1", "peg2")


def robot_of(body, at):
    return WorldObject(ROBOT, body.grid, at, body.connections)


def random_robots(n, at, size=5, seed=0):
    rng = np.random.default_rng(seed)
    return [robot_of(sample_body((size, size), rng), at) for _ in range(n)]


def in_world(name, robots):
    world = World.load(name)
    return [world.place(robot).simulation_order() for robot in robots]


def live(sim, worlds, steps=12):
    """Steps some worlds while others wait, resets some, gives some another stiffness; `worlds` are their numbers."""
    rng = np.random.default_rng(1)
    actuation, stiffness = random_actions(64, sim.n_cells, steps)
    masks, resets, restiffened = rng.random((3, steps, 64)) < [[[0.7]], [[0.1]], [[0.1]]]
    for step in range(steps):
        sim.reset(resets[step, worlds])
        sim.set_stiffness(stiffness[step, worlds], restiffened[step, worlds])
        sim.step(actuation[step, worlds], mask=masks[step, worlds])
        sim.step(actuation[step, worlds], stiffness[step, worlds], masks[step, worlds] & masks[step - 1, worlds])


def test_a_population_equals_each_of_its_bodies_alone():
    """On several threads too: the bodies have more springs than it takes for them to pay."""
    worlds = in_world("BridgeWalker-v0", random_robots(64, (2, 5)))
    together, threaded = simulator(*worlds), simulator(*worlds, num_threads=3)
    everybody = np.arange(64)
    live(together, everybody)
    live(threaded, everybody)
    assert threaded._threads._pool is not None
    threaded.close()
    states = [all_state(together, world) for world in range(64)]
    assert_equal_bits(states, [all_state(threaded, world) for world in range(64)])
    assert len({state.tobytes() for state in states}) == 64
    for world in range(64):
        alone = simulator(worlds[world], grid_shape=together.grid_shape)
        live(alone, everybody[[world]])
        assert_equal_bits([all_state(alone)], [states[world]])


def test_a_replaced_robot_is_that_of_a_new_simulator():
    small, large = random_robots(3, (3, 3), 2), random_robots(2, (3, 3), 5)
    sim = simulator(*in_world("CaveCrawler-v0", small), grid_shape=(5, 5))
    untouched = simulator(*in_world("CaveCrawler-v0", small), grid_shape=(5, 5))
    actions = random_actions(3, 25)
    run(sim, *actions)
    run(untouched, *actions)
    sim.set_robot(large[0], 1)  # needs wider rows
    new = simulator(*in_world("CaveCrawler-v0", [small[0], large[0], small[2]]), grid_shape=(5, 5))
    assert_equal_bits([all_state(sim, 1)], [all_state(new, 1)])  # stiffness is 1 again
    ours, theirs, news = run(sim, actions[0]), run(untouched, actions[0]), run(new, actions[0])
    assert_equal_bits(ours, [theirs[0], news[1], theirs[2]])
    sim.set_robot(small[1], 1)  # and back into rows that are too wide
    again = simulator(*in_world("CaveCrawler-v0", [large[1], small[1], small[1]]), grid_shape=(5, 5))
    sim.set_robot(large[1], 0)
    sim.set_robot(small[1], 2)
    assert_equal_bits(run(sim, *actions), run(again, *actions))
    with pytest.raises(ValueError, match=r"grid_shape: got \(5, 5\), the robots need at least \(6, 1\)"):
        sim.set_robot(WorldObject(ROBOT, grid_of("S/S/S/H/S/S"), (3, 3)), 0)


def test_robots_in_a_long_stream_leave_no_trace():
    sim = simulator(*in_world("Walker-v0", random_robots(4, (1, 1))))
    first = ref(sim._scene(0))
    sizes = []
    for k, robot in enumerate(random_robots(CACHED + 100, (1, 1), seed=1)):
        sim.set_robot(robot, k % 4)
        if k % 100 == 0:
            sim.step(np.ones((4, 25)))
            sizes.append(sum(array.nbytes for array in sim.storage))
    assert first() is None
    assert len(sim._designs.scenes) == 4
    assert len(sim.storage.ints) <= 8  # one more than worlds while a robot is replaced; the number of rows doubles
    assert sizes[-1] < 1.4 * sizes[0]  # as wide as the largest


def test_places_drawn_at_resets_without_end_are_not_all_kept(monkeypatch):
    monkeypatch.setattr(designs, "KEPT", 8)
    objects = placed(BODIES[0], "Catcher-v0", (19, 1))
    sim, rng = simulator(objects, objects, placed=PLACED), np.random.default_rng(0)
    for _ in range(60):
        sim.reset(offsets=rng.integers((-6, 0), (5, 6), (2, 2)))
    assert len(sim._designs._sceneries) <= 8
    assert len(sim.storage.terrain_ints) <= 16


def test_memory_of_a_world():
    """Of 64 different bodies with most of the cells filled; what a thread needs besides is needed once."""
    sim = simulator(*in_world("Walker-v0", random_robots(64, (1, 1))))
    sim.step(np.ones((64, 25)))
    storage = sim.storage
    assert sum(array[0].nbytes for array in (storage.state, storage.ints, storage.floats)) < 20e3
    assert len(storage.ints) <= 1.25 * 64  # with rows that are free
    once = (storage.terrain_ints, storage.terrain_floats, *sim._scratches[0])
    assert sum(array.nbytes for array in once) < 80e3


@pytest.mark.usefixtures("small_batches_pay")
@pytest.mark.parametrize("how", ["pickle", "deepcopy"])
def test_a_copy_goes_on_with_the_same_bits(how):
    """Also where robots were replaced, objects placed anew, and threads started."""
    objects = [placed(text, "Catcher-v0", (19, 1)) for text in BODIES]
    sim = simulator(*objects, placed=PLACED, num_threads=2, grid_shape=(4, 4))
    actuation, stiffness = random_actions(4, 16, 6)
    sim.reset(offsets=np.array([[1, 2], [0, 0], [-3, 5], [4, 1]]))
    sim.set_robot(WorldObject(ROBOT, grid_of("HSHS/V..V"), (19, 1)), 2)
    run(sim, actuation, stiffness)
    copied = pickle.loads(pickle.dumps(sim)) if how == "pickle" else copy.deepcopy(sim)
    assert copied.storage.state.ctypes.data % 64 == copied.storage.floats.ctypes.data % 64 == 0
    for s in (sim, copied):
        run(s, actuation)
        s.reset(np.array([True, False, False, True]), np.array([[2, 2], [0, 0], [0, 0], [-1, 3]]))
        s.set_robot(WorldObject(ROBOT, grid_of("HH"), (19, 1)), 1)
    assert_equal_bits(run(sim, actuation), run(copied, actuation))
    sim.close()


def test_objects_placed_at_a_reset_are_those_of_a_world_that_has_them_there():
    """Their trees too, which the last bits of coordinates shape, and the places that orientations count from."""
    robot, offset = placed(STANDARD, "Catcher-v0", (19, 1))[0], np.array([3, 2])
    world = World.load("Catcher-v0")
    moved = [
        WorldObject(o.name, o.grid, tuple(np.add(o.origin, offset * (o.name in PLACED)).tolist()), o.connections)
        for o in world.objects
    ]
    there = World(world.width + 9, world.height + 9, tuple(moved)).place(robot).simulation_order()
    sim, new = simulator(world.place(robot).simulation_order(), placed=PLACED), simulator(there, placed=PLACED)
    shapes = {name: sim.object(name).tree.children.tolist() for name in PLACED}
    actuation, _ = random_actions(1, 25, 40)
    run(sim, actuation[:3])
    sim.reset(offsets=offset[None])
    for name in PLACED:
        placed_there = sim.object(name)
        tree = build_tree(placed_there.topology, new.object(name).origin)
        np.testing.assert_array_equal(placed_there.tree.children, tree.children)
    assert shapes != {name: sim.object(name).tree.children.tolist() for name in PLACED}
    saved = []
    for s in (sim, new):
        run(s, actuation[:30])
        saved.append(s.state())
        run(s, actuation[30:])
    assert_equal_bits([all_state(sim)], [all_state(new)])
    number = [o.name for o in sim.objects()].index("package")
    package = [new_readings(1, len(sim.object("package").places)) for _ in range(3)]
    for s, readings in zip((sim, new), package, strict=False):
        read_object(s.storage, np.array([0]), number, False, np.zeros(999), *readings)
    assert package[0].numbers.tobytes() == package[1].numbers.tobytes()
    assert 1e-3 < package[0].numbers[0, ORIENTATION] % 6.28 < 6.27  # it has fallen
    other = simulator(world.place(robot).simulation_order(), placed=PLACED)  # where nothing was placed anew
    other.set_state(saved[0])
    assert_equal_bits(run(other, actuation[30:]), [all_state(sim)])
    read_object(other.storage, np.array([0]), number, False, np.zeros(999), *package[2])
    assert package[2].numbers.tobytes() == package[0].numbers.tobytes()


JOINED = np.array([(0, 2), (1, 3), (2, 3)]).T


@pytest.mark.parametrize("seed", range(4))
def test_voxels_joined_to_fixed_ones_on_one_side_only(seed):
    """Corners of fixed voxels that soft ones pull at, though these are no corners of their own."""
    half = WorldObject("half", grid_of("SF/FS"), (4, 3), JOINED)
    world = World(20, 20).place(half)
    assert compare(placed("SHS/S.S", world, (3, 5)), seed, shift=(0.04, -0.015)) > 0
    objects = world.place(WorldObject(ROBOT, grid_of("H"), (15, 15))).simulation_order()
    sim, twin = simulator(objects), Twin(objects)
    twin.x = twin.x + ~twin.fixed[:, None] * np.random.default_rng(seed).uniform(-0.01, 0.01, twin.x.shape)
    twin.old = twin.x.copy()
    place_points(sim, twin.x, twin.v, twin.old)
    for _ in range(5):
        assert not run_substeps(sim).any()
        twin.substep()
    assert_close(sim, twin)


def test_a_robot_of_one_voxel_and_one_of_a_hundred_stand_side_by_side():
    large = robot_of(sample_body((10, 10), np.random.default_rng(0)), (4, 10))
    worlds = [in_air("H"), World(30, 30).place(large).simulation_order()]
    sim = simulator(*worlds)
    actions = random_actions(2, sim.n_cells, 4)
    states = run(sim, *actions)
    for world in range(2):
        alone = simulator(worlds[world], grid_shape=(10, 10))
        assert_equal_bits(run(alone, *(a[:, [world]] for a in actions)), [states[world]])
