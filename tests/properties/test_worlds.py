"""Worlds: what is written can be read back, what is no world is refused with a ValueError."""

import copy
import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from evogymcm.envs import TaskEngine, walking_task
from evogymcm.sim.world import World, WorldObject
from tests.properties.strategies import JSON, JUNK, tried, worlds

CELLS = (0, 1, 2, 3, 4, 5)
NAMES = st.text(min_size=1, max_size=12)


def cropped(obj):
    """An object without empty rows and columns at its rim, as the Design Tool has it."""
    rows, columns = np.flatnonzero(obj.grid.any(1)), np.flatnonzero(obj.grid.any(0))
    grid = obj.grid[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    origin = int(obj.origin[0] + columns[0]), int(obj.origin[1] + len(obj.grid) - 1 - rows[-1])
    joined = None
    if obj.connections is not None:
        row, column = np.divmod(obj.connections, obj.grid.shape[1])
        joined = (row - rows[0]) * grid.shape[1] + column - columns[0]
    return WorldObject(obj.name, grid, origin, joined)


@given(worlds(NAMES, CELLS))
def test_a_world_comes_back_from_a_design_tool_file(world):
    content = json.loads(json.dumps(world.to_design_tool()))
    same = World.from_design_tool(content)
    assert same.objects == tuple(cropped(obj) for obj in world.objects)
    assert (same.width, same.height) == (world.width, world.height)


@given(worlds(NAMES, CELLS))
def test_a_world_comes_back_from_its_picture(world):
    joined = World(world.width, world.height, tuple(WorldObject(o.name, o.grid, o.origin) for o in world.objects))
    if world.objects:
        assert World.from_picture(joined.to_picture()) == joined


def places(content, path=()):
    """The path of everything in a parsed file."""
    yield path
    if isinstance(content, dict):
        for key, value in content.items():
            yield from places(value, (*path, key))
    if isinstance(content, list):
        for index, value in enumerate(content):
            yield from places(value, (*path, index))


@given(worlds(st.sampled_from(["a", "b"]), CELLS), st.data())
def test_a_spoilt_design_tool_file_is_a_world_or_refused(world, data):
    content = copy.deepcopy(world.to_design_tool())
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(list(places(content))))
        value = data.draw(JSON)
        if not path:
            content = value
            break
        parent = content
        for key in path[:-1]:
            parent = parent[key]
        if data.draw(st.booleans()):
            parent[path[-1]] = value
        else:
            del parent[path[-1]]
    if isinstance(content, dict):
        tried(World.from_design_tool, content)


@given(JUNK)
def test_junk_is_no_world(junk):
    if isinstance(junk, dict):
        tried(World.from_design_tool, junk)
    tried(lambda junk: WorldObject("a", junk, (0, 0)), junk)
    tried(lambda junk: WorldObject("a", [[1]], junk), junk)
    tried(lambda junk: WorldObject("a", [[1, 1]], (0, 0), junk), junk)
    tried(lambda junk: WorldObject(junk, [[1]], (0, 0)), junk)
    tried(lambda junk: World(junk, 1), junk)
    tried(lambda junk: World(1, junk), junk)


LINES = st.sampled_from(
    [
        "size 9 9",
        "size 0 0",
        "object a at 0 0",
        "object b at 3 1",
        "object c at 1 4 is rigid_2x2",
        "FF..",
        "RS",
        "H",
        "# no",
        "",
    ]
)


@given(st.lists(LINES | st.text(max_size=8)).map("\n".join))
def test_any_text_is_a_picture_or_refused(text):
    world = tried(World.from_picture, text)
    if world is not None:
        assert World.from_picture(world.to_picture()) == world


@given(worlds(NAMES, CELLS), st.booleans())
def test_any_world_can_be_walked_in_or_is_refused(world, with_spawn):
    spawn = (1, max(obj.end[1] for obj in world.objects)) if world.objects and with_spawn else None
    task = tried(lambda world: walking_task(world, spawn, time_limit=3), world)
    engine = task and tried(lambda task: TaskEngine(task, "HVH/S.R", 2, num_threads=1), task)
    for _ in range(3 if engine else 0):
        engine.step(np.full((2, 6), 1.6))
        assert np.isfinite(engine.flat).all()
