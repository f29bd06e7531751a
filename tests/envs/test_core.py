"""The task engine: batches, threads, masks, states, voxel features and errors."""

import copy
import pickle

import numpy as np
import pytest

import evogymcm as cm
from evogymcm.envs.voxels import ACTUATION, N_FEATURES, PLACE, POSITIONS, STIFFNESS, VELOCITIES
from evogymcm.sim.advance import advance
from evogymcm.sim.constants import Physics
from evogymcm.sim.readings import read_object, read_voxels, read_window
from tests.envs.tools import (
    PAPER_ROBOTS,
    PAPER_TASKS,
    SMALL,
    TALL,
    WIDE,
    assert_same,
    make_engine,
    move,
    outputs,
    random_actions,
    step_randomly,
)

MIXED = [SMALL, TALL, WIDE, "Walk_Bot"]
MATERIALS = ("invariant", "reactive")


def step_with(engine, actions, step, **options):
    actuation, stiffness = (values[step] for values in actions)
    engine.step(actuation, stiffness if engine.material == "reactive" else None, **options)


def run(engine, actions, steps=None):
    """Outputs of all steps."""
    seen = []
    for step in range(len(actions[0])) if steps is None else steps:
        step_with(engine, actions, step)
        seen.append(outputs(engine))
    return seen


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("task", PAPER_TASKS)
def test_batch_equals_singles(task, material):
    n = 11
    batch = make_engine(task, PAPER_ROBOTS[task], n, material=material)
    actions = random_actions(batch, 12)
    together = run(batch, actions)
    for world in (0, 5, 10):
        single = make_engine(task, PAPER_ROBOTS[task], material=material)
        alone = run(single, [values[:, [world]] for values in actions])
        for got, expected in zip(together, alone, strict=True):
            assert_same({k: v[[world]] for k, v in got.items()}, expected)


@pytest.mark.parametrize("material", MATERIALS)
def test_mixed_bodies_equal_singles(material):
    batch = make_engine("DownStepper-v0", MIXED, 10, material=material)
    assert batch.flat is None
    assert batch.grid_shape == (4, 5)
    assert [b.text for b in batch.bodies[4:6]] == [b.text for b in batch.bodies[:2]]  # dealt in turn
    actions = random_actions(batch, 12)
    together = run(batch, actions)
    for world in range(5):
        body = batch.bodies[world]
        single = make_engine("DownStepper-v0", body, material=material)
        cells = [r * 5 + c for r in range(body.rows) for c in range(body.cols)]
        alone = run(single, [values[:, [world]][:, :, cells] for values in actions])
        for batched, expected in zip(together, alone, strict=True):
            got = {name: values[[world]] for name, values in batched.items()}
            del expected["flat"]
            for name, padding in (("voxels", 0.0), ("types", 0), ("stiffness", 1.0), ("actuation", 1.0)):
                np.testing.assert_array_equal(np.delete(got[name], cells, axis=1), padding)
                got[name] = got[name][:, cells]
            assert_same(got, expected)


@pytest.mark.usefixtures("small_batches_pay")
@pytest.mark.parametrize("bodies", ["Walk_Bot", MIXED])
def test_threads_change_nothing(bodies):
    engines = [make_engine("CaveCrawler-v0", bodies, 20, material="reactive", num_threads=n) for n in (1, 2)]
    actions = random_actions(engines[0], 10)
    one, two = (run(engine, actions) for engine in engines)
    for got, expected in zip(two, one, strict=True):
        assert_same(got, expected)


@pytest.mark.parametrize("bodies", ["Cave_Bot", MIXED])
def test_masked_step_leaves_the_others_alone(bodies):
    engine = make_engine("CaveCrawler-v0", bodies, 9, material="reactive")
    plain = make_engine("CaveCrawler-v0", bodies, 9, material="reactive")
    actions = random_actions(engine, 8)
    run(engine, actions, range(4))
    run(plain, actions, range(4))
    before = outputs(engine)
    mask = np.arange(9) % 3 == 0
    step_with(engine, actions, 4, mask=mask)
    step_with(plain, actions, 4)
    after, expected = outputs(engine), outputs(plain)
    assert_same(after, expected, mask)
    assert (after["reward"][~mask] == 0.0).all()
    for values in (before, after):
        del values["reward"]  # of a step that they took no part in
    assert_same(after, before, ~mask)
    # The ones left behind take the same step later.
    step_with(engine, actions, 4, mask=~mask)
    late, expected = outputs(engine), outputs(plain)
    assert_same(late, expected, ~mask)
    for seen, other in zip(run(engine, actions, range(5, 8)), run(plain, actions, range(5, 8)), strict=True):
        assert_same(seen, other)


