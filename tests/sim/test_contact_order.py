"""The order of contacts against the walk itself, through every pair of nodes."""

from itertools import pairwise

import numpy as np
import pytest

from evogymcm.sim.constants import MISSING
from evogymcm.sim.kernels.contact_order import add_keys, find_path, join_trees, sort_keys
from evogymcm.sim.kernels.trees import Tree, build_tree
from evogymcm.sim.topology import BL, BR, TL, TR, topology
from tests.sim.tools import STANDARD, grid_of


class Walk:
    """Trees of some objects, and where they are now: (V, 4, 2) corners of the surface voxels, object by object."""

    def __init__(self, trees, corners):
        ends = np.cumsum([0, *(len(tree.leaves) for tree in trees)])
        self.cell_object = np.repeat(np.arange(len(trees)), np.diff(ends)).astype(np.int32)
        voxels = []
        for tree, (start, end) in zip(trees, pairwise(ends), strict=True):
            voxels.append(np.full(tree.leaves.max() + 1, MISSING))
            voxels[-1][np.sort(tree.leaves)] = np.arange(start, end)
        self.forest = join_trees(trees, voxels)
        sides = [*corners.min(1).T, *corners.max(1).T]
        self.boxes = np.full((4, len(self.forest.voxel)), np.nan)
        for node, voxel in enumerate(self.forest.voxel):
            if voxel == MISSING:  # children have lower numbers
                below = self.boxes[:, self.forest.children[node]]
                self.boxes[:, node] = [*below[:2].min(1), *below[2:].max(1)]
            else:
                self.boxes[:, node] = [side[voxel] for side in sides]

    def root(self, k):
        return int(self.forest.node_start[k + 1]) - 1

    def path(self, a, b):
        f, pair = self.forest, (self.root(self.cell_object[a]), self.root(self.cell_object[b]))
        return int(find_path(*pair, f.leaf[a], f.leaf[b], f.children, f.place, self.boxes))

    def order(self, contacts):
        """Contacts (main, corner, ref) in their order by keys."""
        f, keys, n = self.forest, np.empty((2 * len(contacts), 3), np.uint64), 0
        found, order = np.empty((len(keys), 3), np.int32), np.empty(len(keys), np.int32)
        for k, (main, corner, ref) in enumerate(contacts):
            tables = (self.cell_object, f.node_start, f.children, f.place, f.leaf, self.boxes)
            n = add_keys(keys, found, n, k, main, corner, ref, *tables)
        sort_keys(keys, found, n, order, f.node_start, f.children, f.place, self.boxes)
        return [contacts[found[row, 2]] for row in order[:n]]

    def leaf_pairs(self, a, b):
        """Pairs of surface voxels whose boxes meet, below two nodes, as the walk comes to them."""
        f, low, high = self.forest, self.boxes[:2], self.boxes[2:]
        if (low[:, a] > high[:, b]).any() or (high[:, a] < low[:, b]).any():
            return
        is_leaf, areas = f.voxel[[a, b]] != MISSING, (high - low)[0, [a, b]] * (high - low)[1, [a, b]]
        if is_leaf.all():
            yield f.voxel[a].item(), f.voxel[b].item()
        elif is_leaf[0] or (not is_leaf[1] and areas[0] < areas[1]):
            for child in f.children[b]:
                yield from self.leaf_pairs(a, child)
        else:
            for child in f.children[a]:
                yield from self.leaf_pairs(child, b)

    def all_contacts(self):
        """All that could be, each as often as it acts."""
        n = len(self.forest.node_start) - 1
        for i in range(n):
            for j in range(i, n):
                for a, b in self.leaf_pairs(self.root(i), self.root(j)):
                    for main, ref in ((a, b), (b, a)):
                        yield from ((main, corner, ref) for corner in (TL, TR, BR, BL))


