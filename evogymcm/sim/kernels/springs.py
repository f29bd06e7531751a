"""One substep of a world's springs and points: Runge-Kutta integration and the limits on lengths.

Contact forces are made before (`contact.py`) and held over the four stages. Points lie in memory as pairs x0 y0 x1 y1
..., point p at place 2p; a group is eight springs, or four points. All operations stand in EvoGym's order, and round as
it does; the tables say which springs a group holds and in which order a point's forces are added.
"""

import math
from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import (
    LIMIT_GAIN,
    RIGID_LIMIT_GAIN,
    RIGID_SQUEEZE_LIMIT,
    RIGID_STRETCH_LIMIT,
    SQUEEZE_LIMIT,
    STRETCH_LIMIT,
    VOXEL,
    PhysicsValues,
)
from evogymcm.sim.kernels._jit import inlined, inner
from evogymcm.sim.kernels.vectors import (
    alternating,
    differences,
    gather,
    less,
    load,
    load_pair,
    select,
    spread,
    sqrt,
    store,
    store_pair,
    store_pairs,
)

NO_FORCE = 0  # place in `force` of a pair that stays zero
FIRST_FORCE = 8  # place of the first spring's pair


class SpringTables(NamedTuple):
    """What never changes of a world's springs and points. G groups of springs, P points, S springs."""

    ends: np.ndarray  # (16 G,) places of the first ends, then of the second ones, of each group; see `differences`
    rest: np.ndarray  # (8 G,) initial lengths
    groups: np.ndarray  # two for each group of points: where in `pulls` springs that begin there start, and the others
    pulls: np.ndarray  # places in `force` of the springs at four points, four by four: first those that begin there
    free: np.ndarray  # one for each group of points: a mask of the numbers that integration moves
    rigid: np.ndarray  # (2 R,) places of the ends of rigid voxels' edges, in the order in which they are corrected


class SpringState(NamedTuple):
    """A world's present points and springs."""

    xy: np.ndarray  # positions
    v: np.ndarray  # integrated velocities
    old: np.ndarray  # positions one substep ago
    constant: np.ndarray  # spring constants
    factor: np.ndarray  # what scales them
    goal: np.ndarray  # lengths to which actuators drive springs


class SpringScratch(NamedTuple):
    """Memory for what a substep forms on its way; numbers of points, but where springs are named."""

    contact: np.ndarray  # forces of contact
    ground: np.ndarray  # forces of the implicit floor on points below it
    stage_xy: np.ndarray  # positions at which the present stage is taken
    second_v: np.ndarray  # velocities at which the second, third and last stages are
    third_v: np.ndarray
    last_v: np.ndarray
    sum_v: np.ndarray  # sum of the stages' changes of velocity
    rest: np.ndarray  # of springs: the present rest lengths
    force: np.ndarray  # of springs: pairs
    beyond: np.ndarray  # of springs: numbers of those beyond their limits


