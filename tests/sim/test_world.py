"""Worlds: pictures, the Design Tool's JSON, placing, and the worlds that come with the package."""

import json
import zlib

import numpy as np
import pytest

from evogymcm._grid import full_connections
from evogymcm.sim.world import World, WorldObject, load_prefab, prefab_names, world_names

# Width, height, objects, voxels, and the CRC-32 of the whole picture, of each world as compared cell by cell with
# EvoGym's own file.
WORLDS = {
    "Balancer-v0": (30, 5, 1, 40, 0xF80C2753),
    "Balancer-v1": (30, 5, 1, 41, 0x8C02C416),
    "BeamSlider-v0": (70, 7, 7, 107, 0x1314BB0F),
    "BeamToppler-v0": (70, 7, 4, 100, 0x78C745BC),
    "BidirectionalWalker-v0": (70, 1, 1, 70, 0x1EFBD2DB),
    "BridgeWalker-v0": (60, 5, 1, 196, 0x8D89E619),
    "Carrier-v0": (100, 8, 2, 106, 0x23F0A794),
    "Carrier-v1": (60, 12, 2, 74, 0x3EFC7FE0),
    "Catcher-v0": (100, 50, 4, 116, 0x4C5883A4),
    "CaveCrawler-v0": (70, 14, 1, 188, 0x4E39F95C),
    "Climber-v0": (7, 90, 1, 190, 0x0F4AFF5E),
    "Climber-v1": (7, 70, 1, 150, 0x1BBBA635),
    "Climber-v2": (27, 42, 1, 134, 0x33849213),
    "DownStepper-v0": (75, 10, 1, 84, 0xBF6CD9FB),
    "Flipper-v0": (70, 1, 1, 70, 0x1EFBD2DB),
    "GapJumper-v0": (80, 6, 5, 60, 0x54D49436),
    "Hurdler-v0": (70, 6, 1, 88, 0xABBA462E),
    "Jumper-v0": (60, 8, 1, 74, 0x7F9C6CAE),
    "Lifter-v0": (11, 5, 2, 21, 0x41ECBA96),
    "ObstacleTraverser-v0": (80, 3, 1, 107, 0x16F67B76),
    "ObstacleTraverser-v1": (60, 10, 1, 195, 0xBE6F6A9A),
    "PlatformJumper-v0": (91, 9, 7, 80, 0x22C6BDE8),
    "Pusher-v0": (100, 3, 2, 106, 0xB43C06BD),
    "Pusher-v1": (100, 3, 2, 106, 0x7D20CF8A),
    "ShapeChange": (20, 10, 1, 56, 0x07BE0290),
    "Thrower-v0": (70, 10, 2, 116, 0xFD7FE1A4),
    "Traverser-v0": (60, 9, 28, 229, 0xA0A9E57E),
    "UpStepper-v0": (70, 9, 1, 78, 0x6501F567),
    "Walker-v0": (100, 1, 1, 100, 0x4148595F),
    "cave": (50, 10, 1, 114, 0xC5D4A401),
    "hole": (20, 10, 2, 32, 0xF2BD4D9C),
}

PICTURE = """
# A box with a loose block in it.
size 8 4
object box at 0 0
F....F
FFFFFF

object block at 2 1 is rigid_2x2
"""


@pytest.fixture
def world():
    return World.from_picture(PICTURE)


def test_picture(world):
    assert (world.width, world.height) == (8, 4)
    assert [obj.name for obj in world.objects] == ["box", "block"]
    assert world["box"].grid.tolist() == [[5, 0, 0, 0, 0, 5], [5] * 6]
    assert world["block"] == WorldObject("block", [[1, 1], [1, 1]], (2, 1))
    with pytest.raises(KeyError, match="box, block"):
        world["peg"]


def test_picture_without_headers():
    assert World.from_picture("F..S\nFFFF") == World(4, 2, (WorldObject("ground", [[5, 0, 0, 2], [5] * 4], (0, 0)),))
    assert World.from_picture("F", name="floor")["floor"].shape == (1, 1)


def test_picture_without_size_fits_its_objects():
    world = World.from_picture("object low at 0 0\nFFF\nobject high at 5 2\nR\nR")
    assert (world.width, world.height) == (6, 4)


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        ("", "no cells"),
        ("size 3\nFFF", "size WIDTH HEIGHT"),
        ("object box at 0\nFFF", "object NAME at X Y"),
        ("object box at 0 0", "with 0 rows"),
        ("object box at 0 0 is rigid_1x1\nFFF", "with 1 rows"),
        ("object box at 0 0 is rigid", "rigid_1x1"),
        ("object box at -1 0\nFFF", "counted from 0"),
        ("FXF", "allowed characters"),
        ("FFF\nFF", "lengths"),
        ("...", "no voxel"),
        ("size 2 1\nFFF", "outside the 2 x 1 world"),
        ("object a at 0 0\nFF\nobject a at 2 0\nFF", "already"),
        ("object a at 0 0\nFF\nobject b at 1 0\nFF", "must be free, but 'a'"),
    ],
)
def test_unreadable_pictures_are_refused(picture, message):
    with pytest.raises(ValueError, match=message):
        World.from_picture(picture)


def test_a_rectangle_must_be_free_only_when_it_is_added(world):
    box, block = world.objects
    with pytest.raises(ValueError, match="'box': its bounding rectangle"):
        World(8, 4, (block, box))


