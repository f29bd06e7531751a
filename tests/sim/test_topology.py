"""Points, edges, surfaces and constants of small grids, worked out by hand."""

from dataclasses import fields
from itertools import product
from weakref import ref

import numpy as np
import pytest

from evogymcm._grid import full_connections
from evogymcm.body import sample_body
from evogymcm.sim.constants import DIAGONAL_CONSTANT, EDGE_CONSTANT, H_ACT, MISSING, RIGID, SOFT, V_ACT
from evogymcm.sim.object_springs import object_springs
from evogymcm.sim.scene import EDGE_RULES
from evogymcm.sim.topology import CACHED, topology
from evogymcm.sim.world import World
from tests.sim.tools import grid_of
from tests.sim.topology_twin import slow_points, slow_springs, slow_topology


def build(text, connections=None):
    return topology(grid_of(text), None if connections is None else np.array(connections).T)


def ends(pairs):
    """Edges as sets: which end is first carries no physics."""
    return [frozenset(pair) for pair in np.asarray(pairs).tolist()]


def shape_of(t):
    """The bodies' structure as sets of coordinates, whatever the numbering: edges with constants."""
    xy = np.round(t.points(0, 0) * 10).astype(int).tolist()
    return {
        (frozenset(tuple(xy[p]) for p in edge), constant)
        for edge, constant in zip(t.edges.tolist(), t.edge_constants.tolist(), strict=True)
    }


def mirrored(structure, width):
    return {(frozenset((width - x, y) for x, y in edge), constant) for edge, constant in structure}


def test_one_voxel():
    t = build("S")
    assert t.corner_points.tolist() == [[0, 1, 2, 3]]  # TL, TR, BL, BR
    np.testing.assert_array_equal(t.points(0, 0), [[0, 0.1], [0.1, 0.1], [0, 0], [0.1, 0]])
    assert ends(t.edges) == ends([(0, 1), (2, 3), (0, 2), (1, 3)])  # top, bottom, left, right
    assert t.sides.tolist() == [[0, 3, 1, 2]]  # top, right, bottom, left
    assert t.diagonals.tolist() == [[1, 2], [0, 3]]
    assert t.is_surface_side.all()
    assert not t.is_fixed.any()


def test_two_joined_voxels_share_a_side():
    t = build("HS")
    assert t.corner_points.tolist() == [[0, 1, 2, 3], [1, 4, 3, 5]]
    assert ends(t.edges) == ends([(0, 1), (2, 3), (0, 2), (1, 3), (1, 4), (3, 5), (4, 5)])
    assert t.sides.tolist() == [[0, 3, 1, 2], [4, 6, 5, 3]]
    assert t.is_surface_side.tolist() == [[True, False, True, True], [True, True, True, False]]
    assert t.edge_owners.tolist() == [[0, MISSING]] * 3 + [[0, 1]] + [[1, MISSING]] * 3


def test_two_voxels_above_each_other_share_a_side():
    t = build("H/S")
    assert t.corner_points.tolist() == [[0, 1, 2, 3], [2, 3, 4, 5]]
    assert ends(t.edges) == ends([(0, 1), (2, 3), (0, 2), (1, 3), (4, 5), (2, 4), (3, 5)])
    assert t.sides.tolist() == [[0, 3, 1, 2], [1, 6, 4, 5]]


def test_unjoined_neighbours_share_nothing():
    t = build("SS", connections=np.zeros((0, 2), int))
    assert t.corner_points.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert len(t.edges) == 8
    assert t.is_surface_side.all()
    np.testing.assert_array_equal(t.points(0, 0)[1], t.points(0, 0)[4])  # at one place all the same


def test_voxels_that_touch_at_a_corner_share_it_only_where_linked_round_it():
    assert build("S./.S").n_points == 8
    linked = build("SS/.S")
    assert linked.corner_points.tolist() == [[0, 1, 2, 3], [1, 4, 3, 5], [3, 5, 6, 7]]
    # Here they are connected too, but the long way round: two points at the place where they touch.
    ring = build("SSS/S.S/.SS")
    assert ring.n_points == 16
    assert len(np.unique(ring.points(0, 0).round(6), axis=0)) == 15


