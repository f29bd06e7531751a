"""The tree of boxes over an object's surface voxels, in the shape that EvoGym gives it.

Contact forces add up in the order in which EvoGym finds contacts, by walking pairs of such trees (`contact_order.py`).
The shape depends on the last bits of the object's first coordinates and on the order of values in hash sets of C++
(libstdc++'s `unordered_set<int>`). Both are followed exactly.

Nodes are numbered as they are made: first the leaves, then the inner nodes, children before parents, the root last.
"""

from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import MISSING, VOXEL
from evogymcm.sim.kernels._jit import inlined, inner, kernel
from evogymcm.sim.kernels.hash_sets import SIZES, Sets, clear, erase, insert, move, new_sets
from evogymcm.sim.topology import BOTTOM, LEFT, RIGHT, TOP, Topology

LOW_X, LOW_Y, HIGH_X, HIGH_Y = range(4)  # rows of `boxes`
_STEPS = ((-1, 0, TOP), (1, 0, BOTTOM), (0, -1, LEFT), (0, 1, RIGHT))  # rows, columns, side to the joined neighbours


class Tree(NamedTuple):
    """An object's tree: leaves 0 ... n - 1 and inner nodes n ... 2n - 2. The arrays are int32."""

    leaves: np.ndarray  # (n,) voxel of each leaf, a row of `Topology.cells`
    children: np.ndarray  # (n - 1, 2) first and second child of inner node n + k
    parent: np.ndarray  # (2n - 1,) MISSING for the root
    depth: np.ndarray  # (2n - 1,) how many nodes are above
    # (2n - 1,) a leaf's number in the tree's depth-first order; an inner node's: the first one under its second child.
    # So a leaf below an inner node is under the second child where its place is not less.
    place: np.ndarray
    height: int  # the largest depth


class _Work(NamedTuple):
    """What a build needs besides, for n leaves of c voxels; integers are int64, so that kernels are compiled once."""

    sets: Sets  # the neighbours of each node
    leaf_of: np.ndarray  # (c,) leaf of each voxel, MISSING inside
    voxel_at: np.ndarray  # (rows, columns) voxel of each occupied cell
    boxes: np.ndarray  # (4, 2n - 1)
    least: np.ndarray  # (2n - 1,) area of the smallest joint box with another node
    partner: np.ndarray  # (2n - 1,) that node


@inner
def _number_leaves(is_surface_side: np.ndarray, sets: Sets, leaves: np.ndarray, leaf_of: np.ndarray) -> None:
    """Sets the voxel of each leaf: the surface voxels as a hash set orders them."""
    s = sets.size.shape[0] - 1  # the root's set, of which the order is never used
    for v in range(is_surface_side.shape[0]):
        leaf_of[v] = MISSING
        if is_surface_side[v, 0] or is_surface_side[v, 1] or is_surface_side[v, 2] or is_surface_side[v, 3]:
            insert(sets, s, v)
    for i in range(leaves.shape[0]):
        v = sets.value[sets.head[s]]
        leaves[i], leaf_of[v] = v, i
        erase(sets, s, v)


@inner
def _link_leaves(
    cells: np.ndarray,
    is_surface_side: np.ndarray,
    leaf_of: np.ndarray,
    voxel_at: np.ndarray,
    sets: Sets,
) -> None:
    """Fills the leaves' sets of neighbours: joined ones; where none is on the surface, linked diagonal ones.

    The latter happens to bumps on the inside of a body. Their neighbours need not have them for neighbours.
    """
    for v in range(cells.shape[0]):
        voxel_at[cells[v, 0], cells[v, 1]] = v
    for v in range(cells.shape[0]):
        i = leaf_of[v]
        if i == MISSING:
            continue
        for k in range(4):
            beside = _neighbour(cells, is_surface_side, voxel_at, v, k)
            if beside != MISSING and leaf_of[beside] != MISSING:
                insert(sets, i, leaf_of[beside])
        if sets.head[i] != MISSING:
            continue
        for upright in range(2):
            for flat in range(2, 4):
                for first, second in ((upright, flat), (flat, upright)):
                    beside = _neighbour(cells, is_surface_side, voxel_at, v, first)
                    if beside != MISSING:
                        beside = _neighbour(cells, is_surface_side, voxel_at, beside, second)
                    if beside != MISSING and leaf_of[beside] != MISSING:
                        insert(sets, i, leaf_of[beside])


