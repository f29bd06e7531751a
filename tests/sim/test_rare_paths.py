"""What kernels seldom do, in scenes small enough to run without the JIT too (scripts/coverage.sh)."""

import numpy as np
import pytest

from evogymcm.sim.constants import EDGE_CONSTANT, FIXED, SOFT, Physics
from evogymcm.sim.world import World, WorldObject
from tests.sim.test_contact import assert_close, compare
from tests.sim.tools import (
    SMALL,
    all_points,
    all_state,
    forget_room,
    grid_of,
    place_points,
    placed,
    room_of,
    run_substeps,
    simulator,
    springs_of,
)
from tests.sim.twin import Twin


def objects_of(*others):
    """A robot out of the way of other objects, given as (name, text, place)."""
    world = World(20, 20)
    for name, text, origin in others:
        world = world.place(WorldObject(name, grid_of(text), origin))
    return world.place(WorldObject("robot", grid_of("H"), (15, 15))).simulation_order()


@pytest.mark.parametrize("seed", range(4))
def test_an_anchored_object_on_fixed_voxels(seed):
    """Its own corners in the floor's voxels, and the floor's corners in its own."""
    assert compare(objects_of(("floor", "FFFF", (4, 3)), ("bridge", "FSSF", (4, 4))), seed, spread=0.01) > 0


@pytest.mark.parametrize("seed", range(4))
def test_an_anchored_object_that_is_bent_into_itself(seed):
    objects = objects_of(("comb", "FFF/S.S", (4, 4)))
    sim, twin, rng = simulator(objects), Twin(objects), np.random.default_rng(seed)
    free = ~twin.fixed[:, None]
    twin.x = twin.x + free * rng.uniform(-0.004, 0.004, twin.x.shape)
    (corner,) = np.flatnonzero(np.abs(twin.x - [0.5, 0.4]).max(1) < 0.01)
    twin.x[corner] = [0.62, 0.42]  # from the left leg into the right one
    twin.old = twin.x.copy()
    place_points(sim, twin.x, twin.v, twin.old)
    assert twin.contacts()[corner].any()
    assert not run_substeps(sim).any()
    twin.substep()
    assert_close(sim, twin)


@pytest.mark.parametrize("seed", range(2))
def test_a_body_with_points_inside(seed):
    """The middle of a body has no part in contact."""
    world = World.from_picture("FFFFFFFF\nFFFFFFFF")
    assert compare(placed("SSSS/SHHS/SSSS/SSSS", world, (2, 2)), seed, shift=(0.03, -0.01)) > 0


def test_contact_without_stiffness_divides_by_nothing():
    world = World.from_picture("FFFFFFFF\nFFFFFFFF")
    objects = placed("SHS/S.S", world, (2, 2))
    twin, sim = Twin(objects), simulator(objects, physics=Physics(contact_stiffness=0.0))
    robot = twin.slices["robot"]
    twin.x[robot] += [0.03, -0.02]
    twin.old = twin.x.copy()
    twin.old[robot, 1] += 1e-4  # falling: only the damping is left of the contact
    place_points(sim, twin.x, twin.v, twin.old)
    assert twin.contacts().any()
    assert not run_substeps(sim).any()
    assert np.isfinite(all_points(sim)).all()
    assert all_points(sim)[1][robot, 1].max() > 0.0


def test_lists_of_candidates_and_contacts_grow_unseen():
    sim, roomy = simulator(placed(SMALL)), simulator(placed(SMALL))
    forget_room(sim)
    for s in (sim, roomy):
        s.step(np.full((1, 6), 0.8))
    assert all_state(sim).tobytes() == all_state(roomy).tobytes()
    assert all(1 < got < made for got, made in zip(room_of(sim), room_of(roomy), strict=True))


def test_stiffness_leaves_the_springs_of_other_objects():
    world = World(20, 10).place(WorldObject("block", grid_of("SS"), (10, 1)))
    sim = simulator(placed(SMALL, world))
    before = springs_of(sim)
    sim.set_stiffness(np.full((1, 6), 2.0))
    is_changed = springs_of(sim).constants != before.constants
    is_robots = (before.ends < sim.positions().shape[1]).all(1)
    assert not is_robots.all()
    np.testing.assert_array_equal(is_changed, is_robots)


def test_the_constant_of_an_edge_between_fixed_and_soft_voxels():
    """Its ends are fixed points, so that no roll-out can tell; only the constant itself can be looked at."""
    objects = objects_of(("bridge", "FS", (4, 4)))
    for rule, expected in (("mean_factor", 3e8 / 6), ("mean_stiffness", (3e8 / 3.5 + 3e8 / 6) / 2)):
        sim = simulator(objects, edge_rule=rule)
        springs, is_fixed = springs_of(sim), np.concatenate([placed.topology.is_fixed for placed in sim.objects()])
        np.testing.assert_allclose(springs.constants[is_fixed[springs.ends].all(1)], [expected], rtol=1e-14)
    np.testing.assert_allclose(EDGE_CONSTANT[[FIXED, SOFT]], [3e8 / 3.5, 3e8 / 6], rtol=1e-14)
