"""A slow twin of the simulator: the rules of one substep, written down once more, as plainly as possible.

It keeps the fixed voxels as points and springs like all others, looks at every pair of voxels, and adds up as it comes.
"""

from itertools import pairwise

import numpy as np

from evogymcm.sim.constants import FIXED, RIGID
from evogymcm.sim.topology import BL, BR, TL, TR, topology

H, GRAVITY, DRAG, ALPHA, FLOOR = 1e-4, 110.0, 0.1, 0.006, 1.4e7
CONTACT, OFFSET, DAMPING, MU, GRIP, FLOOR_GRIP = 2.1e6, 0.005, 140.0, 0.2, 1200.0, 10.0
# Sides are numbered top, right, bottom, left.
SIDES_OF = {TL: (0, 3), TR: (0, 1), BR: (2, 1), BL: (2, 3)}  # those that meet at a corner
OUTWARD = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def normal_of(a, b):
    along = b - a
    return np.array([-along[1], along[0]]) / np.hypot(*along)


class Twin:
    """One world. `x`, `v` and `old` are (points, 2), objects one after another."""

    def __init__(self, objects):
        parts = [topology(o.grid, o.connections) for o in objects]
        starts = np.cumsum([0, *(t.n_points for t in parts)])
        self.slices = {o.name: slice(*ends) for o, ends in zip(objects, pairwise(starts), strict=True)}
        self.x = np.concatenate([t.points(*o.origin) for o, t in zip(objects, parts, strict=True)])
        self.v, self.old = np.zeros_like(self.x), self.x.copy()
        self.fixed = np.concatenate([t.is_fixed for t in parts])
        self.ends = np.concatenate([s + e for s, t in zip(starts, parts, strict=False) for e in (t.edges, t.diagonals)])
        self.k = np.concatenate([k for t in parts for k in (t.edge_constants, t.diagonal_constants())])
        self.rest = np.concatenate([np.repeat([0.1, np.sqrt(0.02)], (len(t.edges), 2 * t.n_cells)) for t in parts])
        self.goal, self.factor = self.rest.copy(), np.ones_like(self.rest)
        self.cells, self.rigid, n_springs = [], [], 0  # cells: object, corners, sides as (a, b), surface, code, place
        for i, (start, t) in enumerate(zip(starts, parts, strict=False)):
            for c in range(t.n_cells):
                sides = start + t.edges[t.sides[c]]
                out = [normal_of(*self.x[s]) @ n > 0 for s, n in zip(sides, OUTWARD, strict=True)]
                sides = [tuple(s) if o else tuple(s[::-1]) for s, o in zip(sides, out, strict=True)]
                surface = t.is_surface_side[c]
                self.cells.append((i, start + t.corner_points[c], sides, surface, t.codes[c], tuple(t.cells[c])))
                if t.codes[c] == RIGID:
                    self.rigid += [n_springs + e for e in t.sides[c]]
            n_springs += len(t.edges) + 2 * t.n_cells
        self.parts = parts

    def drive(self, actuation):
        """Sets the goals of the robot's springs from one number a cell of its grid."""
        t = self.parts[0]
        numbers = actuation.reshape(t.rows, t.columns)[tuple(t.cells.T)]
        for e, drivers in enumerate(t.edge_drivers):
            if (drivers >= 0).any():
                self.goal[e] = 0.1 * numbers[drivers[drivers >= 0]].mean()

    def stiffen(self, stiffness):
        """Sets the factors of the robot's springs (the paper's equation) from one number a cell of its grid."""
        t = self.parts[0]
        numbers = stiffness.reshape(t.rows, t.columns)[tuple(t.cells.T)]
        edges = [numbers[owners[owners >= 0]].mean() for owners in t.edge_owners]
        self.factor[: len(edges) + 2 * t.n_cells] = np.concatenate([edges, np.repeat(numbers, 2)])

    def box(self, cell):
        corners = self.x[cell[1]]
        return corners.min(0), corners.max(0)

    def overlap(self, a, b):
        (low_a, high_a), (low_b, high_b) = self.box(a), self.box(b)
        return (low_a <= high_b).all() and (low_b <= high_a).all()

    def is_inside(self, p, ref):
        tl, tr, bl, br = self.x[ref[1]] - self.x[p]
        c = cross(br, tl)
        if c * cross(tl, tr) >= 0 and c * cross(tr, br) >= 0:
            return True
        return c * cross(tl, bl) >= 0 and c * cross(bl, br) >= 0

    def meet(self, one, two):
        (a, b), (c, d) = self.x[list(one)], self.x[list(two)]
        determinant = cross(b - a, d - c)
        if abs(determinant) < 1e-4:
            return False
        t, s = cross(c - a, d - c) / determinant, cross(c - a, b - a) / determinant
        return 0 <= t <= 1 and 0 <= s <= 1

    def touch(self, main, ref, w, force):
        """Adds the contact forces of the corners of `main` in `ref`."""
        for corner in (TL, TR, BR, BL):
            p = main[1][corner]
            if p in ref[1] or not self.is_inside(p, ref):
                continue
            own = [main[2][side] for side in SIDES_OF[corner]]
            found = [s for s, on in zip(ref[2], ref[3], strict=True) if on and any(self.meet(m, s) for m in own)]
            if not found:
                continue
            gaps = [abs(cross(self.x[b] - self.x[a], self.x[p] - self.x[a])) / np.hypot(*(self.x[b] - self.x[a]))
                    for a, b in found]  # fmt: skip
            (a, b), gap = found[int(np.argmin(gaps))], min(gaps)
            n = normal_of(self.x[a], self.x[b])
            size = CONTACT * (OFFSET + gap)
            force[p] += n * size - n * (n @ w[p]) * DAMPING
            for end in (a, b):
                force[end] -= (n * size + n * (n @ w[end]) * DAMPING) / 2
            t = np.array([-n[1], n[0]])
            t = t if t @ w[p] >= 0 else -t
            friction = -GRIP * MU * size * np.tanh(t @ w[p] / (MU * size)) * t
            force[p] += friction
            force[[a, b]] -= friction / 2

    def contacts(self):
        w, force = (self.x - self.old) / H, np.zeros_like(self.x)
        surface = [cell for cell in self.cells if cell[3].any()]
        for a in surface:
            for b in surface:
                if a[0] <= b[0] and not (a[4] == b[4] == FIXED) and self.overlap(a, b):
                    self.touch(a, b, w, force)
                    self.touch(b, a, w, force)
        return force

    def crowding(self):
        """Ordered pairs of the robot's surface cells that overlap more than a cell apart, and its number of them."""
        cells = [cell for cell in self.cells if cell[0] == 0 and cell[3].any()]
        pairs = [(a, b) for a in cells for b in cells if max(abs(np.subtract(a[5], b[5]))) > 1 and self.overlap(a, b)]
        return len(pairs), len(cells)

    def acceleration(self, x, v, length, contact):
        force = contact - DRAG * v - np.array([0, GRAVITY])
        u = x[self.ends[:, 0]] - x[self.ends[:, 1]]
        d = np.hypot(*u.T)
        pull = u * (self.k * self.factor * (d - length) / d)[:, None]
        np.add.at(force, self.ends[:, 0], -pull)
        np.add.at(force, self.ends[:, 1], pull)
        normal = np.where(x[:, 1] < 0, -FLOOR * x[:, 1], 0)
        force[:, 1] += normal
        force[:, 0] -= FLOOR_GRIP * MU * normal * np.tanh(v[:, 0] * normal * MU)
        return force

    def substep(self):
        contact = self.contacts()
        u = self.x[self.ends[:, 0]] - self.x[self.ends[:, 1]]
        d = np.hypot(*u.T)
        length = d + ALPHA * (self.goal - d)
        slopes, x, v = [], self.x, self.v
        for step in (H / 2, H / 2, H, 0):
            slopes.append((v, self.acceleration(x, v, length, contact)))
            x, v = self.x + step * slopes[-1][0], self.v + step * slopes[-1][1]
        dx, dv = (H / 6 * (k1 + 2 * k2 + 2 * k3 + k4) for k1, k2, k3, k4 in zip(*slopes, strict=True))
        self.old = self.x
        self.x = self.x + np.where(self.fixed[:, None], 0, dx)
        self.v = self.v + np.where(self.fixed[:, None], 0, dv)
        self.limit()

    def limit(self):
        a, b = self.ends.T
        u = self.x[a] - self.x[b]
        d = np.hypot(*u.T)
        bound = np.clip(d, 0.75 * self.rest, 1.25 * self.rest)
        move = 0.8 * u * ((d - bound) / (2 * d))[:, None]
        np.add.at(self.x, a, np.where(self.fixed[a, None], 0, -move))
        np.add.at(self.x, b, np.where(self.fixed[b, None], 0, move))
        for s in self.rigid:
            u = self.x[a[s]] - self.x[b[s]]
            d = np.hypot(*u)
            bound = np.clip(d, 0.97 * self.rest[s], 1.03 * self.rest[s])
            move = 0.5 * u * (d - bound) / (2 * d)
            self.x[a[s]] -= move
            self.x[b[s]] += move