def test_a_square_with_one_unjoined_side():
    """A B over C D, all joined but A and B: of a corner's owners the one across it comes first, then left, then top."""
    t = build("SS/SS", connections=[(0, 2), (1, 3), (2, 3)])
    assert t.corner_points.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7], [2, 6, 8, 9], [3, 7, 9, 10]]
    assert ends(t.edges) == ends([
        (0, 1), (2, 3), (0, 2), (1, 3),
        (4, 5), (6, 7), (4, 6), (5, 7),
        (8, 9), (2, 8), (6, 9),
        (9, 10), (7, 10),
    ])  # fmt: skip
    assert t.sides.tolist() == [[0, 3, 1, 2], [4, 7, 5, 6], [1, 10, 8, 9], [5, 12, 11, 10]]  # C's top is A's bottom
    assert t.is_surface_side.sum(1).tolist() == [3, 3, 2, 2]


def test_a_full_square_has_an_inner_voxel():
    t = build("SSS/SSS/SSS")
    assert (t.n_points, len(t.edges), len(t.diagonals)) == (16, 24, 18)
    assert t.is_surface_side.sum(1).tolist() == [2, 1, 2, 1, 0, 1, 2, 1, 2]


@pytest.mark.parametrize(
    ("text", "shared"),
    [("RR", RIGID), ("RS", SOFT), ("SR", SOFT), ("HS", SOFT), ("SH", H_ACT), ("RV", V_ACT), ("VR", V_ACT)],
)
def test_the_last_soft_or_actuator_voxel_decides_a_shared_edge(text, shared):
    t = build(text)
    assert t.edge_constants[t.sides[0, 1]] == EDGE_CONSTANT[shared]
    vertical = build("/".join(text))
    assert vertical.edge_constants[vertical.sides[0, 2]] == EDGE_CONSTANT[shared]


def test_constants():
    t = build("RSHV")
    own = [3e8 / 3.5, 3e8 / 6, 3e8 / 5, 3e8 / 5]
    np.testing.assert_allclose(t.edge_constants[t.sides[:, 0]], own, rtol=1e-15)
    diagonals = np.repeat([3e8 / 7, 3e8 / 24, 3e8 / 10, 3e8 / 10], 2)
    np.testing.assert_allclose(t.diagonal_constants(), diagonals, rtol=1e-15)
    assert DIAGONAL_CONSTANT[H_ACT] == DIAGONAL_CONSTANT[V_ACT]
    assert t.owner_constants()[t.sides[0, 1]].tolist() == EDGE_CONSTANT[[RIGID, SOFT]].tolist()
    assert t.owner_constants()[t.sides[0, 0]].tolist() == [EDGE_CONSTANT[RIGID], 0.0]


def test_a_mirrored_body_is_another_body_where_materials_differ():
    assert mirrored(shape_of(build("HH/H.")), 2) == shape_of(build("HH/.H"))
    assert mirrored(shape_of(build("HS")), 2) != shape_of(build("SH"))
    assert mirrored(shape_of(build("RS")), 2) == shape_of(build("SR"))


def test_corners_of_fixed_voxels_are_fixed_also_where_shared():
    t = build("FSS")
    assert t.is_fixed[t.corner_points[0]].all()
    assert t.is_fixed.sum() == 4


def test_actuators_drive_their_own_two_edges():
    t = build("HV/HS")
    sides = t.sides
    assert t.edge_drivers[sides[0, 0]].tolist() == [0, MISSING]
    assert t.edge_drivers[sides[0, 2]].tolist() == [0, 2]  # between two horizontal actuators: the mean of both
    assert t.edge_drivers[sides[0, 1]].tolist() == [1, MISSING]  # the vertical one's left edge
    assert t.edge_drivers[sides[0, 3]].tolist() == [MISSING, MISSING]
    assert t.edge_drivers[sides[3, 0]].tolist() == [MISSING, MISSING]


