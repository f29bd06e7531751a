"""Drawings of robots and terrains: strokes, undo, text, words."""

import numpy as np
import pytest

from evogymcm import Body, robots
from evogymcm.sim import world_names
from evogymcm.studio import Drawing, Terrain
from evogymcm.studio.sketch import HISTORY

BIPED = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"
H, V, EMPTY, FIXED, RIGID = 3, 4, 0, 5, 1


@pytest.mark.parametrize("name", robots)
def test_text_goes_both_ways(name):
    drawing, other = Drawing.of(robots[name]), Drawing.blank()
    other.write(drawing.text.replace("/", "\n") + "\n")
    assert other.text == robots[name].text
    assert other.body() == robots[name]
    assert Drawing.from_record(drawing.record()).record() == drawing.record()


@pytest.mark.parametrize("text", ["", "HHX", "HH/H", "HHHHHHHHHHH", "/".join(["H"] * 11), "F", "3 3"])
def test_text_that_is_none_changes_nothing(text):
    drawing = Drawing.of(BIPED)
    with pytest.raises(ValueError, match=r"cells|size"):
        drawing.write(text)
    assert drawing.text == BIPED
    assert not drawing.can_undo


def test_problems_are_said_in_words_until_there_is_a_body():
    drawing = Drawing.blank(3, 3)
    assert "Nothing" in drawing.problem()
    drawing.paint(0, 0, RIGID)
    assert "actuator" in drawing.problem()
    drawing.paint(2, 2, H)
    assert "2 pieces" in drawing.problem()
    assert "actuator" not in drawing.problem()
    with pytest.raises(ValueError, match="one piece"):
        drawing.body()
    drawing.write("HRH/R.R/R.R")
    assert drawing.problem() is None
    assert drawing.body().n_actuators == 2
    assert drawing.summary() == "7 voxels, 2 actuators"


