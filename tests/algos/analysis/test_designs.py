"""Shapes of bodies and stiffness fields, worked out by hand on drawn bodies."""

import numpy as np
import pytest

from evogymcm import Body
from evogymcm.algos.analysis import Shape, bootstrap, mean_stiffness, measure_shape, stiffness_contrast
from evogymcm.algos.codesign.design import Design


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("HHHHH/HHHHH/HH.HH/VV.VV/VV.VV", Shape(22, 5, 5, legs=2, leg_width=2, leg_length=3)),  # up to where they meet
        ("HHH/HHH", Shape(6, 3, 2, legs=1, leg_width=3, leg_length=2)),  # a block is one leg
        ("HHHHH/.H.../.H...", Shape(7, 5, 3, legs=1, leg_width=1, leg_length=2)),  # up to what is wider
        ("HHHH/.H../HHH.", Shape(8, 4, 3, legs=1, leg_width=2, leg_length=2)),  # a wide foot counts as one of its rows
        ("HHHH/H..H/HS.V", Shape(9, 4, 3, legs=2, leg_width=(1.5 + 1) / 2, leg_length=2)),
        ("..HHH/HHH.H", Shape(7, 5, 2, legs=2, leg_width=2, leg_length=1)),  # where they meet both end
        ("H.H/HHH/H..", Shape(6, 3, 3, legs=1, leg_width=1, leg_length=1)),  # only the lowest row touches the ground
        (".H.H/.HHH/..../....", Shape(5, 3, 2, legs=1, leg_width=3, leg_length=1)),  # two parts stand on the foot
        ("..H/HHH/.../...", Shape(4, 3, 2, legs=1, leg_width=2, leg_length=2)),
    ],
)  # fmt: skip
def test_shapes_of_drawn_bodies(text, expected):
    assert measure_shape(Body(text)) == expected


def test_voxels_side_by_side_that_are_not_joined_are_two_legs():
    assert measure_shape(Body("HH/HH")).legs == 1
    assert measure_shape(Body("HH/HH", [[0, 0, 1], [1, 2, 3]])) == Shape(4, 2, 2, legs=2, leg_width=1, leg_length=1)


def test_the_mean_field_counts_designs_where_they_have_a_voxel():
    fields = [[1, 2], [0.5, 1]], [[2, 1], [1, 1]], [[1.2, 1], [0.6, 2]]
    bodies = "HH/HH", "HH/H.", "H./HH"
    designs = [Design(Body(body), field) for body, field in zip(bodies, fields, strict=True)]
    found = mean_stiffness(designs)
    assert found.count.tolist() == [[3, 2], [3, 2]]
    np.testing.assert_allclose(found.mean, [[2.4 ** (1 / 3), np.nan], [0.3 ** (1 / 3), np.nan]])
    assert np.log([found.low[0, 0], found.high[0, 0]]) == pytest.approx(bootstrap(np.log([1, 2, 1.2])))
    assert np.isnan([found.low[0, 1], found.high[1, 1]]).all()
    two = mean_stiffness(designs, least=2).mean
    np.testing.assert_allclose(two[:, 1], [2**0.5, 2**0.5])
    alone = mean_stiffness(designs[1:2], least=1, with_intervals=False)
    np.testing.assert_allclose(alone.mean, [[2, 1], [1, np.nan]])
    assert (alone.low, alone.high) == (None, None)
    with pytest.raises(ValueError, match=r"2 of shapes \[\(1, 2\), \(2, 2\)\]"):
        mean_stiffness([designs[0], Design(Body("HH"))])
    with pytest.raises(ValueError, match="0 of shapes"):
        mean_stiffness([])
    with pytest.raises(ValueError, match="least: got 1"):
        mean_stiffness(designs, least=1)


@pytest.mark.parametrize(
    ("text", "field", "centre", "base"),  # in powers of 2
    [
        ("HHH/HHH/HHH", [[1, 1, 1], [1, 0.5, 1], [2, 2, 2]], -1 - 3 / 8, 1 + 1 / 6),
        ("..../HHHH/HHHH/....", [[1] * 4, [1, 2, 1, 1], [1, 2, 2, 2], [1] * 4], 3 / 4 - 1 / 4, 3 / 4 - 1 / 4),
        ("HHH/H.H/HHH", [[1, 1, 1], [1, 1, 1], [2, 2, 2]], None, 1.0),
        ("HHH", [[1, 2, 1]], 1.0, None),
    ],
)  # fmt: skip
def test_contrasts_of_centre_and_base(text, field, centre, base):
    design = Design(Body(text), field)
    for region, expected in (("centre", centre), ("base", base)):
        found = stiffness_contrast(design, region)
        assert found == (None if expected is None else pytest.approx(expected * np.log(2)))
    with pytest.raises(ValueError, match="'top', allowed are centre, base"):
        stiffness_contrast(design, "top")
