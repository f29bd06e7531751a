"""Readings against slow numpy twins: hull area, orientation, elevation windows, spans."""

import math

import numpy as np
import pytest

from evogymcm.sim.lanes import N_LANES
from evogymcm.sim.readings import N_SUMS, new_readings, read_object, read_window
from evogymcm.sim.springs import VX, VY, X, Y
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

LANE_3 = np.where(np.arange(N_LANES) == 3, 0, -1)  # one world, in a lane that is not the first


def as_state(xy, velocity=None):
    """A block's points with (2, n) positions in lane 3 and nonsense elsewhere."""
    points = np.full((20, xy.shape[1], N_LANES), 1e9)
    points[[X, Y], :, 3] = xy
    points[[VX, VY], :, 3] = 0.0 if velocity is None else velocity
    return points


def read(was, now, velocity=None):
    n = was.shape[1]
    readings, hull, sums = new_readings(1, n), np.zeros((2, 2 * n + 2), np.int64), np.zeros((N_SUMS, 1, N_LANES))
    read_object(
        as_state(now, velocity),
        LANE_3,
        np.arange(n),
        was.T.copy(),
        True,
        hull,
        sums,
        readings.numbers,
        readings.relative,
    )
    return readings


def window(terrain, com, radius=5, is_ceiling=False, moving=None):
    fixed = np.ascontiguousarray((terrain / 0.1).T)
    fixed = fixed[np.argsort(fixed[:, 0], kind="stable")]
    points = as_state(np.zeros((2, 0)) if moving is None else moving)
    out = np.full((1, 2 * radius + 1), np.nan)
    numbers = np.arange(points.shape[1])
    read_window(points, LANE_3, fixed, numbers, np.array([com]), radius, is_ceiling, out)
    return out[0]


def lattice(cells):
    """(2, n) metres of the corners of cells (column, row)."""
    corners = {(x + i, y + j) for x, y in cells for i in (0, 1) for j in (0, 1)}
    return np.array(sorted(corners), float).T * 0.1


SHAPES = [  # cells, area of the convex hull in square voxels
    ([(0, 0)], 1.0),
    ([(x, y) for x in range(3) for y in range(2)], 6.0),
    ([(0, 0), (1, 0), (0, 1)], 3.5),  # an L
    ([(0, 0), (1, 0), (2, 0), (1, 1)], 5.0),  # an upside-down T
    ([(1, 0), (0, 1), (1, 1), (2, 1), (1, 2)], 7.0),  # a cross
]


@pytest.mark.parametrize(("cells", "area"), SHAPES)
def test_hull_area_of_known_shapes(cells, area):
    xy = lattice(cells)
    for angle in (0.0, 0.4, 2.0):
        turned = rotation(angle) @ xy + [[3.0], [1.0]]
        np.testing.assert_allclose(read(xy, turned).hull_area, 0.01 * area, rtol=1e-12)


def test_hull_area_against_slow_twin():
    rng = np.random.default_rng(0)
    for n in (3, 4, 9, 20):
        xy = rng.normal(size=(2, n))
        np.testing.assert_allclose(read(xy, xy).hull_area, slow_hull_area(xy), rtol=1e-12)
    xy = np.repeat(lattice(SHAPES[2][0]), 2, axis=1)  # coincident points
    np.testing.assert_allclose(read(xy, xy).hull_area, 0.035, rtol=1e-12)
    line = np.array([[0.0, 0.1, 0.3], [0.0, 0.1, 0.3]])
    np.testing.assert_allclose(read(line, line).hull_area, 0.0, atol=1e-15)


def test_centre_velocity_and_span():
    rng = np.random.default_rng(1)
    xy, velocity = rng.normal(size=(2, 2, 12))
    readings = read(xy, xy, velocity)
    np.testing.assert_allclose(readings.com[0], xy.mean(1), rtol=0, atol=1e-15)
    np.testing.assert_allclose(readings.velocity[0], velocity.mean(1), rtol=0, atol=1e-15)
    np.testing.assert_allclose(readings.relative[0], xy - xy.mean(1, keepdims=True), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(readings.low[0], xy.min(1))
    np.testing.assert_array_equal(readings.high[0], xy.max(1))


@pytest.mark.parametrize("angle", [0.3, 1.0, math.pi / 2, 2.5, 3.1, 3.2, 4.0, 5.5, 6.2])
def test_orientation_of_a_rigid_turn_is_its_angle(angle):
    was = lattice(SHAPES[2][0])
    now = rotation(angle) @ was + [[5.0], [2.0]]
    got = read(was, now).orientation[0]
    np.testing.assert_allclose(got, angle, rtol=0, atol=2e-7)  # EvoGym's pi has eight digits
    np.testing.assert_allclose(got, slow_orientation(was, now), rtol=0, atol=1e-9)


def test_orientation_against_slow_twin():
    rng = np.random.default_rng(2)
    was = lattice(SHAPES[3][0])
    for angle in np.linspace(0.1, 6.1, 9):
        now = rotation(angle) @ was + rng.normal(scale=0.02, size=was.shape)
        np.testing.assert_allclose(read(was, now).orientation[0], slow_orientation(was, now), rtol=0, atol=1e-9)


def test_orientation_at_reset_is_small():
    # Cosines that round to more than 1 count as 0.99999, which is 0.0045: so it is in EvoGym.
    was = lattice(SHAPES[4][0])
    assert 0.0 <= read(was, was).orientation[0] <= 0.0045


def test_orientation_with_a_point_at_the_centre():
    was = np.array([[0.0, 1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, -1.0]])
    now = rotation(1.0) @ was
    np.testing.assert_allclose(read(was, now).orientation[0], 1.0, rtol=0, atol=1e-12)


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
    rng = np.random.default_rng(3)
    was = rng.normal(size=(2, 8))
    was -= was.mean(1, keepdims=True)
    for angle in np.concatenate([np.linspace(1e-3, math.pi - 1e-3, 40), [1.0471975, 1.0471976, 2.0943951, 2.0943952]]):
        got = read(was, rotation(angle) @ was).orientation[0]
        cosine = np.clip(np.cos(angle), -1, 1)
        # What the cosine's own rounding leaves, a few units in the last place otherwise.
        assert abs(got - angle) <= 4e-16 / math.sqrt(1 - cosine**2) + 1e-15
