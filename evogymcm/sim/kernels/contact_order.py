"""The order in which EvoGym finds contacts, and so adds up their forces, as keys to sort contacts by.

For each pair of objects, EvoGym walks their two trees of boxes (`trees.py`) depth first, from the pair of roots. At a
pair of nodes it opens the one with the larger box, the first on a tie, never a leaf, and goes on with its first child,
then with its second. The boxes, and so which one is larger, change in every substep. A contact belongs to a pair of
leaves. Its path through the walk is a number: two paths agree until they part, and compare there as the walk goes.

Arrays hold the trees of a world's objects one after another, see `Forest`. Indices aren't checked.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evogymcm.sim.constants import MISSING
from evogymcm.sim.kernels._jit import inlined, inner, kernel
from evogymcm.sim.kernels.trees import HIGH_X, HIGH_Y, LOW_X, LOW_Y, Tree

_TURN = (0, 1, 3, 2)  # when a main voxel's corners TL, TR, BL, BR have their turn
_SECOND = 4  # turns later: the second leaf's voxel is main
_FIRST_BIT = np.uint64(1 << 63)
PAIR, PATH, TURN = range(3)  # columns of `keys`
FIRST_LEAF, SECOND_LEAF, CONTACT = range(3)  # columns of `found`


class Forest(NamedTuple):
    """The trees of K objects with N nodes and V surface voxels; arrays are int32."""

    node_start: np.ndarray  # (K + 1,) where an object's nodes begin; its root is the last of them
    children: np.ndarray  # (N, 2) nodes, lower ones; MISSING for a leaf
    place: np.ndarray  # (N,) see `Tree`
    voxel: np.ndarray  # (N,) surface voxel of a leaf, MISSING for an inner node
    leaf: np.ndarray  # (V,) node of a surface voxel


def join_trees(trees: Sequence[Tree], voxels: Sequence[np.ndarray]) -> Forest:
    """Returns the trees of a world's objects in common arrays.

    Args:
        trees: One of each object.
        voxels: For each object, (c,) numbers of its voxels among the world's V surface voxels; inner ones are not read.
    """
    sizes = [len(tree.place) for tree in trees]
    node_start = np.cumsum([0, *sizes], dtype=np.int32)
    children, voxel = np.full((sum(sizes), 2), MISSING, np.int32), np.full(sum(sizes), MISSING, np.int32)
    place, leaf = np.empty(sum(sizes), np.int32), np.empty(sum(len(tree.leaves) for tree in trees), np.int32)
    for start, tree, numbers in zip(node_start[:-1].tolist(), trees, voxels, strict=True):
        n, own = len(tree.leaves), numbers[tree.leaves]
        children[start + n : start + 2 * n - 1] = tree.children + start
        place[start : start + 2 * n - 1] = tree.place
        voxel[start : start + n] = own
        leaf[own] = np.arange(start, start + n)
    return Forest(node_start, children, place, voxel, leaf)


def put_first(tree: Tree, voxels: np.ndarray, forest: Forest, before: int) -> Forest:
    """Returns the forest with one more object, whose nodes come first; it takes the same time for however many others.

    Args:
        tree: The object's.
        voxels: (c,) numbers of its voxels among its own surface voxels; inner ones are not read.
        forest: The others.
        before: How many of the others' voxels come before its own.
    """
    n, k, others = len(tree.place), len(tree.leaves), len(forest.place)
    children, voxel = np.empty((n + others, 2), np.int32), np.empty(n + others, np.int32)
    place, leaf = np.empty(n + others, np.int32), np.empty(len(forest.leaf) + k, np.int32)
    own = voxels[tree.leaves] + before
    children[:k], voxel[k:n] = MISSING, MISSING
    children[k:n], voxel[:k], place[:n], leaf[own] = tree.children, own, tree.place, np.arange(k)
    children[n:], voxel[n:], place[n:] = forest.children, forest.voxel, forest.place
    children[n:] += n * (forest.children != MISSING)
    voxel[n:] += k * (forest.voxel >= before)
    leaf[:before], leaf[before + k :] = forest.leaf[:before] + n, forest.leaf[before:] + n
    return Forest(np.append(np.int32(0), forest.node_start + n), children, place, voxel, leaf)


@inlined
def _area(boxes: np.ndarray, node: int) -> float:
    """Returns the area of a node's box."""
    return (boxes[HIGH_X, node] - boxes[LOW_X, node]) * (boxes[HIGH_Y, node] - boxes[LOW_Y, node])


@inlined
def _opens_first(children: np.ndarray, boxes: np.ndarray, a: int, b: int) -> bool:
    """Returns whether the walk opens the first of two nodes that are not both leaves."""
    if children[a, 0] == MISSING or children[b, 0] == MISSING:
        return children[b, 0] == MISSING
    return not _area(boxes, a) < _area(boxes, b)


