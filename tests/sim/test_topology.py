"""Points, edges, surfaces and constants of small grids, worked out by hand."""

import numpy as np
import pytest

from evogymcm.sim.constants import DIAGONAL_CONSTANT, EDGE_CONSTANT, H_ACT, MISSING, RIGID, SOFT, V_ACT
from evogymcm.sim.topology import topology
from tests.sim.tools import grid_of


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
