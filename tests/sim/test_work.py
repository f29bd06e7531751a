"""The work of commands: one voxel by hand, bodies against the slow twin, and the balance of energy in motion."""

from math import sqrt

import numpy as np
import pytest

from evogymcm.sim.constants import Physics
from tests.sim.tools import all_points, in_air, place_points, simulator, springs_of
from tests.sim.twin import ALPHA, Twin

MIXED = "RSH/V.S/SHV"
ONES = np.ones((1, 9))


def stretched(text, by, edge_rule="mean_factor"):
    """A body alone, stretched along x."""
    sim = simulator(in_air(text), edge_rule=edge_rule)
    x, v = all_points(sim)
    x = x * np.array([by, 1.0])
    place_points(sim, x, v, x)
    return sim


def change(sim, before, after):
    """What `command_work` says of cells' (actuation, stiffness) before and after."""
    return sim.command_work(*([np.array(part, float)[None] for part in commands] for commands in (before, after)))[0]


def test_work_on_one_voxel_is_that_worked_out_by_hand():
    sim = stretched("H", 1.1)  # horizontal edges are 0.11 long, vertical ones 0.10, diagonals 0.148661
    # Edges: k = 6e7, so that 0.006 k / 2 = 180,000; diagonals: k = 3e7, 90,000. From rest, 0.01 beyond the goal, the
    # goal goes to 0.13, 0.02 away: the squares grow from 1e-4 to 4e-4.
    assert change(sim, ([1.0], [1.0]), ([1.3], [1.0])) == pytest.approx([2 * 54.0, 0, 2 * 54.0, 0])
    assert change(sim, ([1.3], [1.0]), ([1.0], [1.0])) == pytest.approx([0, 0, -2 * 54.0, 0])
    # S from 1 to 1.5 adds half of it to each spring: 0.5 * 180,000 * 1e-4 a horizontal edge; the diagonals are
    # 0.148661 - 0.141421 = 0.0072396 too long.
    diagonal = 0.5 * 90_000 * (sqrt(0.11**2 + 0.1**2) - sqrt(0.02)) ** 2
    assert diagonal == pytest.approx(2.3584, rel=1e-4)
    stiffened = 2 * 9.0 + 2 * diagonal
    assert change(sim, ([1.0], [1.0]), ([1.0], [1.5])) == pytest.approx([0, stiffened, 0, stiffened])
    assert change(sim, ([1.0], [1.5]), ([1.0], [1.0])) == pytest.approx([0, 0, 0, -stiffened])
    # Both: actuation against the mean of both stiffnesses, stiffness at the mean of both squares.
    both = [2 * 1.25 * 54.0, 2 * 0.5 * 180_000 * 2.5e-4 + 2 * diagonal]
    assert change(sim, ([1.0], [1.0]), ([1.3], [1.5])) == pytest.approx([*both, *both])
    assert change(sim, ([1.3], [1.5]), ([1.3], [1.5])).tolist() == [0, 0, 0, 0]  # whatever holds still is free


@pytest.mark.parametrize(("edge_rule", "shared"), [("mean_factor", 0.0), ("mean_stiffness", -1.0)])
def test_voxels_that_stiffen_and_soften_share_an_edge_by_its_rule(edge_rule, shared):
    sim = simulator(in_air("SH"), edge_rule=edge_rule)
    x, v = all_points(sim)
    x = x * np.array([1.0, 1.1])  # all vertical edges 0.01 too long
    place_points(sim, x, v, x)
    diagonal = (sqrt(0.11**2 + 0.1**2) - sqrt(0.02)) ** 2
    # S: edges 5e7, diagonals 1.25e7; H: 6e7 and 3e7. The one stiffens by a half, the other softens by as much. The edge
    # between them keeps its constant, or loses a quarter of 6e7 and gains one of 5e7.
    gained = 0.003 * 0.5 * (5e7 * 1e-4 + 2 * 1.25e7 * diagonal)
    lost = 0.003 * 0.5 * (6e7 * 1e-4 + 2 * 3e7 * diagonal)
    of_shared = 0.003 * shared * 0.25 * (6e7 - 5e7) * 1e-4
    work = change(sim, ([1, 1], [1.0, 1.0]), ([1, 1], [1.5, 0.5]))
    assert work == pytest.approx([0, gained, 0, gained - lost + of_shared])


