"""One substep of springs and points: Runge-Kutta integration and the limits on lengths.

Contact forces are made before (`contact.py`) and held over the four stages. State arrays are tables of lanes: (rows,
points or springs, 8), one lane a world; the constants below name the rows.

The operations stand in EvoGym's order, and round as it does.
"""

import math
from typing import NamedTuple

import numpy as np

from evogymcm.sim import lanes
from evogymcm.sim._jit import inlined, kernel
from evogymcm.sim.constants import (
    LIMIT_GAIN,
    RIGID_LIMIT_GAIN,
    RIGID_SQUEEZE_LIMIT,
    RIGID_STRETCH_LIMIT,
    SQUEEZE_LIMIT,
    STRETCH_LIMIT,
    PhysicsValues,
)

# Rows of `points`. The first six are the state: position, integrated velocity, position one substep ago.
X, Y, VX, VY, OLD_X, OLD_Y = range(6)
N_STATE_ROWS = 6
FX, FY, AX, AY, STAGE_X, STAGE_Y, STAGE_VX, STAGE_VY, SUM_X, SUM_Y, SUM_VX, SUM_VY, LISTED_X, LISTED_Y = range(6, 20)
N_POINT_ROWS = 20
# Rows of `springs`: constant and its factor, length to which an actuator drives it, present rest length, force.
CONSTANT, FACTOR, GOAL, REST, FORCE_X, FORCE_Y = range(6)
N_SPRING_ROWS = 6


class Pulls(NamedTuple):
    """The springs at each point: those that begin there in order, then those that end there."""

    start: np.ndarray  # (P + 1,) where a point's springs begin
    turn: np.ndarray  # (P,) where those that end there begin
    springs: np.ndarray  # (2 S,)


@kernel
def _pull(ends: np.ndarray, points: np.ndarray, springs: np.ndarray, x: int, y: int, convergence: float) -> None:
    """Sets the spring forces at the positions in rows `x` and `y`.

    With a `convergence` above 0 (the first stage) it also sets the rest lengths, which hold for the whole substep.
    """
    for s in range(ends.shape[0]):
        a, b = ends[s, 0], ends[s, 1]
        dx = lanes.load(points, x, a) - lanes.load(points, x, b)
        dy = lanes.load(points, y, a) - lanes.load(points, y, b)
        length = lanes.sqrt(dx * dx + dy * dy)
        if convergence > 0.0:
            rest = length + convergence * (lanes.load(springs, GOAL, s) - length)
            lanes.store(springs, REST, s, rest)
        else:
            rest = lanes.load(springs, REST, s)
        force = (length - rest) * lanes.load(springs, CONSTANT, s) / length * lanes.load(springs, FACTOR, s)
        lanes.store(springs, FORCE_X, s, force * dx)
        lanes.store(springs, FORCE_Y, s, force * dy)


@kernel
def _push_from_ground(points: np.ndarray, p: int, low: int, y: int, vx: int, physics: PhysicsValues) -> None:
    """Adds the implicit floor's forces on point `p` in the lanes of the mask `low`; `y` and `vx` are rows."""
    for lane in range(lanes.N_LANES):
        if low >> lane & 1:
            normal = -physics.ground_stiffness * points[y, p, lane]
            points[AY, p, lane] += normal
            drag = normal * math.tanh(points[vx, p, lane] * normal * physics.friction)
            points[AX, p, lane] -= physics.ground_friction_gain * physics.friction * drag


@inlined
def _slopes(pulls: Pulls, springs: np.ndarray, points: np.ndarray, p: int, x: int, v: int, physics: PhysicsValues):  # type: ignore[no-untyped-def]
    """Returns the velocity and acceleration of point `p`, each times the substep.

    `x` and `v` are the first rows of the positions and velocities at which they are taken. A point gathers its springs'
    forces in registers: adding them up in memory, spring by spring, waits for each sum to be stored.
    """
    pull_x = pull_y = lanes.spread(0.0)
    turn = pulls.turn[p]
    for i in range(pulls.start[p], turn):
        pull_x = pull_x - lanes.load(springs, FORCE_X, pulls.springs[i])
        pull_y = pull_y - lanes.load(springs, FORCE_Y, pulls.springs[i])
    for i in range(turn, pulls.start[p + 1]):
        pull_x = pull_x + lanes.load(springs, FORCE_X, pulls.springs[i])
        pull_y = pull_y + lanes.load(springs, FORCE_Y, pulls.springs[i])
    vx, vy = lanes.load(points, v, p), lanes.load(points, v + 1, p)
    ax = pull_x - physics.drag * vx + lanes.load(points, FX, p)
    ay = pull_y - physics.drag * vy - physics.gravity + lanes.load(points, FY, p)
    low = lanes.less(lanes.load(points, x + 1, p), 0.0)
    if low:
        lanes.store(points, AX, p, ax)
        lanes.store(points, AY, p, ay)
        _push_from_ground(points, p, low, x + 1, v, physics)
        ax, ay = lanes.load(points, AX, p), lanes.load(points, AY, p)
    h = physics.substep
    return vx * h, vy * h, ax * h, ay * h


