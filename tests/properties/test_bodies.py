"""Bodies: what is written can be read back, what is no body is refused with a ValueError."""

import io
import json
import pickle
import zipfile

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from evogymcm.algos.codesign import Design, Individual, mutate_design
from evogymcm.body import Body, as_body, check_stiffness, full_connections, is_connected, mutate_body, sample_body
from evogymcm.envs.dealing import as_bodies, check_grid_shape
from evogymcm.sim.world import World, WorldObject
from tests.properties.strategies import JSON, JUNK, SEEDS, bodies, fields, grids, tried


def pieces(grid):
    """How many pieces the voxels of a grid are, counted one voxel after another."""
    left, count = {tuple(cell) for cell in np.argwhere(grid)}, 0
    while left:
        count, reached = count + 1, [left.pop()]
        while reached:
            row, column = reached.pop()
            for cell in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
                if cell in left:
                    left.remove(cell)
                    reached.append(cell)
    return count


@given(grids(7, range(5)))
def test_a_grid_is_connected_if_it_is_one_piece(grid):
    assert is_connected(grid) == (pieces(grid) == 1)
    joined = {tuple(pair) for pair in full_connections(grid).T.tolist()}
    cells = np.argwhere(grid).tolist()
    near = {
        (a[0] * grid.shape[1] + a[1], b[0] * grid.shape[1] + b[1])
        for a in cells
        for b in cells
        if b in ([a[0], a[1] + 1], [a[0] + 1, a[1]])
    }
    assert joined == near


@given(bodies(), st.data())
def test_a_body_comes_back_from_all_its_forms(body, data):
    order = data.draw(st.permutations(range(body.connections.shape[1])))
    turned = body.connections[::-1, list(order)]
    assert Body(body.grid, turned) == Body(body.grid.tolist(), np.repeat(turned, 2, axis=1)) == body
    assert pickle.loads(pickle.dumps(body)) == body
    assert hash(Body(body.grid.astype(float), turned)) == hash(body)
    plain = Body(body.grid)
    digits = "/".join("".join(map(str, row)) for row in body.grid.tolist())
    for form in (body.text, body.text.split("/"), digits, body.text.replace("/", "\n"), body.grid.astype(object)):
        assert Body(form) == plain, form
    assert as_bodies([body, body.grid]) == [body, plain]


@given(bodies(), st.data())
def test_a_body_comes_back_from_its_files(tmp_path_factory, body, data):
    folder = tmp_path_factory.mktemp("bodies")
    np.savez(folder / "body.npz", body.grid, body.connections)
    np.save(folder / "body.npy", body.grid)
    (folder / "cells.txt").write_text(body.text.replace("/", "\n"))
    separator = data.draw(st.sampled_from([" ", ",", ", ", ";", "\t"]))
    (folder / "codes.txt").write_text("\n".join(separator.join(map(str, row)) for row in body.grid.tolist()))
    world = World(1, 1).place(
        WorldObject("robot", body.grid, data.draw(st.sampled_from([(0, 0), (3, 2)])), body.connections)
    )
    (folder / "body.json").write_text(json.dumps(world.to_design_tool()))
    plain = Body(body.grid)
    assert as_body(folder / "body.npz") == body
    assert as_body(str(folder / "body.npy")) == plain
    assert as_body(folder / "cells.txt") == plain
    assert as_body(folder / "codes.txt") == plain
    seen = as_body(folder / "body.json")  # cropped to its voxels
    filled = body.grid[np.ix_(body.grid.any(1), body.grid.any(0))]
    assert np.array_equal(seen.grid, filled)
    assert seen.connections.shape == body.connections.shape


@given(JUNK)
def test_what_is_no_body_is_refused(junk):
    for read in (Body, as_body, as_bodies, lambda junk: Body("HH/HH", junk), lambda junk: as_bodies([junk, "HH"])):
        tried(read, junk)
    for check in (lambda junk: check_stiffness(junk, Body("HH")), check_grid_shape):
        tried(check, junk)


@given(st.binary(max_size=300), st.text(max_size=30), JSON, JUNK)
def test_a_file_that_is_no_body_is_refused(tmp_path_factory, data, text, content, junk):
    folder = tmp_path_factory.mktemp("bodies")
    (folder / "body.npz").write_bytes(data)
    (folder / "body.npy").write_bytes(data)
    (folder / "bytes.txt").write_bytes(data)
    (folder / "body.txt").write_text(text, encoding="utf-8")
    (folder / "body.json").write_text(json.dumps(content))
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        archive.writestr("arr_0.npy", data)
    (folder / "whole.npz").write_bytes(whole.getvalue())
    for path in folder.iterdir():
        tried(as_body, path)


@given(bodies(), SEEDS, st.floats(0, 1), st.integers(1, 5))
def test_mutants_are_bodies_of_the_same_shape(body, seed, rate, attempts):
    rng = np.random.default_rng(seed)
    mutant = mutate_body(body, rng, rate, attempts)
    if mutant is not None:
        assert mutant.shape == body.shape
        assert mutant.has_default_connections
    assert mutate_body(body, seed, rate, attempts) == mutant
    assert mutate_body(body, seed, 0.0, attempts) == Body(body.grid)
    assert sample_body(body.shape, seed).shape == body.shape


@given(bodies(), st.data(), SEEDS)
def test_designs_come_back_from_their_records_and_children_keep_what_stays(body, data, seed):
    field = data.draw(fields(body))
    design = Design(body, field)
    individual = Individual(3, design, 1, 2, 0.5)
    assert Individual.from_record(json.loads(json.dumps(individual.record()))) == individual
    child = mutate_design(design, np.random.default_rng(seed), 0.3)
    if child is not None:
        same = (child.body.grid == body.grid) & child.body.occupancy
        assert np.array_equal(child.field[same], design.field[same])
        assert (child.field[~same] == 1.0).all()