def test_undo_takes_back_fifty_changes_and_redo_brings_them_back():
    drawing = Drawing.blank(10, 10)
    texts = [drawing.text]
    for i in range(60):
        drawing.paint(i // 10, i % 10, H)
        texts.append(drawing.text)
        drawing.paint(i // 10, i % 10, H)  # changes nothing, and is no step
    for i in range(HISTORY):
        assert drawing.undo()
        assert drawing.text == texts[59 - i]
    assert not drawing.undo()
    assert drawing.redo()
    assert drawing.text == texts[11]
    drawing.clear()
    assert not drawing.can_redo
    assert not drawing.redo()


def test_a_stroke_is_one_step_with_its_stiffness():
    drawing = Drawing.of("HHH/V.V")
    drawing.begin()
    for col in range(3):
        drawing.paint_stiffness(0, col, 2.0)
    drawing.paint(1, 1, V)
    drawing.end()
    drawing.paint(1, 1, EMPTY)
    drawing.undo()
    drawing.undo()
    assert drawing.record() == {"body": "HHH/V.V", "stiffness": None}
    drawing.redo()
    assert drawing.record() == {"body": "HHH/VVV", "stiffness": "2,2,2/1,1,1"}
    drawing.begin()  # as of a tab that was closed within a stroke
    drawing.paint(0, 0, EMPTY)
    assert drawing.can_undo
    drawing.undo()
    assert drawing.text == "HHH/VVV"


def test_moving_mirroring_and_resizing_carry_the_stiffness():
    drawing = Drawing.blank(3, 4)
    drawing.write("..../HV../V...")
    drawing.paint_stiffness(1, 0, 2.0)
    drawing.shift(-5, 5)
    assert (drawing.text, drawing.stiffness[0, 2]) == ("..HV/..V./....", 2.0)  # as far as the edge
    drawing.mirror()
    assert (drawing.text, drawing.stiffness[0, 1]) == ("VH../.V../....", 2.0)
    drawing.mirror(upside_down=True)
    assert (drawing.text, drawing.stiffness[2, 1]) == ("..../.V../VH..", 2.0)
    drawing.resize(2, 3)
    assert (drawing.text, drawing.stiffness[1, 1]) == (".V./VH.", 2.0)
    drawing.resize(3, 3)
    assert drawing.text == ".../.V./VH."
    with pytest.raises(ValueError, match="11 rows"):
        drawing.resize(11, 3)
    drawing.fill(0, 0, H)
    assert drawing.text == "HHH/HVH/VHH"
    drawing.fill(2, 1, EMPTY)
    assert drawing.text == ".../.V./V.."


def test_stiffness_is_painted_filled_written_and_graded():
    drawing = Drawing.of("HHHHH/V...V")
    drawing.paint_stiffness(1, 1, 2.0)  # there is no voxel
    assert not drawing.has_stiffness
    drawing.gradient((0, 0), (0, 4), 0.5, 2.0)
    assert drawing.stiffness_text == "0.5,0.707,1,1.414,2/0.5,1,1,1,2"
    drawing.write_stiffness(drawing.stiffness_text)
    assert drawing.stiffness_text == "0.5,0.707,1,1.414,2/0.5,1,1,1,2"
    drawing.gradient((0, 0), (0, 0), 0.7, 2.0)
    assert set(drawing.stiffness[drawing.occupancy]) == {0.7}
    drawing.write_stiffness("1.5")
    drawing.paint(0, 2, EMPTY)
    drawing.fill_stiffness(0, 0, 0.5)
    assert drawing.stiffness_text == "0.5,0.5,1,1.5,1.5/0.5,1,1,1,1.5"
    for text in ("3", "x", "1,1/1,1", "nan", ""):
        with pytest.raises(ValueError, match="stiffness"):
            drawing.write_stiffness(text)
    with pytest.raises(ValueError, match=r"0\.5 to 2"):
        drawing.paint_stiffness(0, 0, 2.1)
    with pytest.raises(ValueError, match="row 7"):
        drawing.paint(7, 0, H)


def test_random_and_mutated_bodies_are_bodies():
    drawing, rng = Drawing.blank(4, 3), np.random.default_rng(0)
    drawing.randomize(rng)
    assert drawing.body().shape == (4, 3)
    drawing.write_stiffness("2")
    before = drawing.grid
    assert drawing.mutate(rng)
    assert drawing.body().shape == (4, 3)
    assert (drawing.grid != before).any()
    assert set(drawing.stiffness[(before != 0) & (drawing.grid != 0)]) == {2.0}
    with pytest.raises(ValueError, match="1 of its joints"):
        Drawing.of(Body("HH/HH", [[0, 0, 1], [1, 2, 3]]))


def test_terrain_is_a_world_to_walk_in():
    terrain = Terrain.flat()
    for col in (20, 21):
        terrain.paint(9, col, RIGID)
    terrain.fill(0, 0, EMPTY)
    world = terrain.world()
    assert [obj.name for obj in world.objects] == ["ground", "block_1"]
    assert world["block_1"].origin == (20, 2)
    assert terrain.task(5, 5).goal_x == pytest.approx(3.9)
    assert Terrain.of(world).grid[-4:].tolist() == terrain.grid[-4:].tolist()
    assert terrain.problem(5, 5) is None
    terrain.fill(11, 0, EMPTY)
    assert "ground" in terrain.problem(5, 5)
    for code in (H, V, 9):
        with pytest.raises(ValueError, match="cell code"):
            terrain.paint(0, 0, code)
    rows = "\n".join(["H" * 10] * 4)
    for make in (terrain.write, lambda text: Terrain(np.full((4, 10), V))):
        with pytest.raises(ValueError, match="robots"):
            make(rows)


def test_most_worlds_of_the_package_are_a_start():
    usable = 0
    for name in world_names():
        try:
            usable += Terrain.of(name).problem(5, 5) is None
        except ValueError as error:
            if "size" not in str(error):  # some are higher
                raise
    assert usable >= 24