def test_net_work_of_any_change_is_the_change_of_the_twins_energy():
    rng, objects = np.random.default_rng(0), in_air(MIXED)
    sims, twin = simulator(objects, objects), Twin(objects)
    twin.x = twin.x + rng.uniform(-0.02, 0.02, twin.x.shape)
    place_points(sims, twin.x, twin.v, twin.x, world=1)
    old, new = (np.stack([rng.uniform(0.6, 1.6, 9), rng.uniform(0.5, 2, 9)]) for _ in range(2))

    def energy(actuation, stiffness):
        twin.drive(actuation)
        twin.stiffen(stiffness)
        length = np.linalg.norm(twin.x[twin.ends[:, 0]] - twin.x[twin.ends[:, 1]], axis=1)
        return (0.5 * ALPHA * twin.k * twin.factor * (length - twin.goal) ** 2).sum()

    commands = [[np.stack([part] * 2) for part in both] for both in (old, new)]
    work = sims.command_work(*commands, mask=np.array([False, True]))
    assert work[0].tolist() == [0, 0, 0, 0]
    assert work[1, 2:].sum() == pytest.approx(energy(*new) - energy(*old), rel=1e-12)
    orders = [energy(new[0], s) - energy(old[0], s) for s in (old[1], new[1])]
    assert work[1, 2] == pytest.approx(np.mean(orders), rel=1e-12)
    assert (work[1, :2] > work[1, 2:]).all()  # some springs give back


def test_motion_and_damping_take_what_commands_put_in():
    # Alone in the air without gravity and drag, with steps so short that integration is exact: what goes in through
    # commands is in motion and springs afterwards, but for the damping, (1 - 0.006) k x^2 / 2 a substep and spring.
    physics = Physics(substep=1e-6, gravity=0.0, drag=0.0)
    sim, rng = simulator(in_air(MIXED), physics=physics), np.random.default_rng(1)
    commands, supplied, damped = [ONES, ONES], np.zeros(4), 0.0
    ends, is_real = springs_of(sim).ends, ~np.isnan(sim._scene(0).layout.rest)

    def lengths():
        x = all_points(sim)[0]
        return np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)

    for _ in range(3):
        before, commands = commands, [rng.uniform(0.95, 1.05, (1, 9)), rng.uniform(0.5, 2, (1, 9))]
        supplied += sim.command_work(before, commands)[0]
        for _ in range(400):
            length = lengths()
            sim.substeps(1, *commands)
            damped += 0.5 * ((1 - ALPHA) * springs_of(sim).constants * (lengths() - length) ** 2).sum()
    strain = lengths() - sim._springs(0)[2][is_real]
    stored, motion = 0.5 * (ALPHA * springs_of(sim).constants * strain**2).sum(), 0.5 * (sim.velocities() ** 2).sum()
    assert damped + stored + motion == pytest.approx(supplied[2:].sum(), rel=1e-9)
    assert min(damped, motion, stored) > 0.01 * supplied[2]  # none of them is there by the way


def test_stiffness_work_is_what_its_force_does_beyond_that_of_stiffness_one_but_for_damping_and_what_is_stored():
    sim, rng = simulator(in_air(MIXED)), np.random.default_rng(2)
    x, v = all_points(sim)
    x = x + rng.uniform(-0.01, 0.01, x.shape)
    place_points(sim, x, v, x)
    springs, is_real = springs_of(sim), ~np.isnan(sim._scene(0).layout.rest)
    before, supplied, beyond = ONES, np.zeros(4), 0.0

    def lengths():
        x = all_points(sim)[0]
        return np.linalg.norm(x[springs.ends[:, 0]] - x[springs.ends[:, 1]], axis=1)

    for _ in range(5):
        stiffness = rng.uniform(0.5, 2, (1, 9))
        supplied += sim.command_work((ONES, before), (ONES, stiffness))[0]
        before = stiffness
        for _ in range(20):
            length = lengths()
            sim.substeps(1, ONES, stiffness)
            change, factor = lengths() - length, sim._springs(0)[1][is_real]
            force = ALPHA * (length - springs.rest) * change + change**2 / 2  # at k = 1, its work along the way
            damped = (1 - ALPHA) * change**2 / 2
            beyond += ((factor - 1) * springs.constants * (damped - force)).sum()
    stored = 0.5 * ALPHA * ((factor - 1) * springs.constants * (lengths() - springs.rest) ** 2).sum()
    assert beyond == pytest.approx(supplied[3] - stored, rel=1e-9)
    assert supplied[3] > 1.0
    assert supplied[2] == 0
