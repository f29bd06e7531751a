"""Readings against slow numpy twins: hull area, orientation, elevation windows, spans."""

import math

import numpy as np
import pytest

from evogymcm.sim.kernels.readings import CENTRE, N_NUMBERS, N_SCRATCH, new_readings, read_object, read_window
from tests.envs.tools import (
    PAPER_ROBOTS,
    TALL,
    make_engine,
    rotation,
    slow_hull_area,
    slow_orientation,
    slow_window,
    step_randomly,
)
from tests.sim.tools import in_air, simulator

NOTHING = np.zeros((2, 0))
WORLD = 1  # the one that is read; the robots of its neighbours are far out
L, T, CROSS = "H./HH", ".H./HHH", ".H./HHH/.H."
LINE = "HHHHH"  # enough points for what is not to look like a body at all


def set_robots(text, now, velocity=None):
    """A simulator whose robots, made from `text` at the origin, have their first points at (2, n) positions."""
    sim = simulator(*[in_air(text, (0, 0))] * 3)
    for world in range(3):
        xy, v = sim.points(world), sim.velocities(world=world)
        xy[:] = 1e9 if world != WORLD else now
        if velocity is not None:
            v[:] = velocity
        sim.set_points(xy, v, xy, world)
    return sim


def at_reset(text):
    """(2, n) positions of a robot at the origin."""
    return simulator(in_air(text, (0, 0))).positions()


def read(text, now, velocity=None):
    sim, n = set_robots(text, now, velocity), now.shape[1]
    readings = new_readings(3, n)
    read_object(sim.storage, np.array([WORLD]), 0, True, np.zeros(N_SCRATCH * (n + 2)), *readings)
    others = np.delete(readings.numbers, WORLD, 0), np.delete(readings.relative, WORLD, 0)
    assert not any(values.any() for values in others)
    return type(readings)(readings.numbers[[WORLD]], readings.relative[[WORLD]])


