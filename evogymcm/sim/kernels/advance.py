"""One env-step of worlds, one after another: thirty substeps each."""

from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import MISSING, PhysicsValues
from evogymcm.sim.kernels._jit import inlined, inner, kernel
from evogymcm.sim.kernels.candidates import N_FOUND, collapsed, list_candidates, lists_hold
from evogymcm.sim.kernels.contact import N_HOW, N_WHICH, Contacts, Sorting, apply_contacts, find_contacts
from evogymcm.sim.kernels.springs import (
    FIRST_FORCE,
    SpringScratch,
    SpringState,
    SpringTables,
    integrate,
    limit_lengths,
    limit_rigid,
)
from evogymcm.sim.kernels.vectors import absolute, aligned_zeros, less, load, store
from evogymcm.sim.tables import END_CELL, FIRST_CELL, Layout, Surface, Terrain, in_two, layout_of, part, terrain_of


class Storage(NamedTuple):
    """All worlds of a simulator. N worlds, D designs (robots in their sceneries)."""

    ints: np.ndarray  # (D, ...) int32 rows of `Layout`s, see `tables.pack`
    floats: np.ndarray  # (D, ...) their numbers
    terrain_ints: np.ndarray  # (sceneries, ...) the same of `Terrain`s
    terrain_floats: np.ndarray
    design_of: np.ndarray  # (N, 2) design and scenery of each world
    state: np.ndarray  # (N, ...) x y of points, v, old x y; constants, factors and goals of springs
    physics: np.ndarray  # `PhysicsValues`


class Scratch(NamedTuple):
    """What a thread needs to advance a world."""

    floats: np.ndarray
    ints: np.ndarray
    keys: np.ndarray


class Room(NamedTuple):
    """How much of what a scratch has room for."""

    numbers: int  # of points' coordinates
    springs: int
    cells: int
    crowded: int  # pairs of the robot's voxels
    nodes: int  # of the trees
    objects: int
    candidates: int
    contacts: int


def new_scratch(room: Room) -> Scratch:
    """Returns memory for worlds that fit in `room`, whose last two parts the kernel reads off what is left."""
    floats = 11 * room.numbers + 3 * room.springs + FIRST_FORCE + 4 * (room.cells + 8)
    floats += N_HOW * room.contacts + 4 * room.nodes
    ints = room.springs + room.numbers // 2 + 2 * room.crowded + room.objects
    ints += N_FOUND * room.candidates + (N_WHICH + 8) * room.contacts
    memory = np.zeros(8 + ints, np.int32)
    memory[:8] = room
    return Scratch(aligned_zeros(floats), memory, np.zeros(6 * room.contacts, np.uint64))


@inner
def set_goals(layout: Layout, goal: np.ndarray, actuation: np.ndarray) -> None:
    """Sets the lengths that actuators drive their edges to, from one number for each cell, relative to rest."""
    for i in range(0, layout.driven.shape[0], 3):
        s, one, two = layout.driven[i], layout.driven[i + 1], layout.driven[i + 2]
        target = actuation[one]
        if two != MISSING:
            target = (target + actuation[two]) / 2.0
        goal[s] = layout.rest[s] * target


