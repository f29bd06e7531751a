"""One env-step of a block: eight worlds with one topology, thirty substeps."""

from typing import NamedTuple

import numpy as np

from evogymcm.sim import lanes
from evogymcm.sim._jit import kernel
from evogymcm.sim.candidates import collapsed, list_candidates, lists_hold
from evogymcm.sim.constants import MISSING, PhysicsValues
from evogymcm.sim.contact import respond
from evogymcm.sim.scene import Layout
from evogymcm.sim.springs import (
    CONSTANT,
    FACTOR,
    GOAL,
    N_POINT_ROWS,
    N_SPRING_ROWS,
    N_STATE_ROWS,
    VY,
    Pulls,
    X,
    integrate,
    limit_lengths,
    limit_rigid,
)

ALL_LANES = (1 << lanes.N_LANES) - 1


class State(NamedTuple):
    """What changes in a block: P moving points, S springs, C moving surface voxels. Made once, reused.

    Those with lanes are tables, see `lanes.new_table`.
    """

    points: np.ndarray  # (N_POINT_ROWS, P, 8)
    saved: np.ndarray  # (N_STATE_ROWS, P, 8) the state before the present env-step
    springs: np.ndarray  # (N_SPRING_ROWS, S, 8)
    boxes: np.ndarray  # (4, C, 8)
    nearby: np.ndarray  # (P,)
    beyond: np.ndarray  # (S,)
    pairs: np.ndarray  # (8, capacity, 3)
    counts: np.ndarray  # (8,)
    crowded: np.ndarray  # (n, 2)


