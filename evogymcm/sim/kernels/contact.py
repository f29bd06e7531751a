"""Contact between voxels: the exact rule, applied to the candidates of `candidates.py`, in EvoGym's order.

Whether and how a corner has entered a voxel is decided by functions of plain numbers. They decide ties by rounding, as
EvoGym does (robots start corner on corner with the terrain), so the order of their operations matters.
"""

import math
from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import MISSING, PhysicsValues
from evogymcm.sim.kernels._jit import inlined, inner
from evogymcm.sim.kernels.candidates import position
from evogymcm.sim.kernels.contact_order import CONTACT, add_keys, sort_keys
from evogymcm.sim.kernels.trees import unite
from evogymcm.sim.tables import Surface, Terrain, in_two
from evogymcm.sim.topology import BL, BOTTOM, LEFT, RIGHT, TL, TOP, TR

_PARALLEL = 1e-4  # segments with a smaller determinant do not intersect
_DEGENERATE = 1e-6  # metres; sides shorter than this count as _FAR away
_FAR = 1000.0
# Columns of `Contacts.which`: point, ends of the side, main voxel and its corner, ref voxel, and an identity, which
# contacts that bring equal numbers share.
POINT, END_A, END_B, MAIN, CORNER, REF, IDENTITY, N_WHICH = range(8)
ALONG_X, ALONG_Y, DEPTH, N_HOW = range(4)  # columns of `Contacts.how`


class Sorting(NamedTuple):
    """Memory for the order of contacts, see `contact_order.py`."""

    boxes: np.ndarray  # (4, nodes)
    keys: np.ndarray  # (twice the capacity, 3) uint64
    found: np.ndarray  # (twice the capacity, 3)
    order: np.ndarray  # the contacts in the order in which they act
    is_fresh: np.ndarray  # of each object: whether its boxes are those of this substep


class Contacts(NamedTuple):
    """The contacts of a substep."""

    which: np.ndarray  # (capacity, N_WHICH)
    how: np.ndarray  # (capacity, N_HOW) the side, from end to end, and how deep the point is
    pushed_by: np.ndarray  # of each moving point, the identity of the contact that pushed it last, 0 for none
    sorting: Sorting


@inlined
def _is_inside(px, py, tlx, tly, trx, try_, blx, bly, brx, bry) -> bool:  # type: ignore[no-untyped-def]
    """Returns whether p is in a voxel, taken as two triangles; ties count as inside."""
    tlx, tly, trx, try_, brx, bry = tlx - px, tly - py, trx - px, try_ - py, brx - px, bry - py
    across = brx * tly - bry * tlx
    first = tlx * try_ - tly * trx
    second = trx * bry - try_ * brx
    if across * first >= 0.0 and across * second >= 0.0:
        return True
    blx, bly = blx - px, bly - py
    first = tlx * bly - tly * blx
    second = blx * bry - bly * brx
    return across * first >= 0.0 and across * second >= 0.0


@inlined
def _meet(ax, ay, bx, by, px, py, qx, qy) -> bool:  # type: ignore[no-untyped-def]
    """Returns whether segments a-b and p-q intersect; nearly parallel ones do not."""
    rx, ry, sx, sy = bx - ax, by - ay, qx - px, qy - py
    determinant = sx * ry - rx * sy
    if abs(determinant) < _PARALLEL:
        return False
    dx, dy = px - ax, py - ay
    t = (sx * dy - sy * dx) / determinant
    u = (rx * dy - ry * dx) / determinant
    return 0.0 <= t <= 1.0 and 0.0 <= u <= 1.0


@inlined
def _distance(ax, ay, bx, by, px, py) -> float:  # type: ignore[no-untyped-def]
    """Returns how far p is from the line through a and b."""
    along_x, along_y = bx - ax, by - ay
    length = math.sqrt(along_x * along_x + along_y * along_y)
    if length < _DEGENERATE:
        return _FAR
    return abs(along_x * (py - ay) - (px - ax) * along_y) / length


@inlined
def _push(force: np.ndarray, place: int, fx: float, fy: float) -> None:
    """Adds a force to a point; fixed geometry takes none."""
    if place >= 0:
        force[place] += fx
        force[place + 1] += fy


@inlined
def _velocity(xy: np.ndarray, old: np.ndarray, place: int, substep: float) -> tuple[float, float]:
    """Returns a point's true velocity: its way in the last substep, limits included, over the time."""
    if place < 0:
        return 0.0, 0.0
    return (xy[place] - old[place]) / substep, (xy[place + 1] - old[place + 1]) / substep