@inlined
def _neighbour(cells: np.ndarray, is_surface_side: np.ndarray, voxel_at: np.ndarray, v: int, k: int) -> int:
    """Returns the voxel joined to `v` above, below, on the left or on the right (k = 0 ... 3), or MISSING."""
    down, right, side = _STEPS[k]
    return MISSING if is_surface_side[v, side] else voxel_at[cells[v, 0] + down, cells[v, 1] + right]


@inner
def _bound_leaves(cells: np.ndarray, leaves: np.ndarray, x: int, y: int, rows: int, boxes: np.ndarray) -> None:
    """Sets the leaves' boxes from the coordinates that `Topology.points` gives, bit for bit."""
    top = y * VOXEL + rows * VOXEL
    for i in range(leaves.shape[0]):
        row, column = cells[leaves[i], 0], cells[leaves[i], 1]
        boxes[LOW_X, i] = x * VOXEL + column * VOXEL
        boxes[HIGH_X, i] = x * VOXEL + (column + 1) * VOXEL
        boxes[LOW_Y, i] = top - (row + 1) * VOXEL
        boxes[HIGH_Y, i] = top - row * VOXEL


@inlined
def unite(boxes: np.ndarray, node: int, first: int, second: int) -> None:
    """Sets the box of a node to the union of its children's."""
    boxes[LOW_X, node] = min(boxes[LOW_X, first], boxes[LOW_X, second])
    boxes[LOW_Y, node] = min(boxes[LOW_Y, first], boxes[LOW_Y, second])
    boxes[HIGH_X, node] = max(boxes[HIGH_X, first], boxes[HIGH_X, second])
    boxes[HIGH_Y, node] = max(boxes[HIGH_Y, first], boxes[HIGH_Y, second])


@inlined
def _consider(work: _Work, i: int, j: int) -> None:
    """Makes `j` the partner of `i` where their joint box is smaller than with the present one."""
    boxes = work.boxes
    width = max(boxes[HIGH_X, i], boxes[HIGH_X, j]) - min(boxes[LOW_X, i], boxes[LOW_X, j])
    height = max(boxes[HIGH_Y, i], boxes[HIGH_Y, j]) - min(boxes[LOW_Y, i], boxes[LOW_Y, j])
    if width * height < work.least[i]:
        work.least[i], work.partner[i] = width * height, j


@inner
def _seek_neighbour(work: _Work, parent: np.ndarray, i: int) -> None:
    """Finds the partner of node `i`: the first of its neighbours with the least joint box."""
    work.least[i], work.partner[i] = np.inf, MISSING
    entry = work.sets.head[i]
    while entry != MISSING:
        j = work.sets.value[entry]
        if parent[j] == MISSING:
            _consider(work, i, j)
        entry = work.sets.after[entry]


@inner
def _seek_any(work: _Work, parent: np.ndarray, i: int, end: int) -> None:
    """Finds the partner of node `i` among all nodes below `end`."""
    work.least[i], work.partner[i] = np.inf, MISSING
    for j in range(end):
        if j != i and parent[j] == MISSING:
            _consider(work, i, j)


@inner
def _best(least: np.ndarray, end: int) -> int:
    """Returns the first node below `end` with the least joint box, or MISSING."""
    best, area = MISSING, np.inf
    for i in range(end):
        if least[i] < area:
            best, area = i, least[i]
    return best


@inner
def _join_neighbours(work: _Work, parent: np.ndarray, i: int, j: int, node: int) -> None:
    """Moves the neighbours of `i` and `j` to the new node, which takes their place among those neighbours' own."""
    sets = work.sets
    move(sets, i, node)
    move(sets, j, node)
    erase(sets, node, i)
    erase(sets, node, j)
    entry = sets.head[node]
    while entry != MISSING:
        v = sets.value[entry]
        if parent[v] == MISSING:  # the sets of the others are never read again
            erase(sets, v, i)
            erase(sets, v, j)
            insert(sets, v, node)
            work.partner[v] = i  # to be sought again: the order has changed
        entry = sets.after[entry]