@kernel
def _first_stage(pulls: Pulls, springs: np.ndarray, points: np.ndarray, physics: PhysicsValues) -> None:
    """Begins the sums of ways, and sets the second stage's state, half of the way ahead."""
    for p in range(points.shape[1]):
        ways = _slopes(pulls, springs, points, p, X, VX, physics)
        lanes.store(points, SUM_X + 0, p, ways[0])
        lanes.store(points, STAGE_X + 0, p, lanes.load(points, X + 0, p) + 0.5 * ways[0])
        lanes.store(points, SUM_X + 1, p, ways[1])
        lanes.store(points, STAGE_X + 1, p, lanes.load(points, X + 1, p) + 0.5 * ways[1])
        lanes.store(points, SUM_X + 2, p, ways[2])
        lanes.store(points, STAGE_X + 2, p, lanes.load(points, X + 2, p) + 0.5 * ways[2])
        lanes.store(points, SUM_X + 3, p, ways[3])
        lanes.store(points, STAGE_X + 3, p, lanes.load(points, X + 3, p) + 0.5 * ways[3])


@kernel
def _middle_stage(pulls: Pulls, springs: np.ndarray, points: np.ndarray, share: float, physics: PhysicsValues) -> None:
    """Adds the ways twice to their sums, and sets the next stage's state, a share of the way ahead."""
    for p in range(points.shape[1]):
        ways = _slopes(pulls, springs, points, p, STAGE_X, STAGE_VX, physics)
        lanes.store(points, SUM_X + 0, p, lanes.load(points, SUM_X + 0, p) + 2.0 * ways[0])
        lanes.store(points, STAGE_X + 0, p, lanes.load(points, X + 0, p) + share * ways[0])
        lanes.store(points, SUM_X + 1, p, lanes.load(points, SUM_X + 1, p) + 2.0 * ways[1])
        lanes.store(points, STAGE_X + 1, p, lanes.load(points, X + 1, p) + share * ways[1])
        lanes.store(points, SUM_X + 2, p, lanes.load(points, SUM_X + 2, p) + 2.0 * ways[2])
        lanes.store(points, STAGE_X + 2, p, lanes.load(points, X + 2, p) + share * ways[2])
        lanes.store(points, SUM_X + 3, p, lanes.load(points, SUM_X + 3, p) + 2.0 * ways[3])
        lanes.store(points, STAGE_X + 3, p, lanes.load(points, X + 3, p) + share * ways[3])


@kernel
def _last_stage(
    pulls: Pulls, springs: np.ndarray, is_free: np.ndarray, points: np.ndarray, physics: PhysicsValues
) -> None:
    """Moves the free points by the mean of the ways."""
    for p in range(points.shape[1]):
        ways = _slopes(pulls, springs, points, p, STAGE_X, STAGE_VX, physics)
        lanes.store(points, OLD_X, p, lanes.load(points, X, p))
        lanes.store(points, OLD_Y, p, lanes.load(points, Y, p))
        if is_free[p]:
            mean = (lanes.load(points, SUM_X + 0, p) + ways[0]) / 6.0
            lanes.store(points, X + 0, p, lanes.load(points, X + 0, p) + mean)
            mean = (lanes.load(points, SUM_X + 1, p) + ways[1]) / 6.0
            lanes.store(points, X + 1, p, lanes.load(points, X + 1, p) + mean)
            mean = (lanes.load(points, SUM_X + 2, p) + ways[2]) / 6.0
            lanes.store(points, X + 2, p, lanes.load(points, X + 2, p) + mean)
            mean = (lanes.load(points, SUM_X + 3, p) + ways[3]) / 6.0
            lanes.store(points, X + 3, p, lanes.load(points, X + 3, p) + mean)