def test_place_grows_the_world_and_leaves_the_old_one(world):
    grown = world.place(WorldObject("robot", [[3, 0], [3, 3]], (7, 9)))
    assert (grown.width, grown.height) == (9, 11)
    assert len(world.objects) == 2
    with pytest.raises(ValueError, match="must be free, but 'block'"):
        world.place(WorldObject("robot", [[0, 3], [0, 3]], (3, 2)))  # only its empty cells meet the block


def test_simulation_order():
    world = World(9, 1)
    for x, name in enumerate(["block_2", "zebra", "robot", "block_10", "Alpha"]):
        world = world.place(WorldObject(name, [[3]], (x, 0)))
    assert [obj.name for obj in world.simulation_order()] == ["robot", "Alpha", "block_10", "block_2", "zebra"]


def test_objects_are_immutable_values():
    grid = np.array([[1.0, 3.0]])
    obj = WorldObject("robot", grid, (np.int64(1), 2))
    grid[:] = 0
    assert obj.grid.dtype == np.int8
    assert obj.grid.tolist() == [[1, 3]]
    assert obj.origin == (1, 2)
    with pytest.raises(ValueError, match="read-only"):
        obj.grid[0, 0] = 2
    assert obj == WorldObject("robot", [[1, 3]], (1, 2), full_connections([[1, 3]]))
    assert obj != WorldObject("robot", [[1, 3]], (1, 2), np.empty((2, 0), dtype=int))
    assert len({obj, WorldObject("robot", [[1, 3]], (1, 2)), WorldObject("robot", [[1, 3]], (1, 3))}) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("", [[1]], (0, 0)), "name"),
        (("a", [[6]], (0, 0)), "codes"),
        (("a", [[0]], (0, 0)), "no voxel"),
        (("a", [[1]], (0, -1)), "counted from 0"),
        (("a", [[1, 1]], (0, 0), [[0], [2]]), "connections"),
    ],
)
def test_invalid_objects_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        WorldObject(*arguments)


def test_pictures_do_not_hide_connections(world):
    apart = world.place(WorldObject("pair", [[1, 1]], (0, 3), np.empty((2, 0), dtype=int)))
    with pytest.raises(ValueError, match="to_design_tool"):
        apart.to_picture()
    assert World.from_design_tool(apart.to_design_tool()) == apart


def test_design_tool_file(tmp_path):
    # An L of three rigid voxels whose upper one is not joined, and a fixed floor.
    content = {
        "grid_width": 4,
        "grid_height": 3,
        "objects": {
            "floor": {"indices": [0, 1], "types": [5, 5], "neighbors": {"0": [1], "1": [0]}},
            "L": {"indices": [6, 7, 10], "types": [1, 2, 3], "neighbors": {"6": [7], "7": [6], "10": []}},
        },
    }
    path = tmp_path / "world.json"
    path.write_text(json.dumps(content))
    world = World.from_design_tool(path)
    assert world == World.from_design_tool(content)
    assert world["floor"] == WorldObject("floor", [[5, 5]], (0, 0))
    assert world["L"] == WorldObject("L", [[3, 0], [1, 2]], (2, 1), [[2], [3]])
    assert World.from_design_tool(world.to_design_tool()) == world
    del content["objects"]["L"]["neighbors"]
    assert World.from_design_tool(content)["L"].connections is None


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({}, "cell code"),
        ({"indices": [0, 1], "types": [1]}, "cell code"),
        ({"indices": [0, 1], "types": [1, 0]}, "cell code"),
        ({"indices": [0, 12], "types": [1, 1]}, "0 to 11"),
        ({"indices": [-1], "types": [1]}, "0 to 11"),
        ({"indices": [3, 3], "types": [1, 1]}, "repeat"),
        ({"indices": [3], "types": [6]}, "codes"),
        ({"indices": [0], "types": [1], "neighbors": {"0": [1]}}, "neighbors"),
        ({"indices": [3, 4], "types": [1, 1], "neighbors": {"3": [4]}}, "side-adjacent"),
    ],
)
def test_unreadable_design_tool_objects_are_refused(entry, message):
    with pytest.raises(ValueError, match=message):
        World.from_design_tool({"grid_width": 4, "grid_height": 3, "objects": {"a": entry}})


def test_incomplete_design_tool_world_is_refused():
    with pytest.raises(ValueError, match="grid_height, objects missing"):
        World.from_design_tool({"grid_width": 4})


def test_every_world_is_evogyms():
    summary = {}
    for name in world_names():
        world = World.load(name)
        voxels = sum(int(np.count_nonzero(obj.grid)) for obj in world.objects)
        summary[name] = world.width, world.height, len(world.objects), voxels, zlib.crc32(world.to_picture().encode())
    assert summary == WORLDS


@pytest.mark.parametrize("name", WORLDS)
def test_every_world_survives_both_formats(name):
    world = World.load(name)
    assert World.from_picture(world.to_picture()) == world
    assert World.from_design_tool(json.loads(json.dumps(world.to_design_tool()))) == world


def test_prefabs():
    assert prefab_names() == ("package", "peg", "rigid_1x1", "rigid_2x2", "rigid_3x3")
    assert load_prefab("package").tolist() == [[2, 2, 2]] * 2
    assert load_prefab("peg").tolist() == [[5] * 5]
    for side in (1, 2, 3):
        assert load_prefab(f"rigid_{side}x{side}").tolist() == [[1] * side] * side
    with pytest.raises(ValueError, match="rigid_3x3"):
        load_prefab("rigid_4x4")
    with pytest.raises(ValueError, match="Walker-v0"):
        World.load("Runner-v0")
