"""The task engine: batches, threads, masks, states, actions and errors."""

import copy
import pickle

import numpy as np
import pytest

from evogymcm.sim.constants import Physics
from evogymcm.sim.kernels.advance import advance
from evogymcm.sim.kernels.readings import read_object, read_voxels, read_window
from tests.envs.tools import (
    MATERIALS,
    PAPER_ROBOTS,
    PAPER_TASKS,
    SMALL,
    TALL,
    WIDE,
    assert_same,
    make_engine,
    outputs,
    random_actions,
    step_randomly,
)

MIXED = [SMALL, TALL, WIDE, "Walk_Bot"]


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


def test_worlds_and_fields_that_do_not_fit_the_bodies_are_named():
    with pytest.raises(ValueError, match="num_worlds"):
        make_engine("Walker-v0", SMALL, 0)
    with pytest.raises(ValueError, match="2 bodies"):
        make_engine("Walker-v0", [SMALL, WIDE], stiffness=np.ones((2, 3)))


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