@kernel
def integrate(
    ends: np.ndarray,
    pulls: Pulls,
    is_free: np.ndarray,
    points: np.ndarray,
    springs: np.ndarray,
    physics: PhysicsValues,
) -> None:
    """Advances the points by one substep of classical Runge-Kutta; FX, FY hold the contact forces."""
    _pull(ends, points, springs, X, Y, physics.convergence)
    _first_stage(pulls, springs, points, physics)
    _pull(ends, points, springs, STAGE_X, STAGE_Y, 0.0)
    _middle_stage(pulls, springs, points, 0.5, physics)
    _pull(ends, points, springs, STAGE_X, STAGE_Y, 0.0)
    _middle_stage(pulls, springs, points, 1.0, physics)
    _pull(ends, points, springs, STAGE_X, STAGE_Y, 0.0)
    _last_stage(pulls, springs, is_free, points, physics)


@kernel
def _share(squared, rest, shortest, longest):  # type: ignore[no-untyped-def]
    """Returns which share of its vector each end of a spring beyond a limit is off, 0 in the lanes within."""
    length = lanes.sqrt(squared)
    stress = length / rest
    too_long, too_short = lanes.less(longest, stress), lanes.less(stress, shortest)
    limit = lanes.select(too_long, rest * longest, rest * shortest)
    return lanes.select(too_long | too_short, (length - limit) / (length * 2.0), 0.0)


@kernel
def limit_lengths(
    ends: np.ndarray,
    rests: np.ndarray,
    is_free: np.ndarray,
    points: np.ndarray,
    springs: np.ndarray,
    beyond: np.ndarray,
) -> None:
    """Pulls springs that are too long or too short back, all at once from the same positions.

    The first ends move first, all of them, as in EvoGym. `beyond` is scratch for the numbers of springs.
    """
    n = 0
    for s in range(ends.shape[0]):
        a, b, rest = ends[s, 0], ends[s, 1], rests[s]
        dx = lanes.load(points, X, a) - lanes.load(points, X, b)
        dy = lanes.load(points, Y, a) - lanes.load(points, Y, b)
        squared = dx * dx + dy * dy
        longest, shortest = STRETCH_LIMIT * rest, SQUEEZE_LIMIT * rest
        if lanes.less(longest * longest, squared) | lanes.less(squared, shortest * shortest):
            share = _share(squared, rest, SQUEEZE_LIMIT, STRETCH_LIMIT)
            lanes.store(springs, FORCE_X, s, dx * share * LIMIT_GAIN)
            lanes.store(springs, FORCE_Y, s, dy * share * LIMIT_GAIN)
            beyond[n] = s
            n += 1
    for i in range(n):
        s = beyond[i]
        p = ends[s, 0]
        if is_free[p]:
            lanes.store(points, X, p, lanes.load(points, X, p) - lanes.load(springs, FORCE_X, s))
            lanes.store(points, Y, p, lanes.load(points, Y, p) - lanes.load(springs, FORCE_Y, s))
    for i in range(n):
        s = beyond[i]
        p = ends[s, 1]
        if is_free[p]:
            lanes.store(points, X, p, lanes.load(points, X, p) + lanes.load(springs, FORCE_X, s))
            lanes.store(points, Y, p, lanes.load(points, Y, p) + lanes.load(springs, FORCE_Y, s))


@kernel
def limit_rigid(rigid: np.ndarray, ends: np.ndarray, rests: np.ndarray, points: np.ndarray) -> None:
    """Corrects the edges of rigid voxels one after another, each from the positions that the last one left."""
    for i in range(rigid.shape[0]):
        s = rigid[i]
        a, b, rest = ends[s, 0], ends[s, 1], rests[s]
        ax, ay = lanes.load(points, X, a), lanes.load(points, Y, a)
        bx, by = lanes.load(points, X, b), lanes.load(points, Y, b)
        dx, dy = ax - bx, ay - by
        squared = dx * dx + dy * dy
        longest, shortest = RIGID_STRETCH_LIMIT * rest, RIGID_SQUEEZE_LIMIT * rest
        if lanes.less(longest * longest, squared) | lanes.less(squared, shortest * shortest):
            share = _share(squared, rest, RIGID_SQUEEZE_LIMIT, RIGID_STRETCH_LIMIT)
            dx, dy = dx * share * RIGID_LIMIT_GAIN, dy * share * RIGID_LIMIT_GAIN
            lanes.store(points, X, a, ax - dx)
            lanes.store(points, Y, a, ay - dy)
            lanes.store(points, X, b, bx + dx)
            lanes.store(points, Y, b, by + dy)
