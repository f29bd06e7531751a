"""Walking in worlds of one's own: files, where the robot starts, goals, and the robot that a file holds."""

import json

import gymnasium
import numpy as np
import pytest

from evogymcm import Body, as_body, tasks
from evogymcm.envs import SoftRobotEnv, TaskEngine, as_task, parallel_env, walking_task
from evogymcm.sim.world import World, WorldObject
from tests.envs.tools import move, step_randomly
from tests.sim.test_world import generated_terrain

GROUND = WorldObject("ground", np.full((1, 30), 5), (0, 0))
ROBOT = WorldObject("robot", as_body("HHH/V.V").grid, (4, 3))


def write(path, world):
    """Writes a world as the Design Tool does, or what is to be its content."""
    content = world.to_design_tool() if isinstance(world, World) else world
    path.write_text(json.dumps(content))
    return path


def test_published_kind_of_file_is_walked_in_everywhere(tmp_path):
    row = [*range(10)]
    content = {"grid_width": 10, "grid_height": 2, "objects": {}}
    for name, first in (("p1", 0), ("p2", 20)):
        cells = [first + i for i in row]
        neighbors = {str(i): [j for j in (i - 1, i + 1) if j in cells] for i in cells}
        content["objects"][name] = {"indices": cells, "types": [5] * 10, "neighbors": neighbors}
    path = write(tmp_path / "terrain.json", content)
    task = as_task(str(path))
    assert (task.id, task.spawn, task.goal_x) == ("terrain", (1, 3), pytest.approx(0.9))
    envs = [
        SoftRobotEnv(path, "HH/VV", num_threads=1),
        parallel_env(str(path), "HH/VV", num_threads=1),
        gymnasium.make("evogymcm/Walker-v0", task=path, body="HH/VV").unwrapped,
        TaskEngine(task, "HH/VV", num_threads=1),
    ]
    engines = [getattr(env, "engine", env) for env in envs]
    for engine in engines:
        step_randomly(engine, 5)
        np.testing.assert_array_equal(engine.com, engines[0].com)
        assert 0.25 < engine.com[0, 1] < 0.45  # it stands on the upper row


def test_generated_terrains_are_walked_in(tmp_path):
    rng = np.random.default_rng(1)
    started = 0
    for number in range(30):
        path = write(tmp_path / f"{number}.json", generated_terrain(rng))
        try:
            task = walking_task(path)
        except ValueError:  # no room in column 1, as tested below
            continue
        engine = TaskEngine(task, Body("H"), num_threads=1)
        step_randomly(engine, 1)
        assert np.isfinite(engine.flat).all()
        started += 1
    assert started > 15


def test_walking_in_the_walkers_world_is_the_walkers_task():
    own, walker = (TaskEngine(task, "Walk_Bot", 1, num_threads=1) for task in (walking_task("Walker-v0"), "Walker-v0"))
    assert own.score_ceiling == pytest.approx(walker.score_ceiling)
    for engine in (own, walker):
        step_randomly(engine, 10)
    np.testing.assert_array_equal(own.com, walker.com)
    assert own.returns[0] == walker.returns[0] != 0


def test_goal_and_fall_end_an_episode():
    engine = TaskEngine(walking_task(World(30, 1, (GROUND,))), "HH/VV", 3, num_threads=1)
    move(engine, x=2.9)
    move(engine, x=1.0, y=-1.0, world=1)
    conditions = {bonus: condition.tolist() for condition, bonus, *_ in engine.task.endings(engine.snapshot)}
    assert conditions == {1.0: [True, False, False], -3.0: [False, True, False]}


@pytest.mark.parametrize(
    ("picture", "spawn"),
    [
        ("FFFFFFFFFF", (1, 1)),
        ("...F......\n...F......\nFFFFFFFFFF", (1, 3)),  # above the step, where there is room for a whole body
        ("FFFFFFFFFF\n" + "..........\n" * 5 + "FFFFFFFFFF", (1, 1)),  # in a cave
        ("FFFFFFFFFF\n" + "..........\n" * 4 + "FFFFFFFFFF", (1, 6)),  # on one that is too low
        ("..........\nFFFFFFFFFF\n..........", (1, 2)),
        ("F.....F", None),
        ("F......\n......F", None),
    ],
)
def test_the_robot_starts_at_the_lowest_place_with_ground_and_room(picture, spawn):
    world = World.from_picture(picture)
    if spawn is None:
        with pytest.raises(ValueError, match=r"no 5 x 5 cells .* give spawn=\(x, y\)"):
            walking_task(world)
    else:
        assert walking_task(world).spawn == spawn
    assert walking_task(world, (2, 9), time_limit=7, id="Mine-v0", gain=2.0).spawn == (2, 9)
    assert walking_task(World.from_picture("FFF\n...\nFFF"), room=(1, 2)).spawn == (1, 1)


def test_a_world_that_holds_its_robot(tmp_path):
    world = World(40, 9, (ROBOT, GROUND, WorldObject("ball", [[2, 2], [2, 2]], (20, 1))))
    path = write(tmp_path / "mine.json", world)
    task = walking_task(path)
    assert task.spawn == (4, 3)
    assert [obj.name for obj in task.world.objects] == ["ground", "ball"]
    assert task.floor.objects == ("ground", "ball")
    engine = TaskEngine(path, path, num_threads=1)
    assert engine.bodies[0] == Body("HHH/V.V")
    assert engine.com[0, 0] == pytest.approx(0.55)
    other = TaskEngine(path, "HHHHH/V...V", num_threads=1)
    assert other.com[0, 0] == pytest.approx(0.65)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.json", None, "world 'none.json': there is no such file"),
        ("world.csv", "FFF", "no such file that ends with .json or .txt"),
        ("bad.json", "{", "bad.json: it is not JSON"),
        ("bad.txt", "FX", "world 'bad.txt': cells 'X'"),
    ],
)
def test_unreadable_world_files_are_refused_by_name(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    with pytest.raises(ValueError, match=message):
        as_task(path)
    with pytest.raises(ValueError, match=message):
        World.load(path)


def test_a_picture_in_a_file_is_a_world(tmp_path):
    path = tmp_path / "hills.txt"
    path.write_text("..FF......\nFFFFFFFFFF\n")
    assert as_task(path).spawn == (1, 2)
    assert World.load(str(path)) == World.from_picture(path.read_text())
    assert as_task("Walker-v0") is tasks["Walker-v0"]
