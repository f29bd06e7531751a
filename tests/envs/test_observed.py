"""What is observed: voxels and their types, the features of the whole robot, in memory that stays as it was."""

import numpy as np
import pytest

import evogymcm as cm
from evogymcm.envs.voxels import ACTUATION, N_FEATURES, PLACE, POSITIONS, STIFFNESS, VELOCITIES
from tests.envs.tools import MATERIALS, SMALL, WIDE, make_engine, move, step_randomly


def test_arrays_of_a_step_are_not_written_again():
    engine = make_engine("Walker-v0", "Walk_Bot", 2)
    kept = [(engine.voxels, engine.flat, engine.com, engine.features)]
    copies = [tuple(np.array(values) for values in kept[0])]
    for _ in range(3):
        step_randomly(engine, 1)
        kept.append((engine.voxels, engine.flat, engine.com, engine.features))
        copies.append(tuple(np.array(values) for values in kept[-1]))
    for views, values in zip(kept, copies, strict=True):
        for view, value in zip(views, values, strict=True):
            np.testing.assert_array_equal(view, value)


def slow_voxels(engine, world):
    """The voxel features and types written out cell by cell; only for bodies whose points all lie apart at reset."""
    body = engine.bodies[world]
    spawn_x, spawn_y = engine.task.spawn
    fresh = make_engine(engine.task, body).simulator.positions("robot", 0)
    position = engine.simulator.positions("robot", world)
    velocity = engine.simulator.velocities("robot", world)
    _, columns = engine.grid_shape
    voxels = np.zeros((engine.occupancy.shape[1], N_FEATURES))
    types = np.zeros((engine.occupancy.shape[1], 5), int)

    def type_at(row, column):
        inside = 0 <= row < body.rows and 0 <= column < body.cols
        return int(body.grid[row, column]) if inside else 0

    for row, column in np.argwhere(body.grid != 0):
        cell = row * columns + column
        v = voxels[cell]
        for corner, (right, down) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
            x, y = 0.1 * (spawn_x + column + right), 0.1 * (spawn_y + body.rows - row - down)
            distance = np.abs(fresh - [[x], [y]]).max(0)
            point = int(distance.argmin())
            assert (distance < 1e-9).sum() == 1
            v[[POSITIONS + corner, POSITIONS + 4 + corner]] = position[:, point] - position.mean(1)
            v[[VELOCITIES + corner, VELOCITIES + 4 + corner]] = velocity[:, point] - velocity.mean(1)
        v[STIFFNESS], v[ACTUATION] = engine.stiffness[world, cell], engine.actuation[world, cell]
        v[PLACE] = np.linspace(-1, 1, body.rows)[row] if body.rows > 1 else 0
        v[PLACE + 1] = np.linspace(-1, 1, body.cols)[column] if body.cols > 1 else 0
        for side, (down, right) in enumerate(((0, 0), (-1, 0), (0, 1), (1, 0), (0, -1))):
            types[cell, side] = type_at(row + down, column + right)
    return voxels, types


@pytest.mark.parametrize("material", MATERIALS)
def test_voxel_features_against_slow_twin(material):
    engine = make_engine("DownStepper-v0", [SMALL, WIDE, "HSV", "Walk_Bot"], 5, material=material)
    for steps in (0, 1, 14):
        step_randomly(engine, steps)
        expected, types = (
            np.stack(rows) for rows in zip(*(slow_voxels(engine, world) for world in range(5)), strict=True)
        )
        assert engine.voxels.dtype == np.float32
        # Up to 1e-5 of the velocities' size, which float32 cannot tell.
        np.testing.assert_allclose(engine.voxels, expected, rtol=1e-5, atol=1e-6)
        np.testing.assert_array_equal(engine.types, types)


def test_neighbours_are_the_connected_ones():
    body = cm.Body("HH/HH", [[0, 1, 0], [1, 3, 2]])  # 2 and 3 touch, but are not joined
    engine = make_engine("Walker-v0", body)
    assert (engine.types[0, :, 1:] > 0).tolist() == [
        [False, True, True, False],
        [False, False, True, True],
        [True, False, False, False],
        [True, False, False, False],
    ]


def test_features_of_the_whole_robot():
    engine = make_engine("CaveCrawler-v0", "Cave_Bot", 2)
    step_randomly(engine, 10)
    velocity = np.stack([engine.simulator.velocities("robot", world).mean(1) for world in range(2)])
    np.testing.assert_allclose(engine.features[:, :2], velocity, rtol=0, atol=1e-12)
    np.testing.assert_allclose((engine.features[:, 2:4] ** 2).sum(1), 1.0, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(engine.features[:, 4:], engine.flat[:, -22:])  # both windows
    assert make_engine("Walker-v0", "Walk_Bot").features.shape == (1, 4)


def test_moved_robot_is_read_after_refresh():
    engine = make_engine("Walker-v0", "Walk_Bot", 3)
    before = engine.com
    move(engine, 0.3, 0.2, world=1)
    np.testing.assert_allclose(engine.com - before, [[0, 0], [0.3, 0.2], [0, 0]], rtol=0, atol=1e-12)