@inlined
def _pull(
    ends: np.ndarray, xy: np.ndarray, state: SpringState, rest: np.ndarray, force: np.ndarray, convergence: float
) -> None:
    """Sets the spring forces at the positions `xy`.

    With a `convergence` above 0 (the first stage) it also sets the rest lengths, which hold for the whole substep.
    """
    for g in range(ends.shape[0] // 16):
        s = 8 * g
        dx, dy = differences(xy, ends, 16 * g)
        length = sqrt(dx * dx + dy * dy)
        if convergence > 0.0:
            now = length + convergence * (load(state.goal, s) - length)
            store(rest, s, now)
        else:
            now = load(rest, s)
        size = (length - now) * load(state.constant, s) / length * load(state.factor, s)
        store_pairs(force, FIRST_FORCE + 2 * s, size * dx, size * dy)


@inlined
def _pulls(groups: np.ndarray, pulls: np.ndarray, force: np.ndarray, g: int):  # type: ignore[no-untyped-def]
    """Returns the sums of the spring forces at the four points of a group, added spring by spring."""
    total = spread(0.0)
    at, one = np.uint64(2 * g), np.uint64(1)  # an index with a sign would be tested for counting from the end
    first, turn, end = groups[at], groups[at + one], groups[at + one + one]
    for i in range(first, turn, 4):
        total = total - gather(force, pulls, i)
    for i in range(turn, end, 4):
        total = total + gather(force, pulls, i)
    return total


@inner
def _push_from_ground(
    ground: np.ndarray, i: int, low: int, xy: np.ndarray, v: np.ndarray, physics: PhysicsValues
) -> None:
    """Sets the implicit floor's forces on those of the four points from place `i` on that the mask `low` names."""
    for k in range(4):
        if low >> (2 * k + 1) & 1:
            p = i + 2 * k
            normal = -physics.ground_stiffness * xy[p + 1]
            drag = normal * math.tanh(v[p] * normal * physics.friction)
            ground[p] = -(physics.ground_friction_gain * physics.friction * drag)
            ground[p + 1] = normal


@inlined
def _below_ground(xy: np.ndarray, i: int) -> int:
    """Returns a mask of the y below zero of the four points from place `i` on."""
    return less(load(xy, i), alternating(-math.inf, 0.0))


@inlined
def _meet_ground(xy: np.ndarray, v: np.ndarray, scratch: SpringScratch, physics: PhysicsValues) -> None:
    """Sets the floor's forces on all points below it.

    They come before a stage's loop: were `tanh` called there, its constants would be kept in memory.
    """
    for i in range(0, xy.shape[0], 8):
        low = _below_ground(xy, i)
        if low:
            _push_from_ground(scratch.ground, i, low, xy, v, physics)


@inlined
def _acceleration(  # type: ignore[no-untyped-def]
    tables: SpringTables, i: int, xy: np.ndarray, v: np.ndarray, scratch: SpringScratch, physics: PhysicsValues
):
    """Returns the accelerations of the four points from place `i` on."""
    acceleration = _pulls(tables.groups, tables.pulls, scratch.force, i >> 3) - physics.drag * load(v, i)
    acceleration = acceleration - alternating(0.0, physics.gravity) + load(scratch.contact, i)
    low = _below_ground(xy, i)
    if low:
        acceleration = select(low | low >> 1, acceleration + load(scratch.ground, i), acceleration)
    return acceleration


@inlined
def _first_stage(tables: SpringTables, state: SpringState, scratch: SpringScratch, physics: PhysicsValues) -> None:
    """Begins the sum of changes, and sets the second stage's state, half of the way ahead."""
    _meet_ground(state.xy, state.v, scratch, physics)
    h = physics.substep
    for i in range(0, state.xy.shape[0], 8):
        change = _acceleration(tables, i, state.xy, state.v, scratch, physics) * h
        v = load(state.v, i)
        store(scratch.stage_xy, i, load(state.xy, i) + 0.5 * (v * h))
        store(scratch.sum_v, i, change)
        store(scratch.second_v, i, v + 0.5 * change)


@inlined
def _middle_stage(
    tables: SpringTables,
    state: SpringState,
    scratch: SpringScratch,
    v: np.ndarray,
    next_v: np.ndarray,
    share: float,
    physics: PhysicsValues,
) -> None:
    """Adds twice the change to the sum, and sets the next stage's state, a share of the way ahead."""
    _meet_ground(scratch.stage_xy, v, scratch, physics)
    h = physics.substep
    for i in range(0, state.xy.shape[0], 8):
        change = _acceleration(tables, i, scratch.stage_xy, v, scratch, physics) * h
        store(scratch.stage_xy, i, load(state.xy, i) + share * (load(v, i) * h))
        store(scratch.sum_v, i, load(scratch.sum_v, i) + 2.0 * change)
        store(next_v, i, load(state.v, i) + share * change)


@inlined
def _last_stage(tables: SpringTables, state: SpringState, scratch: SpringScratch, physics: PhysicsValues) -> None:
    """Moves the free points by the mean of the four stages' ways."""
    _meet_ground(scratch.stage_xy, scratch.last_v, scratch, physics)
    h = physics.substep
    free = tables.free
    for g in range(free.shape[0]):
        i = 8 * g
        change = _acceleration(tables, i, scratch.stage_xy, scratch.last_v, scratch, physics) * h
        xy, v = load(state.xy, i), load(state.v, i)
        way = v * h + 2.0 * (load(scratch.second_v, i) * h)
        way = way + 2.0 * (load(scratch.third_v, i) * h) + load(scratch.last_v, i) * h
        store(state.old, i, xy)
        store(state.xy, i, select(free[g], xy + way / 6.0, xy))
        store(state.v, i, select(free[g], v + (load(scratch.sum_v, i) + change) / 6.0, v))


@inlined
def integrate(tables: SpringTables, state: SpringState, scratch: SpringScratch, physics: PhysicsValues) -> None:
    """Advances the points by one substep of classical Runge-Kutta, under the forces in `scratch.contact`."""
    ends, rest, force = tables.ends, scratch.rest, scratch.force
    _pull(ends, state.xy, state, rest, force, physics.convergence)
    _first_stage(tables, state, scratch, physics)
    _pull(ends, scratch.stage_xy, state, rest, force, 0.0)
    _middle_stage(tables, state, scratch, scratch.second_v, scratch.third_v, 0.5, physics)
    _pull(ends, scratch.stage_xy, state, rest, force, 0.0)
    _middle_stage(tables, state, scratch, scratch.third_v, scratch.last_v, 1.0, physics)
    _pull(ends, scratch.stage_xy, state, rest, force, 0.0)
    _last_stage(tables, state, scratch, physics)


@inlined
def _is_free(free: np.ndarray, place: int) -> bool:
    return free[place >> 3] >> (place & 7) & 1


@inlined
def limit_lengths(tables: SpringTables, state: SpringState, scratch: SpringScratch) -> None:
    """Pulls springs that are too long or too short back, all at once from the same positions.

    The first ends move first, all of them, as in EvoGym.
    """
    xy, force, beyond, ends = state.xy, scratch.force, scratch.beyond, tables.ends
    n = 0
    for g in range(ends.shape[0] // 16):
        dx, dy = differences(xy, ends, 16 * g)
        rest = load(tables.rest, 8 * g)
        squared = dx * dx + dy * dy
        longest, shortest = STRETCH_LIMIT * rest, SQUEEZE_LIMIT * rest
        off = less(longest * longest, squared) | less(squared, shortest * shortest)
        if off:
            length = sqrt(squared)
            stress = length / rest
            too_long, too_short = less(STRETCH_LIMIT, stress), less(stress, SQUEEZE_LIMIT)
            limit = select(too_long, rest * STRETCH_LIMIT, rest * SQUEEZE_LIMIT)
            share = select(too_long | too_short, (length - limit) / (length * 2.0), spread(0.0))
            store_pairs(force, FIRST_FORCE + 16 * g, dx * share * LIMIT_GAIN, dy * share * LIMIT_GAIN)
            for lane in range(8):
                if off >> lane & 1:
                    beyond[n] = 8 * g + lane
                    n += 1
    for second in range(2):
        for i in range(n):
            slot = slot_of(beyond[i])
            p = ends[2 * (beyond[i] & ~7) + 8 * second + (slot & 7)]
            if _is_free(tables.free, p):
                move = load_pair(force, FIRST_FORCE + 2 * slot)
                store_pair(xy, p, load_pair(xy, p) + move if second else load_pair(xy, p) - move)


@inlined
def slot_of(spring: int) -> int:
    """Returns where in memory a spring's pair is; see `vectors.LANE_SLOTS`."""
    return (spring & ~7) | ((spring & 1) << 2) | ((spring >> 1) & 3)


@inlined
def limit_rigid(rigid: np.ndarray, xy: np.ndarray) -> None:
    """Corrects the edges of rigid voxels one after another, each from the positions that the last one left."""
    longest, shortest = RIGID_STRETCH_LIMIT * VOXEL, RIGID_SQUEEZE_LIMIT * VOXEL
    for i in range(0, rigid.shape[0], 2):
        a, b = rigid[i], rigid[i + 1]
        dx, dy = xy[a] - xy[b], xy[a + 1] - xy[b + 1]
        squared = dx * dx + dy * dy
        if longest * longest < squared or squared < shortest * shortest:
            length = math.sqrt(squared)
            stress = length / VOXEL
            if stress > RIGID_STRETCH_LIMIT:
                limit = VOXEL * RIGID_STRETCH_LIMIT
            elif stress < RIGID_SQUEEZE_LIMIT:
                limit = VOXEL * RIGID_SQUEEZE_LIMIT
            else:
                continue
            share = (length - limit) / (length * 2.0)
            dx, dy = dx * share * RIGID_LIMIT_GAIN, dy * share * RIGID_LIMIT_GAIN
            xy[a] -= dx
            xy[a + 1] -= dy
            xy[b] += dx
            xy[b + 1] += dy
