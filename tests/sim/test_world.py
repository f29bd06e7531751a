"""Worlds: pictures, the Design Tool's JSON, placing, and the worlds that come with the package."""

import json
import zlib

import numpy as np
import pytest

from evogymcm._grid import full_connections
from evogymcm.sim import World, WorldObject, load_prefab, prefab_names, world_names

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
        ("object box at -1 0\nFFF", "origin: got -1"),
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


def test_simulation_order_is_by_name_with_actuators_first():
    world = World(9, 1)
    for x, (name, code) in enumerate(
        {"block_2": 1, "zebra": 4, "robot": 3, "block_10": 2, "Alpha": 5, "bird": 3}.items()
    ):
        world = world.place(WorldObject(name, [[code]], (x, 0)))
    order = ["robot", "bird", "zebra", "Alpha", "block_10", "block_2"]
    assert [obj.name for obj in world.simulation_order()] == order


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
        (("a", [[1]], (0, -1)), "origin: got -1"),
        (("a", [[1, 1]], (0, 0), [[0], [2]]), "connections"),
    ],
)
def test_invalid_objects_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        WorldObject(*arguments)


@pytest.mark.parametrize("name", ["\x1e0", "0\x1e", "a\rb", "\u2028 at 1 1", " a", "a "])
def test_names_may_hold_what_ends_lines_elsewhere(name):
    world = World(3, 1, (WorldObject(name, [[1]], (2, 0)),))
    assert World.from_picture(world.to_picture()) == world


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: WorldObject(3, [[1]], (0, 0)), "object name: got 3"),
        (lambda: WorldObject("a", [[10**400]], (0, 0)), "object 'a': grid: expected equally long rows of numbers"),
        (lambda: WorldObject("a", [[1]], (1.5, 0)), "object 'a': origin: got 1.5, expected a whole number"),
        (lambda: WorldObject("a", [[1]], None), "object 'a': origin: got None, expected two numbers"),
        (lambda: World(2.5, 3), "world: width: got 2.5, expected a whole number of at least 1"),
        (lambda: World(2, True), "world: height: got True, expected a whole number of at least 1"),
    ],
)
def test_places_and_sizes_that_are_no_whole_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


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


def generated_terrain(rng):
    """A file as programs write them: pieces stacked far above `grid_height`, in any order, with the keys of others."""
    width, height = int(rng.integers(3, 30)), int(rng.integers(-1, 4))
    objects, bottom = {}, 0
    for number in range(int(rng.integers(1, 6))):
        rows, columns = int(rng.integers(1, 4)), int(rng.integers(1, width + 1))
        left = int(rng.integers(0, width - columns + 1))
        bottom += int(rng.integers(0, 4))
        cells = rng.permutation([(bottom + r) * width + left + c for r in range(rows) for c in range(columns)]).tolist()
        steps = {i: [i + 1] * ((i + 1) % width > 0) + [i - 1] * (i % width > 0) + [i + width, i - width] for i in cells}
        neighbors = {str(i): [other for other in steps[i] if other in cells] for i in cells}
        types = rng.choice([0, 1, 2, 5, 5, 5], len(cells)).tolist()
        types[0] = 5
        objects[f"p{number + 1}"] = {"indices": cells, "types": types, "neighbors": neighbors, "colour": "grey"}
        bottom += rows
    return {"grid_width": width, "grid_height": height, "start_height": bottom, "objects": objects}