def new_state(layout: Layout) -> State:
    """Returns a block's state with every lane at reset and every spring at its rest length and S = 1."""
    n_points, n_springs, n_cells = len(layout.initial), len(layout.rest), len(layout.grid_cells)
    n_robot_cells = int(layout.objects[0, 3])
    state = State(
        points=lanes.new_table(N_POINT_ROWS, n_points),
        saved=lanes.new_table(N_STATE_ROWS, n_points),
        springs=lanes.new_table(N_SPRING_ROWS, n_springs),
        boxes=lanes.aligned_zeros(4, n_cells, lanes.N_LANES),
        nearby=np.zeros(n_points, np.int32),
        beyond=np.zeros(n_springs, np.int32),
        pairs=np.zeros((lanes.N_LANES, 16 * n_cells + 64, 3), np.int32),
        counts=np.zeros(lanes.N_LANES, np.int32),
        crowded=np.zeros((max(n_robot_cells * (n_robot_cells - 1) // 2, 1), 2), np.int32),
    )
    state.springs[CONSTANT] = layout.constants[:, None]
    state.springs[FACTOR] = 1.0
    state.springs[GOAL] = layout.rest[:, None]
    reset_lanes(layout, state, np.ones(lanes.N_LANES, bool))
    return state


def laid_out(state: State) -> State:
    """Returns the state with its tables in memory as `new_state` lays them out, which a copy of an array loses."""
    names = ("points", "saved", "springs")
    tables = {name: lanes.new_table(*getattr(state, name).shape[:2]) for name in names}
    fresh = state._replace(**tables, boxes=lanes.aligned_zeros(*state.boxes.shape))
    for name in (*names, "boxes"):
        getattr(fresh, name)[...] = getattr(state, name)
    return fresh


def reset_lanes(layout: Layout, state: State, chosen: np.ndarray) -> None:
    """Puts the lanes of the (8,) bool mask back to their initial positions, at rest."""
    start = layout.initial.T[:, :, None]
    state.points[:N_STATE_ROWS, :, chosen] = np.concatenate([start, np.zeros_like(start), start])


@kernel
def set_goals(layout: Layout, springs: np.ndarray, worlds: np.ndarray, actuation: np.ndarray) -> None:
    """Sets the lengths that actuators drive their edges to.

    Args:
        layout: The scene; its drivers are columns of `actuation`.
        springs: (N_SPRING_ROWS, S, 8) springs.
        worlds: (8,) row of `actuation` of each lane, MISSING for none.
        actuation: (worlds, voxels) target lengths relative to rest.
    """
    for s in range(layout.drivers.shape[0]):
        one, two = layout.drivers[s, 0], layout.drivers[s, 1]
        if one == MISSING:
            continue
        for lane in range(lanes.N_LANES):
            world = worlds[lane]
            if world == MISSING:
                continue
            target = actuation[world, one]
            if two != MISSING:
                target = (target + actuation[world, two]) / 2.0
            springs[GOAL, s, lane] = layout.rest[s] * target


@kernel
def set_constants(layout: Layout, springs: np.ndarray, worlds: np.ndarray, stiffness: np.ndarray) -> None:
    """Sets spring constants or their factors, by the edge rule, from (worlds, voxels) stiffness factors."""
    for s in range(layout.owners.shape[0]):
        one, two = layout.owners[s, 0], layout.owners[s, 1]
        if one == MISSING:
            continue
        for lane in range(lanes.N_LANES):
            world = worlds[lane]
            if world == MISSING:
                continue
            first = stiffness[world, one]
            second = stiffness[world, two] if two != MISSING else first
            if layout.owner_constants[s, 0] > 0.0:
                shares = layout.owner_constants[s]
                springs[CONSTANT, s, lane] = first * shares[0] + second * shares[1]
            else:
                springs[FACTOR, s, lane] = (first + second) / 2.0


@kernel
def _not_finite(points: np.ndarray) -> int:
    """Returns the mask of lanes in which some position or velocity is NaN or infinite."""
    good = ALL_LANES
    for row in range(X, VY + 1):
        for p in range(points.shape[1]):
            good &= lanes.less(lanes.absolute(lanes.load(points, row, p)), np.inf)
    return ALL_LANES & ~good


@kernel
def _copy_lanes(source: np.ndarray, target: np.ndarray, mask: int) -> None:
    """Copies the state rows of the masked lanes."""
    for row in range(N_STATE_ROWS):
        for p in range(source.shape[1]):
            lanes.store(target, row, p, lanes.select(mask, lanes.load(source, row, p), lanes.load(target, row, p)))


@kernel
def advance(
    layout: Layout,
    physics: PhysicsValues,
    state: State,
    worlds: np.ndarray,
    actuation: np.ndarray,
    stiffness: np.ndarray,
    n_substeps: int,
) -> int:
    """Advances the lanes that have a world by one env-step.

    A lane that becomes unstable, or in which a number is no longer finite, gets the state from before the step back.

    Args:
        layout: The scene; its drivers and owners are columns of `actuation` and `stiffness`.
        physics: Constants.
        state: The block's state.
        worlds: (8,) row of `actuation` and `stiffness` of each lane, MISSING for lanes that stay as they are.
        actuation: (N, V) target lengths relative to rest.
        stiffness: (N, V) stiffness factors, or (0, V) to keep the present ones.
        n_substeps: Integration steps.

    Returns:
        The mask of unstable lanes, or MISSING where a candidate list was too short: then no lane has moved.
    """
    active = 0
    for lane in range(lanes.N_LANES):
        if worlds[lane] != MISSING:
            active |= 1 << lane
    set_goals(layout, state.springs, worlds, actuation)
    if stiffness.shape[0] > 0:
        set_constants(layout, state.springs, worlds, stiffness)
    ends, rest, is_free, corners = layout.ends, layout.rest, layout.is_free, layout.corners
    points, springs, boxes, pairs, counts = state.points, state.springs, state.boxes, state.pairs, state.counts
    n_robot_cells = layout.objects[0, 3]
    pulls = Pulls(layout.pulls_start, layout.pulls_turn, layout.pulls)
    _copy_lanes(points, state.saved, ALL_LANES)
    unstable, n_crowded = 0, 0
    for substep in range(n_substeps):
        going = active & ~unstable
        if substep == 0 or not lists_hold(points, going):
            n_crowded = list_candidates(layout, points, boxes, going, state.nearby, pairs, counts, state.crowded)
            longest = 0
            for lane in range(lanes.N_LANES):
                longest = max(longest, counts[lane])
            if longest > pairs.shape[1]:
                _copy_lanes(state.saved, points, ALL_LANES)
                return MISSING
        # Decided by the positions at the substep's start; what the substep would still change is given up anyway.
        unstable |= going & collapsed(corners, n_robot_cells, points, boxes, state.crowded, n_crowded)
        respond(
            corners,
            layout.sides,
            layout.is_surface,
            layout.cell_object,
            layout.static_points,
            points,
            active & ~unstable,
            pairs,
            counts,
            physics,
        )
        integrate(ends, pulls, is_free, points, springs, physics)
        limit_lengths(ends, rest, is_free, points, springs, state.beyond)
        limit_rigid(layout.rigid, ends, rest, points)
    unstable |= active & _not_finite(points)
    _copy_lanes(state.saved, points, ALL_LANES & ~(active & ~unstable))
    return unstable