def test_masked_reset_starts_some_again():
    engine = make_engine("DownStepper-v0", "Down_Bot", 10)
    fresh = outputs(engine)
    actions = random_actions(engine, 6)
    run(engine, actions, range(3))
    before = outputs(engine)
    mask = np.arange(10) < 4
    engine.reset(mask)
    after = outputs(engine)
    assert_same(after, fresh, mask)
    assert_same(after, before, ~mask)
    again = make_engine("DownStepper-v0", "Down_Bot", 10)
    step_with(again, actions, 3)
    step_with(engine, actions, 3)
    assert_same(outputs(engine), outputs(again), mask)


@pytest.mark.parametrize("material", MATERIALS)
def test_state_forks_and_replays(material):
    engine = make_engine("BridgeWalker-v0", ["Bridge_Bot", WIDE], 10, material=material)
    actions = random_actions(engine, 12)
    run(engine, actions, range(5))
    state = pickle.loads(pickle.dumps(engine.state()))
    at_fork = outputs(engine)
    first = run(engine, actions, range(5, 12))
    engine.set_state(state)
    assert_same(outputs(engine), at_fork)
    second = run(engine, actions, range(5, 12))
    other = make_engine("BridgeWalker-v0", ["Bridge_Bot", WIDE], 10, material=material)
    del state["reached"]  # older releases saved none
    other.set_state(state)
    third = run(other, actions, range(5, 12))
    for a, b, c in zip(first, second, third, strict=True):
        assert_same(b, a)
        assert_same(c, a)


@pytest.mark.skipif(not hasattr(advance, "signatures"), reason="kernels run as plain Python")
@pytest.mark.parametrize("renew", [copy.deepcopy, lambda engine: pickle.loads(pickle.dumps(engine))])
def test_copies_go_on_exactly_with_the_kernels_that_there_are(renew):
    kernels = (advance, read_object, read_window, read_voxels)
    engine = make_engine("BridgeWalker-v0", ["Bridge_Bot", WIDE], 10, material="reactive")
    actions = random_actions(engine, 10)
    run(engine, actions, range(5))
    twin, compiled = renew(engine), [len(kernel.signatures) for kernel in kernels]
    for a, b in zip(*(run(one, actions, range(5, 10)) for one in (engine, twin)), strict=True):
        assert_same(a, b)
    assert [len(kernel.signatures) for kernel in kernels] == compiled


def test_reset_forgets_everything():
    engine = make_engine("Walker-v0", "Walk_Bot", 3, material="reactive")
    actions = random_actions(engine, 5)
    first = run(engine, actions)
    engine.reset()
    for a, b in zip(first, run(engine, actions), strict=True):
        assert_same(b, a)


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


def test_voxels_do_not_depend_on_what_their_memory_held(monkeypatch):
    engine = make_engine("Walker-v0", [SMALL, WIDE], 3)
    monkeypatch.setattr(np, "empty_like", lambda like: np.full_like(like, np.nan))
    for act in (lambda: step_randomly(engine, 1), engine.reset, engine.refresh):
        act()
        assert np.isfinite(engine.voxels).all()
        assert (engine.voxels[~engine.occupancy] == 0).all()


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


def test_actions_out_of_range_are_clipped():
    clipped, wild = (make_engine("Walker-v0", "Walk_Bot", 2, material="reactive") for _ in range(2))
    rng = np.random.default_rng(0)
    for _ in range(5):
        actuation, stiffness = rng.uniform(-1, 3, (2, 2, 20))
        wild.step(actuation, stiffness)
        clipped.step(np.clip(actuation, 0.6, 1.6), np.clip(stiffness, 0.5, 2.0))
        assert_same(outputs(wild), outputs(clipped))
    assert wild.actuation.min() == 0.6
    assert wild.stiffness.max() == 2.0