@inner
def set_constants(layout: Layout, constant: np.ndarray, factor: np.ndarray, stiffness: np.ndarray) -> None:
    """Sets spring constants or their factors, by the edge rule, from one stiffness factor for each cell."""
    for i in range(layout.owned.shape[0] // 3):
        s, one, two = layout.owned[3 * i], layout.owned[3 * i + 1], layout.owned[3 * i + 2]
        first = stiffness[one]
        second = stiffness[two] if two != MISSING else first
        if layout.shares.shape[0] > 0:
            constant[s] = first * layout.shares[2 * i] + second * layout.shares[2 * i + 1]
        else:
            factor[s] = (first + second) / 2.0


@kernel
def set_stiffness(storage: Storage, worlds: np.ndarray, stiffness: np.ndarray) -> None:
    """Sets the spring constants of worlds by the edge rule from (N, V) stiffness factors."""
    for w in worlds:
        design = storage.design_of[w, 0]
        layout = layout_of(storage.ints[design], storage.floats[design])
        m, s = layout.initial.shape[0], layout.rest.shape[0]
        row = storage.state[w]
        set_constants(layout, part(row, 3 * m, s), part(row, 3 * m + s, s), stiffness[w])


@inner
def _is_finite(xy: np.ndarray, v: np.ndarray) -> bool:
    """Returns whether all positions and velocities are finite."""
    for i in range(0, xy.shape[0], 8):
        if less(absolute(load(xy, i)), np.inf) & less(absolute(load(v, i)), np.inf) != 255:
            return False
    return True


@inner
def _copy(source: np.ndarray, target: np.ndarray) -> None:
    for i in range(0, source.shape[0], 8):
        store(target, i, load(source, i))


@inlined
def _advance(
    layout: Surface,
    terrain: Terrain,
    tables: SpringTables,
    state: SpringState,
    scratch: SpringScratch,
    listed: np.ndarray,
    boxes: np.ndarray,
    found: np.ndarray,
    crowded: np.ndarray,
    contacts: Contacts,
    physics: PhysicsValues,
    n_substeps: int,
) -> int:
    """Advances a world; returns 1 where it became unstable, MISSING where a list was too short, else 0."""
    n_found, n_crowded, has_force = 0, 0, True
    n_cells = layout.objects[END_CELL] - layout.objects[FIRST_CELL]
    xy, force = state.xy, scratch.contact
    for substep in range(n_substeps):
        if substep == 0 or not lists_hold(xy, listed):
            n_found, n_crowded = list_candidates(layout, terrain, xy, boxes, found, crowded)
            if n_found > found.shape[0]:
                return MISSING
            _copy(xy, listed)
        # Decided by the positions at the substep's start; what the substep would still change is given up anyway.
        if n_crowded > 0 and collapsed(layout.corners, n_cells, xy, crowded, n_crowded):
            return 1
        n = find_contacts(layout, terrain, xy, found, n_found, contacts)
        if n > contacts.which.shape[0]:
            return MISSING
        if has_force:
            for i in range(0, force.shape[0], 8):
                store(force, i, 0.0)
        has_force = n > 0
        if has_force:
            apply_contacts(layout, terrain, xy, state.old, contacts, n, force, physics)
        integrate(tables, state, scratch, physics)
        limit_lengths(tables, state, scratch)
        limit_rigid(tables.rigid, xy)
    return 0 if _is_finite(xy, state.v) else 1


@kernel
def advance(
    storage: Storage,
    scratch: Scratch,
    worlds: np.ndarray,
    actuation: np.ndarray,
    stiffness: np.ndarray,
    n_substeps: int,
    unstable: np.ndarray,
) -> int:
    """Advances worlds by one env-step.

    A world that becomes unstable, or in which a number is no longer finite, gets the state from before the step back.

    Args:
        storage: All worlds.
        scratch: The thread's memory.
        worlds: (m,) the worlds to advance.
        actuation: (N, V) target lengths relative to rest.
        stiffness: (N, V) stiffness factors, or (0, V) to keep the present ones.
        n_substeps: Integration steps.
        unstable: (N,) receives which of them became unstable.

    Returns:
        How many worlds were advanced: fewer than m where a list was too short for the next one, which has not moved.
    """
    ph = storage.physics
    physics = PhysicsValues(ph[0], ph[1], ph[2], ph[3], ph[4], ph[5], ph[6], ph[7], ph[8], ph[9], ph[10])
    z = scratch.ints
    room = Room(z[0], z[1], z[2], z[3], z[4], z[5], z[6], z[7])
    for done in range(worlds.shape[0]):
        w = worlds[done]
        design, scenery = storage.design_of[w, 0], storage.design_of[w, 1]
        layout = layout_of(storage.ints[design], storage.floats[design])
        terrain = terrain_of(storage.terrain_ints[scenery], storage.terrain_floats[scenery])
        tables = SpringTables(layout.ends, layout.rest, layout.groups, layout.pulls, layout.free, layout.rigid)
        m, s = layout.initial.shape[0], layout.rest.shape[0]
        row = storage.state[w]
        state = SpringState(
            part(row, 0, m),
            part(row, m, m),
            part(row, 2 * m, m),
            part(row, 3 * m, s),
            part(row, 3 * m + s, s),
            part(row, 3 * m + 2 * s, s),
        )
        floats, ints = scratch.floats, scratch.ints
        spring_scratch = SpringScratch(
            part(floats, 0, m),
            part(floats, room.numbers, m),
            part(floats, 2 * room.numbers, m),
            part(floats, 3 * room.numbers, m),
            part(floats, 4 * room.numbers, m),
            part(floats, 5 * room.numbers, m),
            part(floats, 6 * room.numbers, m),
            part(floats, 11 * room.numbers, s),
            part(floats, 11 * room.numbers + room.springs, FIRST_FORCE + 2 * s),
            part(ints, 8, s),
        )
        listed, saved = part(floats, 7 * room.numbers, m), part(floats, 8 * room.numbers, 3 * m)
        used = 11 * room.numbers + 3 * room.springs + FIRST_FORCE
        boxes = in_two(part(floats, used, 4 * (room.cells + 8)), room.cells + 8)
        used += 4 * (room.cells + 8)
        how = in_two(part(floats, used, N_HOW * room.contacts), N_HOW)
        node_boxes = in_two(part(floats, used + N_HOW * room.contacts, 4 * room.nodes), room.nodes)
        used = 8 + room.springs
        pushed_by = part(ints, used, m // 2)
        used += room.numbers // 2
        crowded = in_two(part(ints, used, 2 * room.crowded), 2)
        used += 2 * room.crowded
        is_fresh = part(ints, used, room.objects)
        used += room.objects
        found = in_two(part(ints, used, N_FOUND * room.candidates), N_FOUND)
        used += N_FOUND * room.candidates
        which = in_two(part(ints, used, N_WHICH * room.contacts), N_WHICH)
        used += N_WHICH * room.contacts
        leaves = in_two(part(ints, used, 6 * room.contacts), 3)
        order = part(ints, used + 6 * room.contacts, 2 * room.contacts)
        keys = in_two(part(scratch.keys, 0, 6 * room.contacts), 3)
        contacts = Contacts(which, how, pushed_by, Sorting(node_boxes, keys, leaves, order, is_fresh))

        set_goals(layout, state.goal, actuation[w])
        if stiffness.shape[0] > 0:
            set_constants(layout, state.constant, state.factor, stiffness[w])
        _copy(part(row, 0, 3 * m), saved)
        surface = Surface(
            layout.objects,
            layout.corners,
            layout.sides,
            layout.surface,
            layout.cell_object,
            layout.apart,
            layout.uses_start,
            layout.uses,
            layout.node_start,
            layout.children,
            layout.node_place,
            layout.node_voxel,
            layout.leaf,
        )
        result = _advance(
            surface,
            terrain,
            tables,
            state,
            spring_scratch,
            listed,
            boxes,
            found,
            crowded,
            contacts,
            physics,
            n_substeps,
        )
        if result != 0:
            _copy(saved, part(row, 0, 3 * m))
        if result == MISSING:
            return done
        unstable[w] = result == 1
    return worlds.shape[0]
