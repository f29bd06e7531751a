"""Batches of worlds: bit-for-bit independence of threads, neighbours and resumption; masks, failures, errors."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evogymcm.sim.constants import Physics
from evogymcm.sim.simulator import Simulator
from evogymcm.sim.topology import topology
from evogymcm.sim.world import World, WorldObject
from tests.sim.tools import (
    SMALL,
    STANDARD,
    all_state,
    grid_of,
    in_air,
    placed,
    simulator,
    springs_of,
)

STEPS = 12  # after five or so the robots are on the ground and contacts come and go
BODIES = ("HSV/R.H", "HHHH/V..V", "VVV/SRS/H.H", "HS/SH/HH/S.")


def random_actions(n_worlds, n_cells, steps=STEPS, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(0.6, 1.6, (steps, n_worlds, n_cells)), rng.uniform(0.5, 2.0, (steps, n_worlds, n_cells))


def run(sim, actuation, stiffness=None):
    for step, numbers in enumerate(actuation):
        sim.step(numbers, None if stiffness is None else stiffness[step])
    return [all_state(sim, world) for world in range(sim.n_worlds)]


def assert_equal_bits(ours, theirs):
    for one, other in zip(ours, theirs, strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.usefixtures("small_batches_pay")
def test_any_number_of_threads_gives_the_same_bits():
    worlds = [placed(text) for text in (SMALL, *BODIES) for _ in range(16)]  # they pay for two threads
    actions = random_actions(len(worlds), simulator(*worlds).n_cells)
    one, two, three = (run(simulator(*worlds, num_threads=n), *actions) for n in (1, 2, 3))
    assert_equal_bits(one, two)
    assert_equal_bits(one, three)


def test_a_world_alone_equals_the_world_in_a_batch():
    batch = simulator(*[placed(STANDARD)] * 64)
    actions = random_actions(64, batch.n_cells)
    states = run(batch, *actions)
    for world in (0, 37, 63):
        alone = run(simulator(placed(STANDARD)), *(a[:, [world]] for a in actions))
        assert_equal_bits(alone, [states[world]])


@pytest.mark.parametrize("task", ["Walker-v0", "BridgeWalker-v0", "CaveCrawler-v0"])
def test_mixed_bodies_equal_singles(task):
    at = {"Walker-v0": (2, 1), "BridgeWalker-v0": (2, 5), "CaveCrawler-v0": (3, 3)}[task]
    worlds = [placed(text, task, at) for text in BODIES]
    mixed = simulator(*worlds, worlds[1])
    actions = random_actions(5, mixed.n_cells)
    states = run(mixed, *actions)
    for world, objects in enumerate([*worlds, worlds[1]]):
        single = simulator(objects, grid_shape=mixed.grid_shape)
        assert_equal_bits(run(single, *(a[:, [world]] for a in actions)), [states[world]])


def test_the_padded_grid_does_not_matter():
    small, large = simulator(placed(SMALL)), simulator(placed(SMALL), grid_shape=(5, 6))
    actuation, stiffness = random_actions(1, 6)
    on_large = [np.ones((STEPS, 1, 30)) for _ in range(2)]
    for numbers, padded in zip((actuation, stiffness), on_large, strict=True):
        padded.reshape(STEPS, 5, 6)[:, :2, :3] = numbers.reshape(STEPS, 2, 3)
    assert_equal_bits(run(small, actuation, stiffness), run(large, *on_large))


@pytest.mark.parametrize("through_pickle", [False, True])
def test_a_resumed_simulator_goes_on_with_the_same_bits(through_pickle):
    worlds = [placed(SMALL), placed(BODIES[1])]
    first = simulator(*worlds)
    actuation, stiffness = random_actions(2, first.n_cells, 2 * STEPS)
    run(first, actuation[:STEPS], stiffness[:STEPS])
    if through_pickle:
        second = pickle.loads(pickle.dumps(first))
    else:
        second = simulator(*worlds)
        run(second, actuation[5:9])  # it has a past of its own
        second.set_state(first.state())
    assert_equal_bits(run(first, actuation[STEPS:]), run(second, actuation[STEPS:]))  # stiffness is part of the state


def test_worlds_outside_the_mask_stay_as_they_are():
    sim = simulator(*[placed(SMALL)] * 3, placed(BODIES[1]))
    actuation, stiffness = random_actions(4, sim.n_cells)
    run(sim, actuation, stiffness)
    before = [all_state(sim, world) for world in range(4)]
    mask = np.array([False, True, False, False])
    for step in range(4):
        sim.step(actuation[step], stiffness[step], mask)
    after = [all_state(sim, world) for world in range(4)]
    assert_equal_bits([before[w] for w in (0, 2, 3)], [after[w] for w in (0, 2, 3)])
    assert before[1].tobytes() != after[1].tobytes()


def test_a_masked_step_is_the_step():
    worlds = [placed(SMALL)] * 3
    one, two = simulator(*worlds), simulator(*worlds)
    actuation, _ = random_actions(3, one.n_cells)
    for numbers in actuation:
        one.step(numbers)
        for world in range(3):
            two.step(numbers, mask=np.arange(3) == world)
    assert_equal_bits([all_state(one, w) for w in range(3)], [all_state(two, w) for w in range(3)])


def test_reset_of_some_worlds():
    sim, fresh = simulator(*[placed(SMALL)] * 3), simulator(*[placed(SMALL)] * 3)
    actuation, _ = random_actions(3, sim.n_cells)
    run(sim, actuation)
    moved = [sim.positions(world=w) for w in range(3)]
    sim.reset(np.array([True, False, True]))
    np.testing.assert_array_equal(sim.positions(world=0), fresh.positions(world=0))
    np.testing.assert_array_equal(sim.positions(world=1), moved[1])
    assert not sim.velocities(world=0).any()
    sim.reset()
    assert_equal_bits(run(sim, actuation), run(fresh, actuation))  # nothing of its past is left


BAD_ACTUATION = {"nan": np.nan, "infinite": np.inf, "absurd": 50.0, "negative": -50.0}


@pytest.mark.parametrize("bad", BAD_ACTUATION.values(), ids=BAD_ACTUATION.keys())
def test_a_world_that_breaks_down_leaves_its_neighbours_alone(bad):
    sim, undisturbed = simulator(*[placed(STANDARD)] * 6), simulator(*[placed(STANDARD)] * 6)
    actuation, _ = random_actions(6, sim.n_cells)
    failed_once = False
    for numbers in actuation:
        before = sim.positions(world=2), sim.velocities(world=2)
        undisturbed.step(numbers)
        unstable = sim.step(np.where((np.arange(6) == 2)[:, None], bad, numbers))
        assert not np.delete(unstable, 2).any()
        if unstable[2]:
            failed_once = True
            np.testing.assert_array_equal(before, (sim.positions(world=2), sim.velocities(world=2)))
        assert np.isfinite(sim.positions(world=2)).all()
    assert failed_once
    others = [0, 1, 3, 4, 5]
    assert_equal_bits([all_state(sim, w) for w in others], [all_state(undisturbed, w) for w in others])


def test_a_world_recovers_from_nan_by_reset():
    sim, fresh = simulator(placed(SMALL)), simulator(placed(SMALL))
    actuation, _ = random_actions(1, sim.n_cells)
    assert sim.step(np.full((1, 6), np.nan)).all()
    sim.reset()
    assert_equal_bits(run(sim, actuation), run(fresh, actuation))


def test_stiffness_one_is_no_stiffness():
    plain, ones, scaled = (simulator(placed(SMALL)) for _ in range(3))
    actuation, _ = random_actions(1, plain.n_cells)
    states = run(plain, actuation)
    assert_equal_bits(states, run(ones, actuation, np.ones_like(actuation)))
    assert states[0].tobytes() != run(scaled, actuation, np.full_like(actuation, 1.5))[0].tobytes()


def test_constant_stiffness_in_every_step_is_stiffness_set_once():
    once, always = simulator(*[placed(SMALL)] * 2), simulator(*[placed(SMALL)] * 2)
    actuation, stiffness = random_actions(2, once.n_cells)
    once.set_stiffness(stiffness[0])
    assert_equal_bits(run(once, actuation), run(always, actuation, np.repeat(stiffness[:1], STEPS, 0)))


def test_stiffness_of_some_worlds():
    sim, expected = simulator(*[placed(SMALL)] * 2), simulator(*[placed(SMALL)] * 2)
    actuation, stiffness = random_actions(2, sim.n_cells)
    sim.set_stiffness(stiffness[0], np.array([False, True]))
    expected.set_stiffness(np.stack([np.ones(6), stiffness[0, 1]]))
    assert_equal_bits(run(sim, actuation), run(expected, actuation))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_constant_stiffness_scales_every_spring(factor):
    """The oscillation of a square that was stretched has a frequency that goes with the root of the stiffness."""
    sim = simulator(in_air("SS/SH"), physics=Physics(gravity=0.0, drag=0.0))
    scaled = simulator(in_air("SS/SH"), physics=Physics(gravity=0.0, drag=0.0, substep=1e-4 / np.sqrt(factor)))
    scaled.set_stiffness(np.full((1, 4), factor))
    for s in (sim, scaled):
        for _ in range(3):
            s.step(np.full((1, 4), 1.3))
    np.testing.assert_allclose(sim.positions(), scaled.positions(), atol=1e-10)
    np.testing.assert_allclose(sim.velocities() * np.sqrt(factor), scaled.velocities(), atol=1e-8)


@pytest.mark.parametrize("body", ["HHH/H.H", "HS/SH"])
def test_edge_rules_agree_within_one_material_only(body):
    rules = [simulator(placed(body), edge_rule=rule) for rule in ("mean_factor", "mean_stiffness")]
    actuation, stiffness = random_actions(1, rules[0].n_cells)
    one, other = (run(sim, actuation[:4], stiffness[:4])[0] for sim in rules)
    assert (np.abs(one - other)[:20].max() < 1e-9) == ("S" not in body)  # positions


def test_edge_rules_say_what_a_shared_edge_is():
    for rule, expected in (("mean_factor", 1.25 * 3e8 / 6), ("mean_stiffness", (0.5 * 3e8 / 5 + 2.0 * 3e8 / 6) / 2)):
        sim = simulator(in_air("HS"), edge_rule=rule)
        sim.set_stiffness(np.array([[0.5, 2.0]]))
        constants, (shared,) = springs_of(sim).constants, np.flatnonzero(topology(grid_of("HS")).edge_owners[:, 1] >= 0)
        np.testing.assert_allclose(constants[shared], expected, rtol=1e-14)
        np.testing.assert_allclose(constants[0], 0.5 * 3e8 / 5, rtol=1e-14)


def test_stiffness_acts_on_no_other_object():
    world = World(20, 10).place(WorldObject("block", grid_of("SS"), (10, 1)))
    sim, stiff = (simulator(placed(SMALL, world)) for _ in range(2))
    stiff.set_stiffness(np.full((1, 6), 2.0))
    for s in (sim, stiff):
        for _ in range(5):
            s.step(np.ones((1, 6)))
    np.testing.assert_array_equal(sim.positions("block"), stiff.positions("block"))
    assert (sim.positions() != stiff.positions()).any()


def test_fixed_voxels_do_not_move():
    sim = simulator(placed(SMALL, "BridgeWalker-v0", (2, 5)))
    names = [o.name for o in sim.objects()]
    before = {name: sim.positions(name) for name in names}
    actuation, _ = random_actions(1, sim.n_cells)
    run(sim, actuation)
    moved = {name: np.abs(sim.positions(name) - before[name]).max(0) > 0 for name in names}
    assert moved["robot"].all()
    bridge = next(name for name in names if moved[name].any() and name != "robot")
    fixed = sim.object(bridge).topology.is_fixed
    assert not moved[bridge][fixed].any()
    assert sim.velocities(bridge).shape == before[bridge].shape


def test_move_shifts_an_object_and_gives_it_no_velocity():
    sim, here = simulator(*[in_air(SMALL)] * 2), simulator(*[in_air(SMALL)] * 2)
    sim.move("robot", (0.25, -0.5), 1)
    np.testing.assert_array_equal(sim.positions(world=0), here.positions(world=0))
    np.testing.assert_allclose(sim.positions(world=1) - here.positions(world=1), [[0.25] * 12, [-0.5] * 12], atol=1e-15)
    actuation, _ = random_actions(2, sim.n_cells, 3)
    run(sim, actuation)
    run(here, actuation)
    np.testing.assert_allclose(sim.positions(world=1) - here.positions(world=1), [[0.25] * 12, [-0.5] * 12], atol=1e-11)


def test_errors():
    objects = placed(SMALL)
    with pytest.raises(ValueError, match="got none"):
        Simulator([])
    with pytest.raises(ValueError, match="num_threads: got 0"):
        Simulator([objects], num_threads=0)
    with pytest.raises(ValueError, match=r"grid_shape: got \(1, 3\).*\(2, 3\)"):
        Simulator([objects], grid_shape=(1, 3))
    with pytest.raises(ValueError, match="edge_rule: got 'max'"):
        Simulator([objects], edge_rule="max")
    sim = simulator(objects)
    with pytest.raises(ValueError, match=r"object: got 'moon'.*'robot'"):
        sim.positions("moon")
    with pytest.raises(ValueError, match="'ground' has fixed voxels"):
        sim.move("ground", (1.0, 0.0), 0)
    for other in ([np.zeros(10)], simulator(placed("HH")).state(), simulator(objects, objects).state()):
        with pytest.raises(ValueError, match="state: it is not of 1 such worlds"):
            sim.set_state(other)
    with pytest.raises(ValueError, match="substep"):
        Physics(substep=0.0)
    with pytest.raises(ValueError, match=r"drag: got nan"):
        Physics(drag=float("nan"))


_WITHOUT_JIT = """
import sys
import numpy as np
from tests.sim.tools import placed, run_substeps, simulator, place_points, all_points
sim = simulator(placed("HS", at=(2, 1)))
sim.set_stiffness(np.array([[0.5, 2.0]]))
x, v = all_points(sim)
n = sim.positions().shape[1]
x[:n] -= [0.03, 0.004]
place_points(sim, x, v, x)
run_substeps(sim, 4)
np.save(sys.argv[1], np.concatenate(all_points(sim)))
"""


@pytest.mark.slow
def test_kernels_work_without_the_jit(tmp_path):
    root = Path(__file__).resolve().parents[2]
    results = []
    for disabled in ("0", "1"):
        file = tmp_path / f"{disabled}.npy"
        env = os.environ | {"NUMBA_DISABLE_JIT": disabled}
        subprocess.run([sys.executable, "-c", _WITHOUT_JIT, str(file)], check=True, cwd=root, env=env, timeout=600)
        results.append(np.load(file))
    assert np.abs(results[0]).max() > 0.2
    np.testing.assert_allclose(*results, rtol=1e-13, atol=1e-13)