def of_bodies(*placed, spread=0.0, seed=0):
    """A walk of bodies given as text and place, their points moved at random."""
    rng, parts = np.random.default_rng(seed), [topology(grid_of(text)) for text, _ in placed]
    trees = [build_tree(t, origin) for t, (_, origin) in zip(parts, placed, strict=True)]
    corners = []
    for t, (_, origin) in zip(parts, placed, strict=True):
        x = t.points(*origin)
        x = x + rng.uniform(-spread, spread, x.shape)
        corners.append(x[t.corner_points[t.is_surface_side.any(1)]])
    return Walk(trees, np.concatenate(corners))


def assert_ordered(walk, rng, n):
    every = list(walk.all_contacts())
    chosen = [every[k] for k in rng.choice(len(every), n, replace=False)]
    chosen = list(dict.fromkeys(chosen))
    expected = [contact for contact in every if contact in chosen]
    assert walk.order(chosen) == expected
    return expected


def test_the_paths_of_a_body_at_reset():
    walk, surface = of_bodies((STANDARD, (1, 1))), [v for v in range(22) if v not in (6, 8)]
    root = walk.root(0)
    pairs = [(surface[a], surface[b]) for a, b in walk.leaf_pairs(root, root)]
    assert len(pairs) == 98
    first = [(11, 11), (11, 15), (15, 11), (19, 19), (19, 15), (15, 19), (15, 15), (11, 14), (19, 18), (19, 14)]
    assert pairs[:12] == [*first, (15, 18), (15, 14)]
    for pair, turns in {
        (11, 11): "000000", (11, 15): "0000011", (15, 11): "0000101", (20, 16): "1010110111", (16, 20): "1010111011",
    }.items():  # fmt: skip
        assert f"{walk.path(*map(surface.index, pair)):064b}".rstrip("0") == turns.rstrip("0")


@pytest.mark.parametrize("seed", range(6))
def test_contacts_come_in_the_order_of_the_walk(seed):
    """Three bodies in and over each other, one of them a single voxel; then two at rest, with ties of areas."""
    three = (("HHH/H.H/HHH", (3, 3)), ("S", (4, 4)), ("VV.V/.VVV", (2, 3)))
    rng = np.random.default_rng(seed)
    walks = of_bodies(*three, spread=0.08, seed=seed), of_bodies(("HHH/H.H", (1, 1)), ("SSS/SSS", (1, 1)))
    for walk in walks:
        ordered = assert_ordered(walk, rng, 40)
        halves = [contact for contact in ordered if ordered.count(contact) == 2]
        assert halves  # within one body each acts twice
        assert len(halves) < len(ordered)


def chain(n):
    """A tree as deep as can be: each inner node has a leaf, as the first child and as the second in turn."""
    children = [[n + k - 1 if k else 0, k + 1][:: 1 - k % 2 * 2] for k in range(n - 1)]
    parent, place, order = np.full(2 * n - 1, MISSING, np.int32), np.zeros(2 * n - 1, np.int32), []

    def number(node):
        place[node] = len(order)
        if node < n:
            order.append(node)
            return
        for child in children[node - n]:
            place[node] = len(order)  # in the end, where the second child begins
            parent[child] = node
            number(child)

    number(2 * n - 2)
    return Tree(np.arange(n, dtype=np.int32), np.array(children, np.int32), parent, parent, place, n - 1)


def test_paths_of_more_than_64_turns():
    """Those of leaves at the ends of two chains of forty part only there."""
    n, rng = 40, np.random.default_rng(0)
    walk = Walk([chain(n), chain(n)], rng.uniform(0.45, 0.55, (2 * n, 4, 2)) + rng.uniform(-0.02, 0.02, (2 * n, 1, 2)))
    deep = [*range(4), *range(n, n + 4)]
    every = [contact for contact in walk.all_contacts() if contact[0] in deep and contact[2] in deep]
    paths = {walk.path(main, ref) for main, _, ref in every if main < n <= ref}
    assert 0 < len(paths) < len({(main, ref) for main, _, ref in every if main < n <= ref})
    chosen = list(dict.fromkeys(every[k] for k in rng.permutation(len(every))))
    assert walk.order(chosen) == every
