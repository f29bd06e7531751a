"""Contact between voxels: the exact rule, applied to the candidates of `candidates.py`.

Whether and how a corner has entered a voxel is decided by functions of plain numbers. They decide ties by rounding, as
EvoGym does (robots start corner on corner with the terrain), so the order of their operations matters.
"""

import math

import numpy as np

from evogymcm.sim import lanes
from evogymcm.sim._jit import inlined, kernel
from evogymcm.sim.constants import MISSING, PhysicsValues
from evogymcm.sim.springs import FX, FY, OLD_X, OLD_Y, X, Y
from evogymcm.sim.topology import BL, BOTTOM, BR, LEFT, RIGHT, TL, TOP, TR

_PARALLEL = 1e-4  # segments with a smaller determinant do not intersect
_DEGENERATE = 1e-6  # metres; sides shorter than this count as _FAR away
_FAR = 1000.0


@inlined
def _position(points: np.ndarray, static_points: np.ndarray, p: int, lane: int) -> tuple[float, float]:
    """Returns where a moving or fixed point is."""
    n = points.shape[1]
    if p < n:
        return points[X, p, lane], points[Y, p, lane]
    return static_points[p - n, 0], static_points[p - n, 1]


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
def _push(points: np.ndarray, p: int, lane: int, fx: float, fy: float) -> None:
    """Adds a force to a point; fixed geometry takes none."""
    if p < points.shape[1]:
        points[FX, p, lane] += fx
        points[FY, p, lane] += fy


@inlined
def _velocity(points: np.ndarray, p: int, lane: int, substep: float) -> tuple[float, float]:
    """Returns a point's true velocity: its way in the last substep, limits included, over the time."""
    if p >= points.shape[1]:
        return 0.0, 0.0
    vx = (points[X, p, lane] - points[OLD_X, p, lane]) / substep
    vy = (points[Y, p, lane] - points[OLD_Y, p, lane]) / substep
    return vx, vy


@inlined
def _touch(
    points: np.ndarray,
    lane: int,
    p: int,
    a: int,
    b: int,
    along_x: float,
    along_y: float,
    depth: float,
    physics: PhysicsValues,
) -> None:
    """Adds the forces of point `p` that is `depth` inside the side from point `a` to `b`, `along` apart."""
    nx, ny = -along_y, along_x
    length = math.sqrt(nx * nx + ny * ny)
    nx, ny = nx / length, ny / length
    press = physics.contact_offset + depth
    push_x, push_y = nx * physics.contact_stiffness * press, ny * physics.contact_stiffness * press
    length = math.sqrt(nx * nx + ny * ny)  # normalised twice, as in EvoGym: the last bit may change
    nx, ny = nx / length, ny / length
    wx, wy = _velocity(points, p, lane, physics.substep)
    speed, damping = nx * wx + ny * wy, physics.contact_damping
    _push(points, p, lane, push_x - nx * speed * damping, push_y - ny * speed * damping)
    for end in (a, b):
        ex, ey = _velocity(points, end, lane, physics.substep)
        speed = nx * ex + ny * ey
        back_x = push_x / 2.0 + nx * speed * damping / 2.0
        back_y = push_y / 2.0 + ny * speed * damping / 2.0
        _push(points, end, lane, -back_x, -back_y)
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
    _push(points, p, lane, drag_x, drag_y)
    for end in (a, b):
        _push(points, end, lane, -drag_x / 2.0, -drag_y / 2.0)


@kernel
def respond(
    corners: np.ndarray,
    sides: np.ndarray,
    is_surface: np.ndarray,
    cell_object: np.ndarray,
    static_points: np.ndarray,
    points: np.ndarray,
    active: int,
    pairs: np.ndarray,
    counts: np.ndarray,
    physics: PhysicsValues,
) -> None:
    """Sets FX, FY to the contact forces of the active lanes, from their lists.

    Args:
        corners: (C + D, 4) points of the surface voxels, moving ones first.
        sides: (C + D, 4, 2) ends of their top, right, bottom, left; surface ones run with the outside on their left.
        is_surface: (C + D, 4) whether they are surface.
        cell_object: (C + D,) their objects. Within one object a contact is found from both sides and acts twice.
        static_points: (Q, 2) coordinates of the points numbered from P on.
        points: (N_POINT_ROWS, P, 8) state.
        active: Mask of the lanes.
        pairs: (8, capacity, 3) candidates: main voxel, corner, ref voxel.
        counts: (8,) lengths of the lists.
        physics: Constants.
    """
    for p in range(points.shape[1]):
        lanes.store(points, FX, p, 0.0)
        lanes.store(points, FY, p, 0.0)
    for lane in range(lanes.N_LANES):
        if not active >> lane & 1:
            continue
        for i in range(counts[lane]):
            main, k, ref = pairs[lane, i, 0], pairs[lane, i, 1], pairs[lane, i, 2]
            p, tl, tr, bl, br = corners[main, k], corners[ref, TL], corners[ref, TR], corners[ref, BL], corners[ref, BR]
            px, py = _position(points, static_points, p, lane)
            tlx, tly = _position(points, static_points, tl, lane)
            trx, try_ = _position(points, static_points, tr, lane)
            blx, bly = _position(points, static_points, bl, lane)
            brx, bry = _position(points, static_points, br, lane)
            if not _is_inside(px, py, tlx, tly, trx, try_, blx, bly, brx, bry):
                continue
            # It came in through a surface side that meets one of its own voxel's two sides at this corner.
            flat, upright = TOP if k <= TR else BOTTOM, LEFT if k in (TL, BL) else RIGHT
            hax, hay = _position(points, static_points, sides[main, flat, 0], lane)
            hbx, hby = _position(points, static_points, sides[main, flat, 1], lane)
            vax, vay = _position(points, static_points, sides[main, upright, 0], lane)
            vbx, vby = _position(points, static_points, sides[main, upright, 1], lane)
            entered, depth, along_x, along_y = MISSING, math.inf, 0.0, 0.0
            for side in range(4):
                if not is_surface[ref, side]:
                    continue
                ax, ay = _position(points, static_points, sides[ref, side, 0], lane)
                bx, by = _position(points, static_points, sides[ref, side, 1], lane)
                if _meet(hax, hay, hbx, hby, ax, ay, bx, by) or _meet(vax, vay, vbx, vby, ax, ay, bx, by):
                    distance = _distance(ax, ay, bx, by, px, py)
                    if distance < depth:  # the nearest counts, the first on a tie
                        entered, depth, along_x, along_y = side, distance, bx - ax, by - ay
            if entered != MISSING:
                a, b = sides[ref, entered, 0], sides[ref, entered, 1]
                _touch(points, lane, p, a, b, along_x, along_y, depth, physics)
                if cell_object[main] == cell_object[ref]:
                    _touch(points, lane, p, a, b, along_x, along_y, depth, physics)
