"""Designs: bodies with their stiffness, their records and their mutation."""

import json

import numpy as np
import pytest

from evogymcm.algos.codesign import Design, Individual, mutate_design
from evogymcm.body import Body, mutate_body, sample_body

SHAPE = (5, 5)


def test_one_stiffness_takes_the_place_of_a_designs_own():
    design = Design(Body("HR/.R"), [[0.5, 2.0], [1.0, 1.5]])
    assert design.at(1.0) is design
    np.testing.assert_array_equal(design.at(0.7).field, [[0.7, 0.7], [1.0, 0.7]])


def test_designs_are_checked_and_read_only():
    body = Body("HR/.R")
    design = Design(body, [[0.5, 2.0], [9.0, 1.0]])
    np.testing.assert_array_equal(design.stiffness, [[0.5, 2.0], [1.0, 1.0]])
    with pytest.raises(ValueError, match="read-only"):
        design.stiffness[0, 0] = 1.0
    with pytest.raises(ValueError, match="stiffness"):
        Design(body, np.full((2, 2), 3.0))
    np.testing.assert_array_equal(Design(body).field, np.ones((2, 2)))


def test_the_key_is_the_bodys_codes_alone():
    body = Body("HR/.R")
    assert Design(body).key == Design(body, np.full((2, 2), 2.0)).key == "3101"
    assert Design(Body("VR/.R")).key == "4101"
    assert Design(body) == Design(body, np.ones((2, 2)))
    assert Design(body) != Design(body, np.full((2, 2), 2.0))
    assert Design(body) != body
    assert hash(Design(body)) == hash(Design(body, np.ones((2, 2))))


@pytest.mark.parametrize("stiffness", [None, [[0.7, 1.0 / 3.0 + 0.5], [1.0, 1.0]]])
@pytest.mark.parametrize("connections", [None, [[0], [1]]])
def test_records_come_back_as_they_were(stiffness, connections):
    design = Design(Body("HR/RR", connections), stiffness)
    individual = Individual(3, design, parent=1, generation=2, fitness=0.1 + 0.2)
    assert Individual.from_record(json.loads(json.dumps(individual.record(), allow_nan=False))) == individual


def test_children_inherit_stiffness_where_a_cell_kept_its_type():
    rng = np.random.default_rng(0)
    changed = kept = 0
    for _ in range(100):
        parent = Design(sample_body(SHAPE, rng), rng.uniform(0.5, 2.0, SHAPE))
        child = mutate_design(parent, rng)
        if child is None:
            continue
        for cell in np.ndindex(SHAPE):
            if child.body.grid[cell] == parent.body.grid[cell]:
                assert child.stiffness[cell] == parent.stiffness[cell]
                kept += child.body.grid[cell] != 0
            else:
                assert child.stiffness[cell] == 1.0
                changed += 1
    assert changed > 100
    assert kept > 100


def test_mutation_draws_like_that_of_bodies():
    parent = Design(Body("HHH/HHH/HHH"))
    bodies = [mutate_body(parent.body, np.random.default_rng(seed), 0.3, 2) for seed in range(20)]
    designs = [mutate_design(parent, np.random.default_rng(seed), 0.3, 2) for seed in range(20)]
    assert [design and design.body for design in designs] == bodies
    assert all(design is None or design.stiffness is None for design in designs)
