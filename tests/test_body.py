"""Bodies: representation, validation, text form and files."""

import json
import pickle

import numpy as np
import pytest
import torch

from evogymcm.body import (
    Body,
    as_body,
    check_stiffness,
    full_connections,
    has_actuator,
    is_connected,
    mutate_body,
    robot_tasks,
    robots,
    sample_body,
)
from evogymcm.envs import TaskEngine
from evogymcm.envs.dealing import as_bodies
from evogymcm.sim.world import World, WorldObject

STANDARD = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"


def slow_full_connections(grid):
    """The rule spelled out cell by cell."""
    rows, cols = grid.shape
    pairs = []
    for r in range(rows):
        for c in range(cols):
            if grid[r, c]:
                if c + 1 < cols and grid[r, c + 1]:
                    pairs.append((r * cols + c, r * cols + c + 1))
                if r + 1 < rows and grid[r + 1, c]:
                    pairs.append((r * cols + c, (r + 1) * cols + c))
    return np.array(pairs, dtype=int).reshape(-1, 2).T


def test_forms_of_one_body_are_equal():
    codes = [[3, 3, 3], [3, 0, 3]]
    body = Body(codes)
    forms = [
        Body.from_text("HHH/H.H"),
        Body("\n  HHH\n  H.H\n"),
        Body(["HHH", "H.H"]),
        Body(np.array(codes, dtype=float)),
        Body(codes, connections=full_connections(codes)),
        as_body("HHH/H.H"),
        as_body(codes),
        as_body(body),
    ]
    assert all(form == body and hash(form) == hash(body) for form in forms)
    assert body.text == "HHH/H.H"
    assert repr(body) == "Body('HHH/H.H')"
    assert body != Body("HHH/HSH")
    assert body != "HHH/H.H"


def test_attributes():
    body = Body.from_text(STANDARD)
    assert body.shape == (body.rows, body.cols) == (5, 5)
    assert body.grid.dtype == np.int8
    assert body.n_voxels == body.occupancy.sum() == 22
    assert body.n_actuators == 22
    np.testing.assert_array_equal(body.actuators, np.flatnonzero(body.grid))


def test_empty_border_is_kept():
    body = Body("H./..")
    assert body.shape == (2, 2)
    assert body != Body("H")


def test_actuators_are_in_the_order_of_the_actions():
    # Known from EvoGym's environments.
    assert robots["Walk_Bot"].actuators.tolist() == [1, 2, 3, 6, 7, 8, 10, 14, 15, 19]
    assert robots["Bridge_Bot"].actuators.tolist() == [4, 6, 7, 12, 14, 15, 17, 18, 19, 20, 21]


def test_is_immutable_and_copies_its_input():
    codes = np.array([[3, 1]])
    body = Body(codes)
    codes[:] = 0
    assert body.text == "HR"
    with pytest.raises(ValueError, match="read-only"):
        body.grid[0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        body.connections[0, 0] = 1
    with pytest.raises(AttributeError):
        body.grid = codes


def test_pickle_keeps_value_and_immutability():
    body = Body("HR/RR", connections=[[0], [1]])
    copy = pickle.loads(pickle.dumps(body))
    assert copy == body
    assert not copy.grid.flags.writeable


def test_connections():
    default = Body("HR/RR")
    assert default.has_default_connections
    assert default.connections.tolist() == [[0, 0, 1, 2], [1, 2, 3, 3]]
    assert Body("HR/RR", [[3, 1, 2, 0, 0], [2, 3, 0, 1, 1]]) == default  # order and repetition play no part
    partly = Body("HR/RR", [[0, 2], [1, 3]])
    assert not partly.has_default_connections
    assert partly != default
    assert Body("H").connections.shape == (2, 0)
    assert Body("HR", np.empty((2, 0), dtype=int)).connections.shape == (2, 0)
    assert "connections=" in repr(partly)


def test_full_connections_follow_the_rule():
    rng = np.random.default_rng(0)
    for shape in [(1, 1), (1, 6), (6, 1), (5, 5), (3, 7)]:
        for _ in range(20):
            grid = rng.integers(0, 5, shape)
            np.testing.assert_array_equal(full_connections(grid), slow_full_connections(grid))


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ("HX", "allowed characters"),
        ("HF", "allowed characters"),
        ("HH/H", "lengths"),
        ("", "lengths"),
        ([], "shape"),
        ([3, 3], "shape"),
        ([[3], [3, 3]], "equally long rows"),
        ([[3, 10**400]], "equally long rows of numbers"),
        ([[3, 5]], "codes"),
        ([[3, -1]], "codes"),
        ([[3, 0.5]], "codes"),
        ([[3, np.nan]], "codes"),
        ("H.H", "one piece"),
        ("H./.H", "one piece"),
        ("../..", "one piece"),
        ("RS", "actuator"),
    ],
)
def test_invalid_bodies_are_refused(grid, message):
    with pytest.raises(ValueError, match=message):
        Body(grid)