def test_coordinates_are_formed_as_the_original_forms_them():
    """Robots start corner on corner with the terrain: the last bit decides which contacts exist at the start."""
    t = build("SSS/S.S")
    x, y = t.points(7, 3).T
    rows, columns = t.made_at[:, 0] + (t.made_at[:, 2] >= 2), t.made_at[:, 1] + t.made_at[:, 2] % 2
    assert x.tolist() == [7 * 0.1 + c * 0.1 for c in columns.tolist()]
    assert y.tolist() == [(3 * 0.1 + 2 * 0.1) - r * 0.1 for r in rows.tolist()]


def test_equal_grids_share_one_topology_that_nobody_can_change():
    assert build("HS/SH") is build("HS/SH")
    assert build("HS/SH") is not build("HS/HS")
    with pytest.raises(ValueError, match="read-only"):
        build("HS/SH").edges[0] = 0


def some_objects():
    """Grids and connections: bodies, terrains, holes, unjoined and fixed voxels, and pairs that join nothing."""
    rng = np.random.default_rng(0)
    yield grid_of("F"), None
    yield np.zeros((2, 3), np.int8), None
    for shape in ((5, 5), (10, 10)):
        for _ in range(5):
            body = sample_body(shape, rng, (0.2, 1, 1, 1, 1))
            yield body.grid, body.connections
    for name in ("Walker-v0", "CaveCrawler-v0", "BridgeWalker-v0"):
        for obj in World.load(name).objects:
            yield obj.grid, obj.connections
    for i in range(200):
        grid = rng.choice(6, rng.integers(1, 7, 2), p=[0.25, 0.15, 0.15, 0.15, 0.15, 0.15]).astype(np.int8)
        full = full_connections(grid)
        some = full[:, rng.random(full.shape[1]) < 0.7]
        wild = rng.integers(-2, grid.size + 2, (2, 9))
        yield grid, (None, full, some, np.concatenate([some[::-1], some, wild], axis=1))[i % 4]


def assert_same(array, expected):
    assert (array.dtype, array.shape) == (expected.dtype, expected.shape)
    np.testing.assert_array_equal(array, expected)


def test_topologies_and_springs_are_their_slow_twins():
    for grid, connections in some_objects():
        t, expected = topology(grid, connections), slow_topology(grid, connections)
        arrays = {f.name: getattr(t, f.name) for f in fields(t) if f.type is np.ndarray}
        assert len(arrays) == 12
        assert (t.rows, t.columns) == grid.shape
        for name, array in arrays.items():
            assert_same(array, getattr(expected, name))
        assert_same(t.points(7, 3), slow_points(expected, 7, 3))
        for with_fixed, rule in product((True, False), EDGE_RULES):
            springs, wanted = object_springs(t, rule, with_fixed), slow_springs(expected, rule, with_fixed)
            assert set(springs._fields) == set(wanted)
            for name, values in wanted.items():
                assert_same(getattr(springs, name), values.astype(np.int32) if values.dtype == np.int64 else values)
        assert all(a.flags.c_contiguous and not a.flags.writeable for a in (*arrays.values(), *springs))


def test_what_is_no_voxel_is_refused():
    for code in (-1, 6):
        with pytest.raises(ValueError, match=rf"cell codes .*{code}.* allowed are 0 to 5"):
            topology(np.array([[3, code]]))


def test_a_long_stream_of_bodies_is_not_kept_in_memory():
    first = topology(np.full((1, 1), H_ACT))
    gone = [ref(first), ref(object_springs(first).ends)]
    del first
    for i in range(CACHED):
        object_springs(topology(1 + np.array([[i // 256, i // 64 % 4, i // 16 % 4, i // 4 % 4, i % 4]])))
    assert [r() for r in gone] == [None, None]