def test_infinite_actions_are_clipped_too():
    engine, other = make_engine("Walker-v0", "Walk_Bot"), make_engine("Walker-v0", "Walk_Bot")
    engine.step(np.full((1, 20), np.inf))
    other.step(np.full((1, 20), 1.6))
    assert_same(outputs(engine), outputs(other))


def test_numbers_at_unused_cells_are_ignored():
    engine, other = (make_engine("Walker-v0", "Walk_Bot", material="reactive") for _ in range(2))
    actuation, stiffness = (values[0] for values in random_actions(engine, 1))
    engine.step(actuation, stiffness)
    other.step(np.where(engine.actuators, actuation, np.nan), np.where(engine.occupancy, stiffness, np.nan))
    assert_same(outputs(other), outputs(engine))


def test_constant_stiffness_is_the_same_robot_in_both_settings():
    field = np.random.default_rng(0).uniform(0.5, 2.0, (4, 5))
    fixed = make_engine("Walker-v0", "Walk_Bot", stiffness=field)
    moved = make_engine("Walker-v0", "Walk_Bot", material="reactive")
    actuation, _ = random_actions(fixed, 10)
    for values in actuation:
        fixed.step(values)
        moved.step(values, field.reshape(1, -1))
        assert_same(outputs(fixed), outputs(moved))


@pytest.mark.parametrize("edge_rule", ["mean_factor", "mean_stiffness"])
def test_stiffness_ones_and_none_agree(edge_rule):
    engines = [
        make_engine("Walker-v0", "Walk_Bot", edge_rule=edge_rule, stiffness=field) for field in (None, np.ones((4, 5)))
    ]
    for engine in engines:
        step_randomly(engine, 10)
    assert_same(outputs(engines[0]), outputs(engines[1]))


def test_stiffness_of_each_body():
    fields = [np.full((2, 3), 0.7), np.full((2, 4), 1.8)]
    engine = make_engine("Walker-v0", [SMALL, WIDE], 4, stiffness=fields)
    for world in range(4):
        used = engine.stiffness[world][engine.occupancy[world]]
        np.testing.assert_array_equal(used, (0.7, 1.8)[world % 2])


def test_unstable_world_pays_three_and_stays_where_it_is():
    # A far too long substep blows the robot up.
    engine = make_engine("Walker-v0", "Walk_Bot", 2, physics=Physics(substep=2e-3))
    actions = random_actions(engine, 60)
    for step in range(60):
        before = outputs(engine)
        step_with(engine, actions, step)
        if engine.unstable.any():
            break
    after, bad = outputs(engine), engine.unstable
    assert bad.any()
    np.testing.assert_array_equal(after["reward"][bad], -3.0)
    np.testing.assert_array_equal(after["flat"][bad], before["flat"][bad])
    np.testing.assert_array_equal(after["com"][bad], before["com"][bad])
    np.testing.assert_array_equal(after["score"][bad], before["returns"][bad])
    assert engine.terminated[bad].all()
    assert not engine.truncated.any()
    engine.reset(bad)
    assert not engine.unstable.any()
    assert not engine.terminated.any()


BAD_ARGUMENTS = {
    "unknown task": (("Waker-v0", SMALL), {}, "Waker-v0.*Walker-v0"),
    "disconnected body": (("Walker-v0", "H.H"), {}, "one piece"),
    "no actuator": (("Walker-v0", "RS"), {}, "actuator"),
    "code out of range": (("Walker-v0", [[3, 7]]), {}, "7"),
    "ragged body": (("Walker-v0", [[3, 3], [3]]), {}, "equally long rows"),
    "no bodies": (("Walker-v0", []), {}, "none"),
    "unknown robot": (("Walker-v0", "Walk_Bott"), {}, "Walk_Bot"),
    "body that does not fit": (("AreaMaximizer-v0", "H" * 12), {}, "fit.*AreaMaximizer-v0"),
    "no worlds": (("Walker-v0", SMALL, 0), {}, "num_worlds"),
    "no threads": (("Walker-v0", SMALL), {"num_threads": 0}, "num_threads"),
    "unknown material": (("Walker-v0", SMALL), {"material": "active"}, "active.*invariant"),
    "unknown edge rule": (("Walker-v0", SMALL), {"edge_rule": "mean"}, "mean_factor"),
    "stiffness too high": (("Walker-v0", SMALL), {"stiffness": np.full((2, 3), 2.1)}, r"2\.1.*0\.5 to 2"),
    "stiffness too low": (("Walker-v0", SMALL), {"stiffness": np.full((2, 3), 0.4)}, r"0\.4.*0\.5 to 2"),
    "stiffness NaN": (("Walker-v0", SMALL), {"stiffness": np.full((2, 3), np.nan)}, "stiffness"),
    "stiffness shape": (("Walker-v0", SMALL), {"stiffness": np.ones((3, 2))}, r"\(3, 2\).*\(2, 3\)"),
    "one field for two bodies": (("Walker-v0", [SMALL, WIDE]), {"stiffness": np.ones((2, 3))}, "2 bodies"),
    "stiffness in reactive": (
        ("Walker-v0", SMALL),
        {"stiffness": np.ones((2, 3)), "material": "reactive"},
        "reactive.*action",
    ),
}