@pytest.mark.parametrize(
    "connections",
    [
        [[0], [2]],  # one below the other, but the cell is empty
        [[0], [3]],  # a corner
        [[1], [2]],  # neighbours in the flat array, across a row's border
        [[0], [9]],
        [[-1], [0]],
        [[0, 1]],
        [[0.0], [1.0]],
    ],
)
def test_invalid_connections_are_refused(connections):
    with pytest.raises(ValueError, match="connections"):
        Body("HR/.R", connections)


def test_unknown_robot_is_refused_with_the_names():
    with pytest.raises(ValueError, match="Walk_Bot"):
        as_body("walk_bot")
    assert as_body("Walk_Bot") is robots["Walk_Bot"]


def test_stiffness():
    body = Body("HR/.R")
    np.testing.assert_array_equal(check_stiffness(None, body), np.ones((2, 2)))
    given = [[0.5, 2.0], [np.nan, 1.5]]  # the empty cell's value does not count
    np.testing.assert_array_equal(check_stiffness(given, body), [[0.5, 2.0], [1.0, 1.5]])
    for wrong in ([[0.4, 1], [1, 1]], [[1, 2.1], [1, 1]], [[1, np.nan], [1, 1]], [[1, np.inf], [1, 1]], [1.0] * 4, 1.0):
        with pytest.raises(ValueError, match="stiffness"):
            check_stiffness(wrong, body)


def test_robots():
    assert len(robots) == 10
    assert robots["Walk_Bot"] == robots["speed_bot"] == Body("SHHHR/RHHHR/HR.RH/H...H")
    assert robots["tutorial_block"] == Body("/".join(["HHHHH"] * 5))
    counts = {name: (robot.n_voxels, robot.n_actuators) for name, robot in robots.items()}
    assert counts == {
        "Walk_Bot": (16, 10),
        "Bridge_Bot": (17, 11),
        "Down_Bot": (14, 9),
        "Cave_Bot": (12, 8),
        "Amax_Bot": (18, 11),
        "Amin_Bot": (12, 9),
        "speed_bot": (16, 10),
        "carry_bot": (19, 12),
        "climb_bot": (16, 11),
        "tutorial_block": (25, 25),
    }
    assert robot_tasks["Cave_Bot"] == "CaveCrawler-v0"
    assert len(robot_tasks) == 6


def slow_is_connected(grid):
    """The rule spelled out cell by cell."""
    left_over = {(int(r), int(c)) for r, c in np.argwhere(grid)}
    frontier = [left_over.pop()] if left_over else []
    is_any = bool(frontier)
    while frontier:
        r, c = frontier.pop()
        beside = {(r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)} & left_over
        left_over -= beside
        frontier += beside
    return is_any and not left_over


def test_connectedness_follows_the_rule():
    rng = np.random.default_rng(0)
    found = []
    for i in range(600):
        grid = rng.integers(0, 5, rng.integers(1, 9, 2)) * (rng.random() > rng.random() * (i % 4 > 0))
        found.append(slow_is_connected(grid))
        assert is_connected(grid if i % 2 else grid.astype(float)) == found[-1], grid
    assert 50 < sum(found) < 550
    snake = np.array([[1] * 9, [0] * 8 + [1], [1] * 9, [1] + [0] * 8, [1] * 9])
    assert is_connected(snake)
    snake[3, 0] = 0
    assert not is_connected(snake)


def test_validity():
    assert is_connected([[0, 1], [1, 1]])
    assert not is_connected([[1, 0], [0, 1]])
    assert not is_connected(np.zeros((5, 5)))
    assert has_actuator([[4]])
    assert not has_actuator([[1, 2, 5]])


# Files, as EvoGym and its Design Tool write them.