@inlined
def _touch(
    contacts: Contacts, i: int, xy: np.ndarray, old: np.ndarray, force: np.ndarray, physics: PhysicsValues
) -> None:
    """Adds the forces of contact `i`."""
    p, a, b = contacts.which[i, POINT], contacts.which[i, END_A], contacts.which[i, END_B]
    along_x, along_y, depth = contacts.how[i, ALONG_X], contacts.how[i, ALONG_Y], contacts.how[i, DEPTH]
    nx, ny = -along_y, along_x
    length = math.sqrt(nx * nx + ny * ny)
    nx, ny = nx / length, ny / length
    press = physics.contact_offset + depth
    push_x, push_y = nx * physics.contact_stiffness * press, ny * physics.contact_stiffness * press
    length = math.sqrt(nx * nx + ny * ny)  # normalised twice, as in EvoGym: the last bit may change
    nx, ny = nx / length, ny / length
    wx, wy = _velocity(xy, old, p, physics.substep)
    speed, damping = nx * wx + ny * wy, physics.contact_damping
    _push(force, p, push_x - nx * speed * damping, push_y - ny * speed * damping)
    for end in (a, b):
        ex, ey = _velocity(xy, old, end, physics.substep)
        speed = nx * ex + ny * ey
        back_x = push_x / 2.0 + nx * speed * damping / 2.0
        back_y = push_y / 2.0 + ny * speed * damping / 2.0
        _push(force, end, -back_x, -back_y)
    normal = math.sqrt(push_x * push_x + push_y * push_y)
    if normal == 0.0:
        return
    tx, ty = -ny, nx
    slip = tx * wx + ty * wy
    if slip < 0.0:
        tx, ty, slip = -tx, -ty, -slip
    grip = math.tanh(slip / (physics.friction * normal))
    drag_x = -tx * physics.friction_gain * physics.friction * normal * grip
    drag_y = -ty * physics.friction_gain * physics.friction * normal * grip
    _push(force, p, drag_x, drag_y)
    for end in (a, b):
        _push(force, end, -drag_x / 2.0, -drag_y / 2.0)


@inlined
def _enter(
    layout: Surface,
    terrain: Terrain,
    xy: np.ndarray,
    place: int,
    main: int,
    corner: int,
    ref: int,
    candidate: int,
    contacts: Contacts,
    n: int,
) -> int:
    """Adds the contact of a point inside voxel `ref`, as a corner of voxel `main`, if there is one; returns the number.

    It came in through a surface side that meets one of its own voxel's two sides at this corner.
    """
    static = terrain.static
    px, py = position(xy, static, place)
    flat, upright = TOP if corner <= TR else BOTTOM, LEFT if corner in (TL, BL) else RIGHT
    sides, first = (layout.sides, 8 * main) if main >= 0 else (terrain.sides, 8 * ~main)
    hax, hay = position(xy, static, sides[first + 2 * flat])
    hbx, hby = position(xy, static, sides[first + 2 * flat + 1])
    vax, vay = position(xy, static, sides[first + 2 * upright])
    vbx, vby = position(xy, static, sides[first + 2 * upright + 1])
    sides, first = (layout.sides, 8 * ref) if ref >= 0 else (terrain.sides, 8 * ~ref)
    surface = layout.surface[ref] if ref >= 0 else terrain.surface[~ref]
    entered, depth, along_x, along_y = MISSING, math.inf, 0.0, 0.0
    for side in range(4):
        if not surface >> side & 1:
            continue
        ax, ay = position(xy, static, sides[first + 2 * side])
        bx, by = position(xy, static, sides[first + 2 * side + 1])
        if _meet(hax, hay, hbx, hby, ax, ay, bx, by) or _meet(vax, vay, vbx, vby, ax, ay, bx, by):
            distance = _distance(ax, ay, bx, by, px, py)
            if distance < depth:  # the nearest counts, the first on a tie
                entered, depth, along_x, along_y = side, distance, bx - ax, by - ay
    if entered == MISSING:
        return n
    if n < contacts.which.shape[0]:
        contacts.which[n, POINT] = place
        contacts.which[n, END_A] = sides[first + 2 * entered]
        contacts.which[n, END_B] = sides[first + 2 * entered + 1]
        contacts.which[n, MAIN] = main
        contacts.which[n, CORNER] = corner
        contacts.which[n, REF] = ref
        contacts.which[n, IDENTITY] = 4 * candidate + entered + 1
        contacts.how[n, ALONG_X] = along_x
        contacts.how[n, ALONG_Y] = along_y
        contacts.how[n, DEPTH] = depth
    return n + 1


@inlined
def find_contacts(
    layout: Surface, terrain: Terrain, xy: np.ndarray, found: np.ndarray, n_found: int, contacts: Contacts
) -> int:
    """Finds the contacts among the candidates; returns their number, beyond the capacity where they did not fit."""
    n = int(np.int64(0))  # a constant would be compiled for apart
    static = terrain.static
    for i in range(n_found):
        place, ref = found[i, 0], found[i, 1]
        px, py = position(xy, static, place)
        tlx, tly = position(xy, static, found[i, 2])
        trx, try_ = position(xy, static, found[i, 3])
        blx, bly = position(xy, static, found[i, 4])
        brx, bry = position(xy, static, found[i, 5])
        if not _is_inside(px, py, tlx, tly, trx, try_, blx, bly, brx, bry):
            continue
        if place >= 0:
            uses = layout.uses
            first, end = layout.uses_start[place >> 1], layout.uses_start[(place >> 1) + 1]
        else:
            uses = terrain.uses
            first, end = terrain.uses_start[~place >> 1], terrain.uses_start[(~place >> 1) + 1]
        for u in range(first, end):
            if uses[2 * u] < 0 and ref < 0:
                continue  # a fixed voxel against a fixed one has no effect
            n = _enter(layout, terrain, xy, place, uses[2 * u], uses[2 * u + 1], ref, i, contacts, n)
    return n


