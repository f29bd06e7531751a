"""Contact against the slow twin: every pair of voxels, no lists."""

import numpy as np
import pytest

from evogymcm.sim.world import World, WorldObject
from tests.sim.tools import all_points, grid_of, in_air, place_points, placed, run_substeps, simulator
from tests.sim.twin import Twin

LEGGED = "SHS/S.S"


def random_state(twin, rng, spread, speed, shift):
    free = ~twin.fixed[:, None]
    twin.x = twin.x + free * rng.uniform(-spread, spread, twin.x.shape)
    robot = twin.slices["robot"]
    twin.x[robot] += shift
    twin.v = free * rng.uniform(-speed, speed, twin.x.shape)
    twin.old = twin.x - free * rng.uniform(-speed, speed, twin.x.shape) * 1e-4


def assert_close(sim, twin):
    """Both round each operation, in other orders; velocities are up to 1000."""
    ours = np.concatenate(all_points(sim))
    np.testing.assert_allclose(ours, np.concatenate([twin.x, twin.v]), rtol=1e-11, atol=1e-11)


def compare(objects, seed, spread=0.005, speed=3.0, shift=(0.0, 0.0)):
    """One substep from a random state, ours and the twin's. Returns how many points the contact pushes."""
    twin, sim = Twin(objects), simulator(objects)
    random_state(twin, np.random.default_rng(seed), spread, speed, np.array(shift))
    place_points(sim, twin.x, twin.v, twin.old)
    pushed = int(twin.contacts().any(1).sum())
    assert not run_substeps(sim).any()
    twin.substep()
    assert_close(sim, twin)
    return pushed


@pytest.mark.parametrize("seed", range(4))
def test_robot_on_terrain(seed):
    world = World.from_picture("FFFFFFFF\nFFFFFFFF")
    assert compare(placed(LEGGED, world, (2, 2)), seed, shift=(0.03, -0.02)) > 0


@pytest.mark.parametrize("seed", range(4))
def test_robot_between_walls(seed):
    world = World.from_picture("FF...F\nF....F\nFF...F\nFFFFFF")
    assert compare(placed(LEGGED, world, (2, 1)), seed, shift=(-0.025, -0.01)) > 0


@pytest.mark.parametrize("seed", range(4))
def test_robot_on_a_step(seed):
    world = World.from_picture("F...\nFF..\nFFFF")
    assert compare(placed("HS/SH", world, (1, 2)), seed, shift=(0.08, -0.02)) > 0


@pytest.mark.parametrize("seed", range(4))
def test_robot_on_a_free_block(seed):
    world = World(12, 12).place(WorldObject("block", grid_of("RR/RS"), (4, 4)))
    assert compare(placed(LEGGED, world, (3, 6)), seed, shift=(0.04, -0.015)) > 0


@pytest.mark.parametrize("seed", range(4))
def test_robot_on_a_bridge(seed):
    world = World(12, 12).place(WorldObject("bridge", grid_of("FSSSSSF"), (1, 4)))
    assert compare(placed(LEGGED, world, (2, 5)), seed, shift=(0.04, -0.015)) > 0


@pytest.mark.parametrize("seed", range(4))
def test_robot_against_itself(seed):
    """Legs that touch: within one object, every contact acts twice."""
    objects = in_air("SSS/H.S/H.S")
    twin, sim, rng = Twin(objects), simulator(objects), np.random.default_rng(seed)
    random_state(twin, rng, 0.004, 3.0, 0.0)
    low = twin.x[:, 1] < 1.05
    twin.x[low & (twin.x[:, 0] > 0.58)] -= [0.115, 0.0]  # the right leg's foot is bent over to the left one
    twin.old = twin.x.copy()
    place_points(sim, twin.x, twin.v, twin.old)
    assert twin.contacts().any()
    run_substeps(sim)
    twin.substep()
    assert_close(sim, twin)


def test_many_substeps_stay_with_the_twin():
    """Lists of candidates hold for several substeps; none may be missed in between."""
    world = World.from_picture("F.....\nFFFFFF")
    objects = placed("HSH/H.V", world, (1, 1))
    twin, sim = Twin(objects), simulator(objects)
    actuation = np.full(6, 1.6)
    shift = np.where(np.arange(len(twin.x))[:, None] < len(sim.positions().T), [0.03, 0.012], 0.0)  # no exact ties
    twin.x, twin.old = twin.x + shift, twin.old + shift
    place_points(sim, twin.x, twin.v, twin.old)
    twin.drive(actuation)
    for _ in range(3):
        sim.step(actuation[None])
        for _ in range(30):
            twin.substep()
    np.testing.assert_allclose(all_points(sim)[0], twin.x, rtol=0, atol=1e-11)
    assert np.ptp(twin.x[twin.slices["robot"], 1]) > 0.215  # taller than at rest


def test_a_robot_rests_on_the_ground():
    """Not deeper than the distance that contact adds to a depth, and at rest."""
    sim = simulator(placed(LEGGED, World.from_picture("FFFFFFFF\nFFFFFFFF"), (2, 2)))
    for _ in range(60):
        assert not sim.step(np.ones((1, 6)))[0]
    assert 0.195 < sim.positions()[1].min() < 0.21
    assert abs(sim.velocities()).max() < 1.5


def test_the_count_of_crowded_voxels_is_the_twins():
    """A robot is unstable where more pairs of its surface voxels overlap than it has surface voxels."""
    objects = in_air("SSSSS/H...H")
    rng, verdicts = np.random.default_rng(0), []
    for width in np.linspace(0.02, 0.3, 24):
        twin, sim = Twin(objects), simulator(objects)
        twin.x = twin.x + rng.uniform(-width, width, twin.x.shape)
        twin.old = twin.x.copy()
        place_points(sim, twin.x, twin.v, twin.old)
        count, limit = twin.crowding()
        verdicts.append(count > limit)
        assert run_substeps(sim)[0] == verdicts[-1], (width, count, limit)
    assert 4 < sum(verdicts) < 20