def test_bodies_are_read_from_files(tmp_path):
    body, slit = Body("HHV/R.S"), Body("HH/VV", [[0, 0, 1], [1, 2, 3]])
    np.savez(tmp_path / "17.npz", body.grid.astype(float), body.connections)
    np.savez(tmp_path / "bare.NPZ.npz", body.grid)
    np.savez(tmp_path / "slit.npz", slit.grid, slit.connections)
    np.savez(tmp_path / "one.npz", np.array([[3.0]]), np.empty(0))  # EvoGym's connections of a single voxel
    np.save(tmp_path / "body.npy", body.grid)
    texts = ["334\n102", "# mine\n3 3 4\n\n1 0 2\n", "3,3,4\n1,0,2,", "HHV\nR.S", "HHV/R.S"]
    np.savetxt(tmp_path / "saved.txt", body.grid)
    for number, text in enumerate(texts):
        (tmp_path / f"{number}.txt").write_text(text)
    robot = WorldObject("robot", body.grid, (3, 4))
    world = World.load("Pusher-v0").place(robot)
    ball = WorldObject("ball", [[3]], (20, 20))
    files = {"robot": World(9, 9, (robot,)), "world": world, "named": world.place(ball)}
    files["slit"] = World(9, 9, (WorldObject("new_object_1", slit.grid, (0, 0), slit.connections),))
    for name, content in files.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(content.to_design_tool()))

    read = {path.name: as_body(path) for path in tmp_path.iterdir()}
    assert len(read) == 5 + 1 + len(texts) + 4
    assert read.pop("slit.npz") == read.pop("slit.json") == slit
    assert read.pop("one.npz") == Body("H")
    assert set(read.values()) == {body}
    assert as_body(str(tmp_path / "17.npz")) == TaskEngine("Walker-v0", tmp_path / "17.npz", num_threads=1).bodies[0]
    assert as_body("334/102") == as_body(["334", "102"]) == body


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.npz", None, "no such file"),
        ("body.csv", "3", "ends with .npz, .npy, .txt, .json"),
        ("broken.npz", "no archive", "broken.npz"),
        ("broken.npy", "", "broken.npy"),
        ("empty.txt", "# nothing\n", "lengths"),
        ("ragged.txt", "3 3\n3", "equally long"),
        ("words.txt", "a soft robot", "rows of cells such as"),
        ("mixed.txt", "3H\nH3", "rows of cells such as"),
        ("soft.txt", "22\n22", "actuator"),
        ("broken.json", "{", "not JSON"),
        ("ground.json", json.dumps(World.load("Walker-v0").to_design_tool()), "none of its objects has actuators"),
        (
            "two.json",
            json.dumps(World(4, 1, tuple(WorldObject(n, [[3]], (x, 0)) for x, n in enumerate("ab"))).to_design_tool()),
            "'a', 'b' have actuators",
        ),
    ],
)
def test_unreadable_body_files_are_refused_by_name(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    with pytest.raises(ValueError, match=message) as error:
        as_body(path)
    assert name in str(error.value)


def test_body_in_arrays_of_other_names_is_refused(tmp_path):
    np.savez(tmp_path / "mine.npz", structure=np.full((2, 2), 3))
    with pytest.raises(ValueError, match=r"expected arr_0 .* got structure"):
        as_body(tmp_path / "mine.npz")


# What is given may be large; what is said of it is not.


def test_messages_are_short(tmp_path):
    large = np.full((60, 60), 2)
    calls = [
        lambda: Body(large),
        lambda: Body([*large.tolist(), [2]]),
        lambda: Body(np.arange(3600).reshape(60, 60)),
        lambda: Body("H" * 500 + "/H"),
        lambda: Body("HX" * 500),
        lambda: Body(np.full((60, 60), 3), np.arange(4000).reshape(2, 2000)),
        lambda: as_body("walk_bot" * 90),
        lambda: as_body([Body("H")] * 900),
        lambda: check_stiffness(np.ones((60, 60)), Body("H")),
        lambda: sample_body((5, 5), 0, weights=range(4000)),
        lambda: mutate_body(large, 0),
        lambda: as_body(f"{'long' * 50}.npz"),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=r"\w") as error:
            call()
        assert len(str(error.value)) < 300


def test_bodies_are_taken_as_data_frames_and_tensors_hold_them():
    pandas = pytest.importorskip("pandas")
    codes, body = np.array([[3, 3], [0, 4]]), Body("HH/.V")
    rows = np.empty(2, object)
    rows[:] = list(codes)
    column = pandas.DataFrame({"body": [codes, codes.tolist(), list(codes)]})["body"]
    forms = [rows, codes.astype(object), np.array(["HH", ".V"]), pandas.DataFrame(codes), *column, torch.tensor(codes)]
    forms += [pandas.Series(list(codes)), pandas.Series(["HH", ".V"])]
    assert all(as_body(form) == body for form in forms)
    assert as_bodies(column) == [body] * 3