@kernel
def find_path(
    root_a: int, root_b: int, leaf_a: int, leaf_b: int, children: np.ndarray, place: np.ndarray, boxes: np.ndarray
) -> np.uint64:
    """Returns the walk's first 64 turns, from the pair of roots to that of leaves, as a uint64.

    The first turn is the highest bit; 0 is a first child and 1 a second.
    """
    a, b, bits, bit = root_a, root_b, np.uint64(0), _FIRST_BIT
    while (children[a, 0] != MISSING or children[b, 0] != MISSING) and bit != np.uint64(0):
        if _opens_first(children, boxes, a, b):
            turn = int(place[leaf_a] >= place[a])
            a = children[a, turn]
        else:
            turn = int(place[leaf_b] >= place[b])
            b = children[b, turn]
        if turn:
            bits |= bit
        bit >>= np.uint64(1)
    return bits


@inner
def _parts_first(
    root_a: int, root_b: int, one_a: int, one_b: int, two_a: int, two_b: int,
    children: np.ndarray, place: np.ndarray, boxes: np.ndarray,
) -> bool:  # fmt: skip
    """Returns whether the walk comes to the leaves `one` before it comes to `two`, which are others."""
    a, b = root_a, root_b
    while True:
        if _opens_first(children, boxes, a, b):
            one, two = int(place[one_a] >= place[a]), int(place[two_a] >= place[a])
            a = children[a, one]
        else:
            one, two = int(place[one_b] >= place[b]), int(place[two_b] >= place[b])
            b = children[b, one]
        if one != two:
            return one < two


@kernel
def add_keys(
    keys: np.ndarray,
    found: np.ndarray,
    n: int,
    contact: int,
    main: int,
    corner: int,
    ref: int,
    cell_object: np.ndarray,
    node_start: np.ndarray,
    children: np.ndarray,
    place: np.ndarray,
    leaf: np.ndarray,
    boxes: np.ndarray,
) -> int:
    """Adds the key of a contact, or its two keys within one object, where it acts twice.

    Args:
        keys: (capacity, 3) uint64, receives object pair, path and turn in row `n`, and perhaps the next.
        found: (capacity, 3) int32, receives the two leaves and `contact` in the same rows.
        n: Rows in use.
        contact: The caller's number of the contact.
        main: Surface voxel whose corner came in.
        corner: That corner, TL, TR, BL or BR.
        ref: Surface voxel that it came into.
        cell_object: (V,) objects of the surface voxels.
        node_start: See `Forest`, and so are the next three.
        children: (N, 2).
        place: (N,).
        leaf: (V,).
        boxes: (4, N) boxes of the nodes of both objects in this substep.

    Returns:
        The rows now in use.
    """
    turn = np.uint64(_TURN[corner])
    if cell_object[main] <= cell_object[ref]:
        n = _add_key(keys, found, n, contact, main, ref, turn, cell_object, node_start, children, place, leaf, boxes)
    if cell_object[main] >= cell_object[ref]:
        turn += np.uint64(_SECOND)
        n = _add_key(keys, found, n, contact, ref, main, turn, cell_object, node_start, children, place, leaf, boxes)
    return n


@inlined
def _add_key(keys, found, n, contact, first, second, turn, cell_object, node_start, children, place, leaf, boxes):  # type: ignore[no-untyped-def]
    """Adds the key of a contact that acts at the voxels `first` and `second` of the walk; returns the rows in use."""
    i, j, a, b = cell_object[first], cell_object[second], leaf[first], leaf[second]
    keys[n, PAIR] = np.uint64(i) << np.uint64(32) | np.uint64(j)
    keys[n, PATH] = find_path(node_start[i + 1] - 1, node_start[j + 1] - 1, a, b, children, place, boxes)
    keys[n, TURN] = turn
    found[n, FIRST_LEAF], found[n, SECOND_LEAF], found[n, CONTACT] = a, b, contact
    return n + 1


@inner
def comes_before(
    keys: np.ndarray, found: np.ndarray, one: int, two: int, node_start: np.ndarray, children: np.ndarray,
    place: np.ndarray, boxes: np.ndarray,
) -> bool:  # fmt: skip
    """Returns whether the key in row `one` comes before that in row `two`."""
    for part in (PAIR, PATH):
        if keys[one, part] != keys[two, part]:
            return keys[one, part] < keys[two, part]
    a, b, c, d = found[one, FIRST_LEAF], found[one, SECOND_LEAF], found[two, FIRST_LEAF], found[two, SECOND_LEAF]
    if a == c and b == d:
        return keys[one, TURN] < keys[two, TURN]
    # The paths part after more than 64 turns: deeper than any tree of the benchmark, but trees may be.
    i, j = np.int64(keys[one, PAIR] >> np.uint64(32)), np.int64(keys[one, PAIR] & np.uint64(0xFFFFFFFF))
    return _parts_first(node_start[i + 1] - 1, node_start[j + 1] - 1, a, b, c, d, children, place, boxes)


@kernel
def sort_keys(
    keys: np.ndarray, found: np.ndarray, n: int, order: np.ndarray, node_start: np.ndarray, children: np.ndarray,
    place: np.ndarray, boxes: np.ndarray,
) -> None:  # fmt: skip
    """Sets the first `n` of `order` to the rows in their order, by insertion: there are few."""
    for row in range(n):
        k = row
        while k > 0 and comes_before(keys, found, row, order[k - 1], node_start, children, place, boxes):
            order[k] = order[k - 1]
            k -= 1
        order[k] = row