@inner
def _merge(work: _Work, children: np.ndarray, parent: np.ndarray) -> None:
    """Merges the two unfinished nodes with the least joint box, until one is left: neighbours, then any two.

    Each node keeps its best partner, which is sought again only where a merge may have changed it: the joint box with
    the new node is never smaller than with its children. Once no neighbours are left there never are any again.
    """
    n = children.shape[0] + 1
    has_neighbours = True
    for i in range(n):
        _seek_neighbour(work, parent, i)
    for node in range(n, 2 * n - 1):
        i = _best(work.least, node)
        if i == MISSING:
            has_neighbours = False
            for v in range(node):
                if parent[v] == MISSING:
                    _seek_any(work, parent, v, node)
            i = _best(work.least, node)
        j = work.partner[i]
        children[node - n, 0], children[node - n, 1] = i, j
        parent[i] = parent[j] = node
        unite(work.boxes, node, i, j)
        if has_neighbours:
            _join_neighbours(work, parent, i, j, node)
        work.least[i] = work.least[j] = np.inf
        work.partner[node] = i
        for v in range(node + 1):
            if parent[v] != MISSING or (work.partner[v] != i and work.partner[v] != j):
                continue
            if has_neighbours:
                _seek_neighbour(work, parent, v)
            else:
                _seek_any(work, parent, v, node + 1)


@inner
def _number_nodes(children: np.ndarray, parent: np.ndarray, depth: np.ndarray, place: np.ndarray) -> int:
    """Sets depth and place of the nodes, see `Tree`, and returns the largest depth."""
    n = children.shape[0] + 1
    for k in range(n):
        depth[k] = 1  # leaves below, until the places are known
    for k in range(n - 1):
        depth[n + k] = depth[children[k, 0]] + depth[children[k, 1]]
    place[2 * n - 2] = 0
    for k in range(n - 2, -1, -1):
        first, second = children[k, 0], children[k, 1]
        place[first] = place[n + k]
        place[n + k] += depth[first]
        place[second] = place[n + k]
    height = 0
    depth[2 * n - 2] = 0
    for node in range(2 * n - 3, -1, -1):
        depth[node] = depth[parent[node]] + 1
        height = max(height, depth[node])
    return height


@kernel
def _build(cells: np.ndarray, is_surface_side: np.ndarray, rows: int, x: int, y: int, work: _Work, tree: Tree) -> int:
    """Fills the arrays of a tree and returns its height."""
    clear(work.sets)
    tree.parent[:] = MISSING
    _number_leaves(is_surface_side, work.sets, tree.leaves, work.leaf_of)
    _link_leaves(cells, is_surface_side, work.leaf_of, work.voxel_at, work.sets)
    _bound_leaves(cells, tree.leaves, x, y, rows, work.boxes)
    _merge(work, tree.children, tree.parent)
    return _number_nodes(tree.children, tree.parent, tree.depth, tree.place)


def build_tree(topology: Topology, origin: tuple[int, int]) -> Tree:
    """Returns the tree of an object that is placed with its lower-left cell at the world cell `origin`.

    Raises:
        ValueError: The object has no voxel, or more on its surface than are provided for.
    """
    n = int(np.count_nonzero(topology.is_surface_side.any(axis=1)))
    if not 0 < n <= SIZES[-1]:
        raise ValueError(f"topology: got {n} surface voxels, allowed are 1 to {SIZES[-1]}")
    nodes = 2 * n - 1
    work = _Work(
        sets=new_sets(nodes, 8 * n),  # a leaf's four neighbours, each way; merging adds no others
        leaf_of=np.empty(topology.n_cells, np.int64),
        voxel_at=np.empty((topology.rows, topology.columns), np.int64),
        boxes=np.empty((4, nodes)),
        least=np.empty(nodes),
        partner=np.empty(nodes, np.int64),
    )
    leaves, children = np.empty(n, np.int32), np.empty((n - 1, 2), np.int32)
    parent, depth, place = (np.empty(nodes, np.int32) for _ in range(3))
    tree = Tree(leaves, children, parent, depth, place, height=0)
    height = _build(topology.cells, topology.is_surface_side, topology.rows, *origin, work, tree)
    return tree._replace(height=height)
