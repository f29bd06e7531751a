"""Springs, integration and limits against the slow twin, away from contact; and what holds for any springs."""

import numpy as np
import pytest

from evogymcm.sim.constants import Physics
from evogymcm.sim.world import World, WorldObject
from tests.sim.tools import all_points, grid_of, in_air, place_points, run_substeps, simulator, springs_of
from tests.sim.twin import Twin

MIXED = "RSH/V.S/SHV"
BRIDGE = "FSSF"


def close(ours, twins):
    """Both round each operation, in other orders; velocities are up to 100."""
    np.testing.assert_allclose(ours, twins, rtol=1e-11, atol=1e-12)


def one_substep(objects, seed, spread, speed, shift=0.0, stiffness=None, actuation=None, edge_rule="mean_factor"):
    """A random state after one substep: of the simulator, and of the twin. Positions and velocities, stacked."""
    rng = np.random.default_rng(seed)
    twin, sim = Twin(objects), simulator(objects, edge_rule=edge_rule)
    free = ~twin.fixed[:, None]
    twin.x = twin.x + free * (rng.uniform(-spread, spread, twin.x.shape) + np.array([0, shift]))
    twin.v = free * rng.uniform(-speed, speed, twin.x.shape)
    twin.old = twin.x - free * rng.uniform(-speed, speed, twin.x.shape) * 1e-4
    place_points(sim, twin.x, twin.v, twin.old)
    neutral = np.ones((1, sim.n_cells))
    sim.step(neutral if actuation is None else actuation[None], None if stiffness is None else stiffness[None])
    place_points(sim, twin.x, twin.v, twin.old)  # back from the step that has set the stiffness
    if actuation is not None:
        twin.drive(actuation)
    if stiffness is not None:
        twin.stiffen(stiffness)
    assert not run_substeps(sim, actuation=None if actuation is None else actuation[None]).any()
    twin.substep()
    return np.concatenate(all_points(sim)), np.concatenate([twin.x, twin.v])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("spread", "speed"), [(0.0, 0.0), (0.004, 5.0), (0.03, 5.0)], ids=["at rest", "within limits", "beyond limits"]
)
def test_a_substep_in_the_air_is_the_twins(seed, spread, speed):
    ours, twins = one_substep(in_air(MIXED), seed, spread, speed)
    close(ours, twins)


@pytest.mark.parametrize("seed", range(3))
def test_a_substep_on_the_floor_is_the_twins(seed):
    ours, twins = one_substep(in_air(MIXED, at=(4, 0)), seed, 0.004, 5.0, shift=-0.003)
    close(ours, twins)


@pytest.mark.parametrize("seed", range(3))
def test_a_substep_with_actions_is_the_twins(seed):
    rng = np.random.default_rng(seed)
    ours, twins = one_substep(
        in_air(MIXED), seed, 0.01, 2.0, stiffness=rng.uniform(0.5, 2, 9), actuation=rng.uniform(0.6, 1.6, 9)
    )
    close(ours, twins)


@pytest.mark.parametrize("seed", range(2))
def test_a_substep_of_an_anchored_object_is_the_twins(seed):
    world = World(30, 30).place(WorldObject("bridge", grid_of(BRIDGE), (2, 2)))
    objects = world.place(WorldObject("robot", grid_of("H"), (20, 20))).simulation_order()
    ours, twins = one_substep(objects, seed, 0.004, 1.0)
    close(ours, twins)


def test_internal_forces_sum_to_zero():
    objects = in_air(MIXED)
    sim, twin, rng = simulator(objects), Twin(objects), np.random.default_rng(0)
    still = simulator(objects, physics=Physics(gravity=0.0, drag=0.0))
    x = twin.x + rng.uniform(-0.03, 0.03, twin.x.shape)
    for s, expected in ((still, 0.0), (sim, -110e-4)):
        place_points(s, x, np.zeros_like(x), x)
        run_substeps(s)
        v = all_points(s)[1]
        np.testing.assert_allclose(v.mean(0), [0, expected], atol=1e-4 * abs(expected) + 1e-12)
    np.testing.assert_allclose(all_points(still)[0].mean(0), x.mean(0), atol=1e-14)  # the limits move no mass either


def test_a_free_fall_is_a_parabola():
    sim = simulator(in_air("SHS"), physics=Physics(drag=0.0))
    start = sim.positions()
    sim.step(np.ones((1, 3)))
    t = 30e-4
    np.testing.assert_allclose(sim.positions() - start, [[0.0] * 8, [-55 * t * t] * 8], atol=1e-12)
    np.testing.assert_allclose(sim.velocities(), [[0.0] * 8, [-110 * t] * 8], atol=1e-11)


def test_the_limits_hold_long_springs_short():
    sim = simulator(in_air("SHS/RRR"))
    for _ in range(20):
        sim.step(np.full((1, 6), 3.0))
    springs, x = springs_of(sim), all_points(sim)[0]
    stress = np.hypot(*(x[springs.ends[:, 0]] - x[springs.ends[:, 1]]).T) / springs.rest
    assert 1.1 < stress.max() < 1.4
    rigid = np.hypot(*(x[springs.rigid[:, 0]] - x[springs.rigid[:, 1]]).T) / 0.1
    assert rigid.min() > 0.92
    assert rigid.max() < 1.08


def test_mirrored_bodies_of_one_material_mirror_each_other():
    sim = simulator(in_air("HHH/H.H/H.."), in_air("HHH/H.H/..H"))
    actuation = np.random.default_rng(0).uniform(0.6, 1.6, (5, 3, 3))
    for numbers in actuation:
        sim.step(np.stack([numbers.ravel(), numbers[:, ::-1].ravel()]))
    left, right = sim.positions(world=0), sim.positions(world=1)
    middle = 0.1 * 4 + 0.15
    left = np.stack([2 * middle - left[0], left[1]])
    distance = np.abs(left[:, :, None] - right[:, None]).max(0)
    assert distance.min(0).max() < 1e-12
    assert distance.min(1).max() < 1e-12
