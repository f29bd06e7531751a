"""Trees of boxes against stored ones, and against the rules written down once more as plainly as possible."""

import json
from pathlib import Path

import numpy as np
import pytest

from evogymcm._grid import full_connections, grid_from_rows
from evogymcm.sim.constants import MISSING
from evogymcm.sim.kernels import hash_sets
from evogymcm.sim.kernels._jit import kernel
from evogymcm.sim.kernels.trees import build_tree
from evogymcm.sim.topology import BOTTOM, LEFT, RIGHT, TOP, topology
from tests.sim.tools import grid_of

EXAMPLES = json.loads((Path(__file__).parents[1] / "data" / "trees.json").read_text())
STEPS = {TOP: (-1, 0), BOTTOM: (1, 0), LEFT: (0, -1), RIGHT: (0, 1)}


class HashSet:
    """A list in C++'s order of iteration."""

    def __init__(self):
        self.values, self.size = [], 1

    def insert(self, value):
        if value in self.values:
            return
        if self.size == 1 or len(self.values) == self.size:
            self.size = min(m for m in (13, 29, 59, 127, 257, 541) if m > self.size)
            old, self.values = self.values, []
            for v in old:
                self._put(v)
        self._put(value)

    def _put(self, value):
        same = [i for i, v in enumerate(self.values) if v % self.size == value % self.size]
        self.values.insert(same[0] if same else 0, value)

    def erase(self, value):
        if value in self.values:
            self.values.remove(value)


class Twin:
    """A tree, with nothing remembered from one merge to the next."""

    def __init__(self, t, origin):
        self.t, self.voxel_at = t, {tuple(cell): v for v, cell in enumerate(t.cells.tolist())}
        order = HashSet()
        for v in np.flatnonzero(t.is_surface_side.any(1)).tolist():
            order.insert(v)
        self.leaves, self.children = order.values, []
        corners = t.points(*origin)[t.corner_points[self.leaves]]
        self.boxes = [(c.min(0), c.max(0)) for c in corners]
        self.sets = [self.neighbours(v) for v in self.leaves]
        self.open = list(range(len(self.leaves)))
        mutual = all(i in self.sets[j].values for i, of in enumerate(self.sets) for j in of.values)
        self.traits, self.most_entries = (set() if mutual else {"one-sided"}), 0
        while len(self.open) > 1:
            self.merge()

    def beside(self, v, side):
        down, right = STEPS[side]
        row, column = self.t.cells[v].tolist()
        return None if self.t.is_surface_side[v, side] else self.voxel_at[row + down, column + right]

    def neighbours(self, v):
        found = HashSet()
        for side in (TOP, BOTTOM, LEFT, RIGHT):
            if self.beside(v, side) in self.leaves:
                found.insert(self.leaves.index(self.beside(v, side)))
        if not found.values:
            for pair in ((TOP, LEFT), (TOP, RIGHT), (BOTTOM, LEFT), (BOTTOM, RIGHT)):
                for one, two in (pair, pair[::-1]):
                    between = self.beside(v, one)
                    if between is not None and self.beside(between, two) in self.leaves:
                        found.insert(self.leaves.index(self.beside(between, two)))
        return found

    def joint(self, i, j):
        return np.minimum(self.boxes[i][0], self.boxes[j][0]), np.maximum(self.boxes[i][1], self.boxes[j][1])

    def merge(self):
        best, least = None, np.inf
        for of in (lambda i: self.sets[i].values, lambda i: self.open):
            for i in self.open:
                for j in of(i):
                    if j != i and j in self.open:
                        low, high = self.joint(i, j)
                        area = float((high - low)[0] * (high - low)[1])
                        if area < least:
                            best, least = (i, j), area
            if best:
                break
            self.traits.add("in parts")
        i, j = best
        new, both = len(self.boxes), HashSet()
        self.children.append([i, j])
        self.boxes.append(self.joint(i, j))
        for v in self.sets[i].values + self.sets[j].values:
            both.insert(v)
        both.erase(i)
        both.erase(j)
        for v in both.values:
            self.sets[v].erase(i)
            self.sets[v].erase(j)
            self.sets[v].insert(new)
        self.sets.append(both)
        self.open = [v for v in self.open if v not in best] + [new]
        self.most_entries = max(self.most_entries, sum(len(self.sets[v].values) for v in self.open))