def window(terrain, com, radius=5, is_ceiling=False, moving=NOTHING):
    """A window over fixed and moving points, (2, n) metres."""
    fixed = np.ascontiguousarray((terrain / 0.1).T)
    fixed = fixed[np.argsort(fixed[:, 0], kind="stable")]
    n = moving.shape[1]
    sim = set_robots("H" * max(n // 2 - 1, 1), moving if n else 0.0)
    out, numbers = np.full((3, 2 * radius + 1), np.nan), np.zeros((3, N_NUMBERS))
    numbers[WORLD, CENTRE : CENTRE + 2] = np.array(com) / 0.1
    places = sim.object("robot", WORLD).places[:n]
    read_window(sim.storage, np.array([WORLD]), fixed, places, numbers, radius, is_ceiling, out)
    assert np.isnan(np.delete(out, WORLD, 0)).all()
    return out[WORLD]


def lattice(cells):
    """(2, n) metres of the corners of cells (column, row)."""
    corners = {(x + i, y + j) for x, y in cells for i in (0, 1) for j in (0, 1)}
    return np.array(sorted(corners), float).T * 0.1


# Robots, and the areas of their convex hulls in square voxels.
SHAPES = [("H", 1.0), ("HHH/HHH", 6.0), (L, 3.5), (T, 5.0), (CROSS, 7.0)]


@pytest.mark.parametrize(("text", "area"), SHAPES)
def test_hull_area_of_known_shapes(text, area):
    xy = at_reset(text)
    for angle in (0.0, 0.4, 2.0):
        turned = rotation(angle) @ xy + [[3.0], [1.0]]
        np.testing.assert_allclose(read(text, turned).hull_area, 0.01 * area, rtol=1e-12)


def test_hull_area_against_slow_twin():
    rng = np.random.default_rng(0)
    for text in ("H", L, "HHH/HHH", LINE):
        xy = rng.normal(size=at_reset(text).shape)
        np.testing.assert_allclose(read(text, xy).hull_area, slow_hull_area(xy), rtol=1e-12)
    xy = np.repeat(at_reset("HH"), 2, axis=1)  # coincident points
    np.testing.assert_allclose(read(LINE, xy).hull_area, 0.02, rtol=1e-12)
    line = np.repeat([[0.0, 0.1, 0.3, 0.35]], 2, axis=0)
    np.testing.assert_allclose(read("H", line).hull_area, 0.0, atol=1e-15)


def test_centre_velocity_and_span():
    rng = np.random.default_rng(1)
    xy, velocity = rng.normal(size=(2, 2, 12))
    readings = read(LINE, xy, velocity)
    np.testing.assert_allclose(readings.com[0], xy.mean(1), rtol=0, atol=1e-15)
    np.testing.assert_allclose(readings.velocity[0], velocity.mean(1), rtol=0, atol=1e-15)
    np.testing.assert_allclose(readings.relative[0], xy - xy.mean(1, keepdims=True), rtol=0, atol=1e-15)
    # As EvoGym's Python layer: it takes coordinates in voxels from the simulator, and makes metres of them.
    np.testing.assert_array_equal(readings.low[0], (xy / 0.1 * 0.1).min(1))
    np.testing.assert_array_equal(readings.high[0], (xy / 0.1 * 0.1).max(1))


@pytest.mark.parametrize("angle", [0.3, 1.0, math.pi / 2, 2.5, 3.1, 3.2, 4.0, 5.5, 6.2])
def test_orientation_of_a_rigid_turn_is_its_angle(angle):
    was = at_reset(L)
    now = rotation(angle) @ was + [[5.0], [2.0]]
    got = read(L, now).orientation[0]
    np.testing.assert_allclose(got, angle, rtol=0, atol=2e-7)  # EvoGym's pi has eight digits
    np.testing.assert_allclose(got, slow_orientation(was, now), rtol=0, atol=1e-9)


def test_orientation_against_slow_twin():
    rng = np.random.default_rng(2)
    was = at_reset(T)
    for angle in np.linspace(0.1, 6.1, 9):
        now = rotation(angle) @ was + rng.normal(scale=0.02, size=was.shape)
        np.testing.assert_allclose(read(T, now).orientation[0], slow_orientation(was, now), rtol=0, atol=1e-9)


def test_orientation_at_reset_is_small():
    # Cosines that round to more than 1 count as 0.99999, which is 0.0045: so it is in EvoGym.
    assert 0.0 <= read(CROSS, at_reset(CROSS)).orientation[0] <= 0.0045


def test_orientation_with_a_point_at_the_centre():
    was = at_reset("HH/HH") - 0.1
    assert np.abs(was).max(0).min() < 1e-15
    np.testing.assert_allclose(read("HH/HH", rotation(1.0) @ was).orientation[0], 1.0, rtol=0, atol=1e-12)


def test_window_of_flat_ground():
    ground = lattice([(x, 0) for x in range(30)])
    np.testing.assert_allclose(window(ground, (1.52, 0.35)), 0.25, rtol=0, atol=1e-12)  # the top, not the underside
    np.testing.assert_array_equal(window(ground, (1.52, 0.35), is_ceiling=True), 0.5)  # nothing above
    np.testing.assert_array_equal(window(ground, (1.52, 0.8)), 0.5)  # too far below
    np.testing.assert_array_equal(window(ground, (9.0, 0.35)), 0.5)  # no ground here


def test_window_leaves_out_points_on_a_border():
    ground = lattice([(x, 0) for x in range(30)])
    # With the COM at half a voxel, all lattice lines lie on borders of columns.
    com = (12.5 * 0.1, 0.35)
    np.testing.assert_array_equal(com[0] / 0.1, 12.5)
    expected = slow_window(ground, np.array(com), 5, False)
    np.testing.assert_array_equal(window(ground, com), expected)
    assert (expected == 0.5).sum() > 5
    exact = np.array([[12.0, 13.0, 13.0], [1.0, 1.0, 3.5]]) * 0.1  # left border, right border, at the COM's height
    np.testing.assert_array_equal(window(exact, com, radius=1), slow_window(exact, np.array(com), 1, False))


def test_window_against_slow_twin():
    rng = np.random.default_rng(3)
    terrain = lattice([(x, int(y)) for x in range(40) for y in rng.integers(0, 9, 2)])
    moving = rng.uniform((0.5, 0.0), (3.0, 1.0), (30, 2)).T
    both = np.concatenate([terrain, moving], axis=1)
    for radius in (2, 3, 5):
        for is_ceiling in (False, True):
            for com in [*rng.uniform((0.0, 0.0), (4.0, 1.0), (20, 2)), *(0.05 * rng.integers(0, 60, (20, 2)))]:
                got = window(terrain, com, radius, is_ceiling, moving)
                np.testing.assert_allclose(got, slow_window(both, com, radius, is_ceiling), rtol=0, atol=1e-12)


@pytest.mark.parametrize("task", ["DownStepper-v0", "CaveCrawler-v0", "BridgeWalker-v0", "AreaMaximizer-v0"])
@pytest.mark.parametrize("body", ["paper", TALL])
def test_flat_observation_against_slow_twins(task, body):
    engine = make_engine(task, PAPER_ROBOTS[task] if body == "paper" else body)
    was = engine.simulator.positions("robot", 0)
    area = slow_hull_area(was)
    step_randomly(engine, 30)
    now, velocity = engine.simulator.positions("robot", 0), engine.simulator.velocities("robot", 0)
    com = now.mean(1)
    parts = {
        "velocity": velocity.mean(1),
        "orientation": np.array([slow_orientation(was, now)]),
        "relative": (now - com[:, None]).ravel(),
    }
    for name, seen, is_ceiling in (("floor", engine.task.floor, False), ("ceiling", engine.task.ceiling, True)):
        if seen:
            terrain = np.concatenate([engine.simulator.positions(o, 0) for o in seen.objects], axis=1)
            parts[name] = slow_window(terrain, com, seen.radius, is_ceiling)
    expected = np.concatenate([parts[name] for name in engine.task.observes])
    np.testing.assert_allclose(engine.flat[0], expected, rtol=0, atol=1e-9)
    if task == "AreaMaximizer-v0":
        np.testing.assert_allclose(engine.returns[0], 10 * (slow_hull_area(now) - area), rtol=0, atol=1e-12)


def test_orientation_to_the_last_digits():
    was = at_reset("HHH")
    for angle in np.concatenate([np.linspace(1e-3, math.pi - 1e-3, 40), [1.0471975, 1.0471976, 2.0943951, 2.0943952]]):
        got = read("HHH", rotation(angle) @ was).orientation[0]
        cosine = np.clip(np.cos(angle), -1, 1)
        # What the cosine's own rounding leaves, a few units in the last place otherwise.
        assert abs(got - angle) <= 4e-16 / math.sqrt(1 - cosine**2) + 1e-15