def test_cells_above_the_grid_height_are_read_as_in_evogym():
    rng = np.random.default_rng(0)
    n_above = 0
    for _ in range(200):
        content = generated_terrain(rng)
        world = World.from_design_tool(json.loads(json.dumps(content)))
        assert [obj.name for obj in world.objects] == list(content["objects"])
        assert world.height == max(1, content["grid_height"], *(obj.end[1] for obj in world.objects))
        for obj in world.objects:
            entry = content["objects"][obj.name]
            there = {
                (obj.origin[1] + obj.shape[0] - 1 - row) * world.width + obj.origin[0] + column: obj.grid[row, column]
                for row, column in np.ndindex(obj.shape)
            }
            assert there == dict(zip(entry["indices"], entry["types"], strict=True))  # the rectangle, empty cells too
            assert obj.connections is None
            n_above += max(entry["indices"]) >= content["grid_height"] * world.width
        assert World.from_design_tool(world.to_design_tool())[obj.name].grid.sum() == obj.grid.sum()
    assert n_above > 200


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ({"indices": [0, 1], "types": [5, 0]}, ([[5, 0]], None)),  # empty, but of the rectangle
        ({"indices": [0, 1], "types": [5.0, 5.0], "neighbors": {"0": [1], "1": []}}, ([[5, 5]], None)),  # one end
        ({"indices": [0, 1], "types": [5, 5], "neighbors": {0: [0, 1], 1: []}}, ([[5, 5]], None)),  # with itself
        # A corner, and neighbours in the file across a row's border, join nothing.
        ({"indices": [0, 1, 5], "types": [1, 1, 1], "neighbors": {"0": [5], "1": [], "5": [1]}}, ([[0, 1], [1, 1]], 1)),
        ({"indices": [3, 4], "types": [1, 1], "neighbors": {"3": [4], "4": [3]}}, ([[1, 0, 0, 0], [0, 0, 0, 1]], None)),
    ],
)
def test_what_evogym_passes_over_in_a_file_is_passed_over(entry, expected):
    obj = World.from_design_tool({"grid_width": 4, "objects": {"a": entry}})["a"]
    grid, n_joints = expected
    assert obj.grid.tolist() == grid
    assert (None if obj.connections is None else obj.connections.shape[1]) == n_joints


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({}, "expected indices and types"),
        ("FFF", "expected indices and types, got 'FFF'"),
        ({"indices": [], "types": []}, "no voxel"),
        ({"indices": [0, 1], "types": [0, 0]}, "no voxel"),
        ({"indices": [0, 1], "types": [1]}, "2 indices and 1 types"),
        ({"indices": [0.5], "types": [1]}, "indices: expected a list of integers"),
        ({"indices": ["a"], "types": [1]}, "indices: expected a list of integers"),
        ({"indices": [[0]], "types": [[1]]}, "indices: expected a list of integers"),
        ({"indices": [-1], "types": [1]}, "not repeat, got -1"),
        ({"indices": [3, 3], "types": [1, 1]}, "not repeat, got 3"),
        ({"indices": [2**30], "types": [1]}, "more than 10,000,000"),
        ({"indices": [3], "types": [6]}, "codes 6"),
        ({"indices": [3], "types": [-1]}, "codes -1"),
        ({"indices": [0], "types": [1], "neighbors": {"0": [1]}}, "neighbors: 1 are none of its 1 indices"),
        ({"indices": [0], "types": [1], "neighbors": {"0": [], "7": []}}, "neighbors: 7 are none"),
        ({"indices": [0, 1], "types": [1, 1], "neighbors": {"0": [1]}}, "none are given for 1"),
        ({"indices": [0], "types": [1], "neighbors": {"a": [0]}}, "expected lists of indices"),
        ({"indices": [0], "types": [1], "neighbors": [[0]]}, "expected lists of indices"),
        ({"indices": [10**400], "types": [1]}, "indices: expected a list of integers"),
        ({"indices": [0], "types": [1], "neighbors": {"0": [float("inf")]}}, "expected lists of indices"),
        ({"indices": [*range(5000)], "types": [7] * 5000}, "codes 7"),
        ({"indices": [*range(5000)], "types": [1] * 5000, "neighbors": {}}, "none are given for 0, 1, .* 4995 more"),
    ],
)
def test_unreadable_design_tool_objects_are_refused_by_name_in_few_words(entry, message):
    with pytest.raises(ValueError, match=message) as error:
        World.from_design_tool({"grid_width": 4, "objects": {"fence": entry}})
    assert "object 'fence': " in str(error.value)
    assert len(str(error.value)) < 300


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"grid_width": 4}, "needs grid_width and objects"),
        ([1], "needs grid_width and objects"),
        ({"grid_width": 0, "objects": {}}, "whole numbers"),
        ({"grid_width": 4, "grid_height": "high", "objects": {}}, "whole numbers"),
        ({"grid_width": True, "objects": {}}, "whole numbers"),
        ({"grid_width": 2**63, "objects": {"a": {"indices": [0], "types": [1]}}}, "whole numbers of at most"),
        ({"grid_width": 4, "objects": [{}]}, "by name"),
        ("{", "not JSON"),
    ],
)
def test_unreadable_design_tool_worlds_are_refused(tmp_path, content, message):
    path = tmp_path / "mine.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(ValueError, match=f"world mine.json: .*{message}"):
        World.from_design_tool(path)


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
    with pytest.raises(ValueError, match=r"Walker-v0, .* 26 more"):
        World.load("Walker")