def below(tree, node):
    """The leaves below a node, depth first."""
    n = len(tree.leaves)
    return [node] if node < n else [leaf for child in tree.children[node - n] for leaf in below(tree, child)]


def assert_well_numbered(tree):
    n, root = len(tree.leaves), len(tree.parent) - 1
    assert tree.parent[root] == MISSING
    assert tree.depth[root] == 0
    assert tree.height == tree.depth.max()
    assert tree.place[below(tree, root)].tolist() == list(range(n))
    for node in range(n, root + 1):
        first, second = tree.children[node - n]
        assert max(first, second) < node
        assert tree.parent[[first, second]].tolist() == [node, node]
        assert (tree.depth[[first, second]] == tree.depth[node] + 1).all()
        assert tree.place[node] == tree.place[below(tree, second)[0]]
    assert all(array.dtype == np.int32 and array.flags.c_contiguous for array in tree[:-1])


@pytest.mark.parametrize("example", EXAMPLES, ids=[e["name"] for e in EXAMPLES])
def test_stored_trees(example):
    """Six worlds of the benchmark, a ring with bumps on the inside, and a full block."""
    tree = build_tree(topology(grid_from_rows(example["rows"])), tuple(example["origin"]))
    assert tree.leaves.tolist() == example["leaves"]
    assert tree.children.tolist() == example["merges"]
    assert_well_numbered(tree)


def random_object(rng):
    """Any cells: with holes, in pieces, fixed ones, and often with some sides unjoined."""
    rows, columns = rng.integers(1, 9, 2)
    grid = (rng.random((rows, columns)) < rng.uniform(0.5, 1)) * rng.integers(1, 6, (rows, columns))
    grid.flat[rng.integers(grid.size)] = 1
    joined = full_connections(grid)
    if rng.random() < 0.5:
        joined = joined[:, rng.random(joined.shape[1]) < rng.uniform(0, 1)]
    return topology(grid, joined), tuple(rng.integers(0, 60, 2).tolist())


def test_random_objects():
    rng, traits = np.random.default_rng(1), set()
    for _ in range(150):
        t, origin = random_object(rng)
        tree, twin = build_tree(t, origin), Twin(t, origin)
        assert tree.leaves.tolist() == twin.leaves
        assert tree.children.tolist() == twin.children
        assert_well_numbered(tree)
        assert twin.most_entries <= 8 * len(twin.leaves)  # what the kernels have room for
        traits |= twin.traits
    assert traits == {"one-sided", "in parts"}  # bumps on the inside; surfaces that nothing joins


def test_one_voxel_is_leaf_and_root():
    tree = build_tree(topology(grid_of(".../.F.")), (3, 4))
    assert [array.tolist() for array in tree[:-1]] == [[0], [], [MISSING], [0], [0]]
    assert tree.height == 0


def test_an_object_without_voxels_has_no_tree():
    with pytest.raises(ValueError, match="got 0 surface voxels, allowed are 1 to"):
        build_tree(topology(grid_of("..")), (0, 0))


@kernel
def insert(sets, s, value):
    """An entrance from Python: `hash_sets.insert` is inlined."""
    hash_sets.insert(sets, s, value)


def test_hash_sets_keep_the_order():
    """Insertions, also of what is there, and erasures, until the sets have grown four times."""
    rng, ours, twins = np.random.default_rng(0), hash_sets.new_sets(3, 3 * 200), [HashSet() for _ in range(3)]
    hash_sets.clear(ours)
    for _ in range(900):
        s, value = rng.integers(3).item(), rng.integers(200).item()
        if rng.random() < 0.8:
            insert(ours, s, value)
            twins[s].insert(value)
        else:
            hash_sets.erase(ours, s, value)
            twins[s].erase(value)
    hash_sets.move(ours, 0, 1)
    for value in twins[0].values:
        twins[1].insert(value)
    for s, twin in ((1, twins[1]), (2, twins[2])):
        values, entry = [], ours.head[s]
        while entry != MISSING:
            values.append(ours.value[entry].item())
            entry = ours.after[entry]
        assert values == twin.values
        assert ours.size[s] == twin.size >= 127