@pytest.mark.parametrize("case", BAD_ARGUMENTS)
def test_bad_arguments_are_named(case):
    arguments, options, message = BAD_ARGUMENTS[case]
    with pytest.raises(ValueError, match=message):
        make_engine(*arguments, **options)


def test_bad_actions_are_named():
    engine = make_engine("Walker-v0", SMALL, 2, material="reactive")
    good = np.ones((2, 6))
    bad = good.copy()
    bad[1, 0] = np.nan
    before = outputs(engine)
    with pytest.raises(ValueError, match="actuation: got NaN in world 1"):
        engine.step(bad, good)
    with pytest.raises(ValueError, match="stiffness: got NaN in world 1"):
        engine.step(good, bad)
    with pytest.raises(ValueError, match=r"actuation.*\(2, 5\).*\(2, 6\)"):
        engine.step(good[:, :5], good)
    with pytest.raises(ValueError, match=r"stiffness.*\(6,\).*\(2, 6\)"):
        engine.step(good, good[0])
    with pytest.raises(ValueError, match="reactive"):
        engine.step(good)
    with pytest.raises(ValueError, match="invariant"):
        make_engine("Walker-v0", SMALL).step(good[:1], good[:1])
    assert_same(outputs(engine), before)  # a refused action changes nothing


def test_moved_robot_is_read_after_refresh():
    engine = make_engine("Walker-v0", "Walk_Bot", 3)
    before = engine.com
    move(engine, 0.3, 0.2, world=1)
    np.testing.assert_allclose(engine.com - before, [[0, 0], [0.3, 0.2], [0, 0]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("mask", [[0, 1], [True], np.ones((2, 2), bool), np.ones(2)])
def test_masks_are_flags_of_all_worlds(mask):
    engine = make_engine("Walker-v0", SMALL, 2)
    before = outputs(engine)
    with pytest.raises(ValueError, match=r"mask: got .*expected bool of shape \(2,\)"):
        engine.reset(mask)
    with pytest.raises(ValueError, match=r"mask: got .*expected bool of shape \(2,\)"):
        engine.step(np.ones((2, 6)), mask=mask)
    assert_same(outputs(engine), before)


def test_simulator_takes_one_row_a_world():
    simulator = make_engine("Catcher-v0", SMALL, 2).simulator
    start = simulator.positions()
    for values in (np.ones((2, 5)), np.ones((1, 6)), np.ones(6)):
        for call in (simulator.step, simulator.set_stiffness, lambda v: simulator.step(np.ones((2, 6)), v)):
            with pytest.raises(ValueError, match=r"(actuation|stiffness): got shape .*expected \(2, 6\)"):
                call(values)
    with pytest.raises(ValueError, match=r"offsets: got shape \(2, 3\), expected \(2, 2\)"):
        simulator.reset(offsets=np.zeros((2, 3)))
    for call in (simulator.reset, lambda mask: simulator.step(np.ones((2, 6)), mask=mask)):
        with pytest.raises(ValueError, match=r"mask: got bool of shape \(3,\), expected bool of shape \(2,\)"):
            call(np.ones(3, bool))
    np.testing.assert_array_equal(simulator.positions(), start)
    simulator.step(np.ones((6, 2), np.float32).T)  # of another kind and order, but of the right shape