@inlined
def _is_ordered(contacts: Contacts, n: int) -> bool:
    """Returns whether some point is pushed by two different contacts, so that their order shows in its last bits."""
    which, pushed_by = contacts.which, contacts.pushed_by
    found = False
    for i in range(n):
        for k in (POINT, END_A, END_B):
            place = which[i, k]
            if place >= 0:
                last = pushed_by[place >> 1]
                found |= last != 0 and last != which[i, IDENTITY]
                pushed_by[place >> 1] = which[i, IDENTITY]
    for i in range(n):
        for k in (POINT, END_A, END_B):
            if which[i, k] >= 0:
                pushed_by[which[i, k] >> 1] = 0
    return found


@inner
def _refresh(layout: Surface, terrain: Terrain, xy: np.ndarray, k: int, boxes: np.ndarray) -> None:
    """Sets the boxes of the nodes of object `k`'s tree."""
    for node in range(layout.node_start[k], layout.node_start[k + 1]):
        v = layout.node_voxel[node]
        if v == MISSING:
            unite(boxes, node, layout.children[2 * node], layout.children[2 * node + 1])
            continue
        low_x = low_y = math.inf
        high_x = high_y = -math.inf
        n_moving = layout.surface.shape[0]  # the fixed voxels follow them
        corners, first = (layout.corners, 4 * v) if v < n_moving else (terrain.corners, 4 * (v - n_moving))
        for corner in range(4):
            x, y = position(xy, terrain.static, corners[first + corner])
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
        boxes[0, node], boxes[1, node], boxes[2, node], boxes[3, node] = low_x, low_y, high_x, high_y


@inlined
def _number(layout: Surface, c: int) -> int:
    """Returns the surface voxel of the scene that is c or ~d: fixed ones follow those that move."""
    return c if c >= 0 else layout.surface.shape[0] + ~c


@inlined
def apply_contacts(
    layout: Surface,
    terrain: Terrain,
    xy: np.ndarray,
    old: np.ndarray,
    contacts: Contacts,
    n: int,
    force: np.ndarray,
    physics: PhysicsValues,
) -> None:
    """Adds the forces of `n` contacts to `force`: in EvoGym's order, where it shows."""
    n_keys = _order(layout, terrain, xy, contacts, n) if _is_ordered(contacts, n) else _take_all(layout, contacts, n)
    for i in range(n_keys):
        _touch(contacts, contacts.sorting.order[i], xy, old, force, physics)


@inlined
def _take_all(layout: Surface, contacts: Contacts, n: int) -> int:
    """Sets the order to that of finding, those within an object twice; returns its length."""
    order, n_keys = contacts.sorting.order, 0
    for i in range(n):
        order[n_keys] = i
        n_keys += 1
        if _object_of(layout, contacts.which[i, MAIN]) == _object_of(layout, contacts.which[i, REF]):
            order[n_keys] = i
            n_keys += 1
    return n_keys


@inner
def _order(layout: Surface, terrain: Terrain, xy: np.ndarray, contacts: Contacts, n: int) -> int:
    """Sets the order to EvoGym's; returns its length: contacts within an object act twice."""
    which, sorting = contacts.which, contacts.sorting
    n_keys = int(np.int64(0))
    children, place, leaf = in_two(layout.children, 2), layout.node_place, layout.leaf
    for i in range(n):
        for c in (which[i, MAIN], which[i, REF]):
            k = _object_of(layout, c)
            if not sorting.is_fresh[k]:
                _refresh(layout, terrain, xy, k, sorting.boxes)
                sorting.is_fresh[k] = 1
        n_keys = add_keys(
            sorting.keys,
            sorting.found,
            n_keys,
            i,
            _number(layout, which[i, MAIN]),
            which[i, CORNER],
            _number(layout, which[i, REF]),
            layout.cell_object,
            layout.node_start,
            children,
            place,
            leaf,
            sorting.boxes,
        )
    for k in range(layout.node_start.shape[0] - 1):
        sorting.is_fresh[k] = 0
    sort_keys(sorting.keys, sorting.found, n_keys, sorting.order, layout.node_start, children, place, sorting.boxes)
    for i in range(n_keys):
        sorting.order[i] = sorting.found[sorting.order[i], CONTACT]
    return n_keys


@inlined
def _object_of(layout: Surface, c: int) -> int:
    """Returns the number of a voxel's object."""
    return layout.cell_object[_number(layout, c)]
