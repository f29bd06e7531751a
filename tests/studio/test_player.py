"""The player: episodes exactly as evaluations have them, in real time, while others look on and change things."""

import gc
import threading
import time

import numpy as np
import pytest

import evogymcm as cm
from evogymcm.algos import PPOConfig, TrainConfig, evaluate, load_policy, train
from evogymcm.algos.gaits import FoundGaits, Waves, save_gaits
from evogymcm.envs import SoftRobotEnv, TaskEngine, sine_gait
from evogymcm.sim.world import World
from evogymcm.studio.improving import MaterialImprovement
from evogymcm.studio.learning import Learning
from evogymcm.studio.player import Player
from evogymcm.studio.runs import Runs
from evogymcm.studio.store import Store
from tests.envs.lottery import LOTTERY

BODY, OTHER = "HHH/V.V", "HHHH/V..V"
FIELD = np.linspace(0.5, 2, 6).reshape(2, 3)
PPO = PPOConfig(total_steps=64, num_worlds=2, rollout_steps=16, minibatch=16, eval_interval=0, epochs=1, hidden=4)


def play_out(player):
    while not player.has_ended:
        player.step()
    return player.frame()


def clocks():
    return [thread for thread in threading.enumerate() if thread.name == "evogymcm clock"]


@pytest.fixture
def player(sprint):
    player = Player(BODY, FIELD, sprint)
    yield player
    player.close()


def test_an_episode_is_exactly_that_of_an_evaluation():
    expected = evaluate(sine_gait, TaskEngine("Walker-v0", BODY, stiffness=[FIELD], num_threads=1))
    player = Player(BODY, FIELD)
    frame = play_out(player)
    assert (frame["score"], frame["return"]) == (expected.score[0], expected.returns[0])
    assert (frame["step"], frame["ending"], frame["time"]) == (500, "time", 10.0)
    player.step()
    assert (player.frame()["step"], player.frame()["episode"], player.frame()["ending"]) == (0, 1, None)
    assert play_out(player)["score"] == expected.score[0]


@pytest.mark.parametrize("material", ["invariant", "reactive"])
def test_a_policy_of_a_run_acts_as_in_its_evaluation(sprint, material):
    field = FIELD if material == "invariant" else None
    config = TrainConfig(sprint, BODY, material, stiffness=None if field is None else (field,), ppo=PPO)
    result = train(config, run="run", num_threads=1)
    player = Player(BODY, field, sprint, material, "run")
    assert play_out(player)["score"] == result.final.score[0]
    if material == "reactive":
        assert len(set(player.frame()["stiffness"])) > 1
    player.use(load_policy("run/best.pt"))
    player.update(OTHER)  # any body
    assert not player.frame()["mixed"]
    saved = load_policy("run/best.pt")
    env = saved.make_env(bodies=[OTHER])
    assert play_out(player)["score"] == evaluate(saved.module(env), env).score[0]
    with pytest.raises(ValueError, match="was trained with"):
        Player(BODY, None, sprint, {"invariant": "reactive", "reactive": "invariant"}[material], "run")


def test_a_found_gait_moves_as_in_its_evaluation(tmp_path):
    waves, path = Waves(np.linspace(-1, 1, 9)[None]), tmp_path / "gait.json"
    expected = evaluate(waves, TaskEngine("Walker-v0", BODY, stiffness=[FIELD], num_threads=1))
    found = FoundGaits(waves, expected.score, expected.length, [], finished=True)
    save_gaits(path, found, "Walker-v0", [BODY], stiffness=[FIELD])
    assert play_out(Player(BODY, FIELD, policy=path))["score"] == expected.score[0]
    with pytest.raises(ValueError, match="material: got 'reactive'"):
        Player(BODY, material="reactive", policy=path)
    path.write_text("{}")
    with pytest.raises(ValueError, match="cannot be read as gaits"):
        Player(BODY, policy=path)


@pytest.mark.usefixtures("sprint_baseline")
def test_the_packages_baseline_moves_any_body_and_is_what_work_begins_with(sprint, tmp_path):
    for body in (BODY, OTHER):
        expected = evaluate(cm.baseline(sprint), SoftRobotEnv(sprint, body, 1)).score[0]
        assert play_out(Player(body, task=sprint, policy="baseline"))["score"] == expected
    learning = Learning(tmp_path / "one", BODY, FIELD, sprint, initial="baseline")
    assert (learning.config.ppo.hidden, learning.config.ppo.context) == (8, "attention")
    assert MaterialImprovement(tmp_path / "two", BODY, task=sprint, policy="baseline").config.policy == "policy"
    runs = Runs(Store(tmp_path / "robots"))
    offered = {
        task: runs.policies(task, material) for task, material in ((sprint, "invariant"), ("terrain", "invariant"))
    }
    assert offered[sprint].pop("baseline") == "Baseline policy"
    assert offered[sprint] == offered["terrain"] == runs.policies(sprint, "reactive")


def test_bad_input_says_so_before_any_thread(sprint):
    before = len(clocks())
    for options, match in (
        ({"body": "H.H"}, "one piece"),
        ({"body": BODY, "stiffness": FIELD * 3}, "stiffness"),
        ({"body": BODY, "task": "Walker-v9"}, "task"),
        ({"body": BODY, "material": "x"}, "material"),
        ({"body": BODY, "stiffness": FIELD, "material": "reactive"}, "stiffness"),
        ({"body": BODY, "policy": "nowhere"}, "policy"),
        ({"body": BODY, "policy": "baseline"}, "baseline: got"),
        ({"body": BODY, "policy": 3}, "policy"),
        ({"body": BODY, "speed": 0}, "speed"),
        ({"body": BODY, "speed": 1e9}, "speed"),
        ({"body": BODY, "seed": -1}, "seed"),
        ({"body": np.full((9, 9), 3), "task": "Climber-v0"}, "fit"),
    ):
        with pytest.raises(ValueError, match=match):
            Player(**({"task": sprint} | options))
    assert len(clocks()) == before


@pytest.mark.slow
def test_it_keeps_time_at_little_cost_and_never_rushes(player):
    def made(since):
        now = player.frame()
        return 13 * (now["episode"] - since["episode"]) + now["step"] - since["step"]  # the start is shown too

    player.speed = 100
    player.play()
    time.sleep(0.1)
    keeps_time = False
    for _ in range(60):  # others may take the processor
        first, start, cpu = player.frame(), time.monotonic(), time.process_time()
        for _ in range(20):
            player.frame()
            time.sleep(0.025)
        count, seconds, cost = made(first), time.monotonic() - start, time.process_time() - cpu
        assert count < 110 * seconds + 10
        assert cost < 0.3 * seconds
        keeps_time = count > 25 * seconds
        if keeps_time:
            break
    assert keeps_time
    with player._stepping:  # something holds it up
        first = player.frame()
        time.sleep(0.5)
    start = time.monotonic()
    time.sleep(0.1)
    count = made(first)
    assert count <= 100 * (0.1 + time.monotonic() - start) + 2  # most of the delay is forgotten
    player.pause()
    now = player.frame()
    time.sleep(0.05)
    assert player.frame()["step"] == now["step"]
    assert not player.frame()["playing"]


def test_without_repeating_it_pauses_at_the_end(sprint):
    player = Player(BODY, task=sprint, speed=1000, repeats=False)
    player.play()
    deadline = time.monotonic() + 120
    while player.is_playing and time.monotonic() < deadline:
        time.sleep(0.01)
    assert (player.frame()["ending"], player.frame()["step"]) == ("time", 12)
    player.close()
    with pytest.raises(RuntimeError, match="closed"):
        player.play()
    assert player.frame()["step"] == 12


def test_stiffness_changes_within_an_episode_and_a_body_begins_one(player):
    player.step(5)
    player.update(BODY, FIELD[:, ::-1])
    frame = player.frame()
    assert (frame["step"], frame["design"], frame["mixed"]) == (5, 0, True)
    assert frame["stiffness"] == pytest.approx(FIELD[:, ::-1].ravel()[[0, 1, 2, 3, 5]])
    player.reset()
    fresh = Player(BODY, FIELD[:, ::-1], player._task)
    assert play_out(player)["score"] == play_out(fresh)["score"]  # as if it had been so from the beginning
    assert not player.frame()["mixed"]
    player.update(OTHER)
    frame, scene = player.frame(), player.scene()
    assert (frame["step"], frame["design"], scene["design"], scene["body"]) == (0, 1, 1, OTHER)
    assert len(frame["corners"]) == len(frame["types"]) == len(scene["cells"]) == len(scene["sides"]) == 6
    before = player.frame()
    for body, field in (("H.H", None), (OTHER, FIELD), (OTHER, np.full((2, 4), 3.0))):
        with pytest.raises(ValueError):  # noqa: PT011  (each for a reason of its own)
            player.update(body, field)
    assert player.frame()["corners"].tolist() == before["corners"].tolist()


def test_draws_follow_the_seed():
    expected = evaluate(sine_gait, SoftRobotEnv(LOTTERY, BODY, num_threads=1, seed=3))
    lottery = Player(BODY, task=LOTTERY, seed=3)
    assert play_out(lottery)["return"] == expected.returns[0]
    lottery.reset(11)
    assert play_out(lottery)["return"] != expected.returns[0]
    lottery.reset(3)
    assert play_out(lottery)["return"] == expected.returns[0]
    first, second = (Player(BODY, task="ObstacleTraverser-v0", policy="random", seed=3) for _ in range(2))
    for player in (first, second):
        player.step(3)
    assert (first.frame()["corners"] == second.frame()["corners"]).all()
    second.reset(4)
    second.step(3)
    assert (first.frame()["corners"] != second.frame()["corners"]).any()
    second.reset(3)
    second.step(3)
    assert (first.frame()["corners"] == second.frame()["corners"]).all()


def test_frames_show_the_world_where_it_is():
    player = Player(BODY, task="Carrier-v0")
    frame, scene, engine = player.frame(aspect=1.5), player.scene(), player._stage.engine
    robot = engine.simulator.positions("robot")
    corners = frame["corners"].reshape(-1, 2)
    assert corners.min(0) == pytest.approx(robot.min(1), abs=1e-6)
    assert (corners[0] == frame["corners"][0, 0]).all()
    upper_left, upper_right, lower_right, lower_left = frame["corners"][0]
    assert upper_left[0] == lower_left[0] < upper_right[0] == lower_right[0]
    assert upper_left[1] == upper_right[1] > lower_left[1] == lower_right[1]
    package = engine.simulator.positions(engine.task.watches[0])
    assert frame["objects"]["corners"].reshape(-1, 2).max(0) == pytest.approx(package.max(1), abs=1e-6)
    left, bottom, right, top = frame["camera"]
    assert left < robot[0].min() < robot[0].max() < right
    assert (right - left) / (top - bottom) == pytest.approx(1.5)
    assert scene["terrain"][..., 1].max() <= robot[1].min() + 1e-6
    assert scene["cells"].tolist() == [[0, 0], [0, 1], [0, 2], [1, 0], [1, 2]]
    assert (scene["task"], scene["time_limit"]) == ("Carrier-v0", 500)


def test_a_world_of_its_own_is_walked_in(tmp_path):
    picture = "F....................F\nFFFFFFFFFFFFFFFFFFFFFF"
    (tmp_path / "valley.txt").write_text(picture)
    for world in (World.from_picture(picture), tmp_path / "valley.txt"):
        player = Player(BODY, task=world)
        player.step(2)
        assert len(player.scene()["terrain"]) == 24
        assert player.scene()["goal_x"] == pytest.approx(2.1)


@pytest.mark.slow
def test_many_threads_at_once_see_whole_frames_and_break_nothing(player):
    player.speed = 1000
    player.play()
    stop, errors = threading.Event(), []

    def look(change):
        try:
            while not stop.is_set():
                change()
                frame = player.frame()
                assert len(frame["corners"]) == len(frame["types"]) == len(frame["stiffness"])
                assert np.isfinite(frame["corners"]).all()
        except Exception as error:
            errors.append(error)

    changes = (
        lambda: None,
        lambda: player.update(OTHER),
        lambda: player.update(BODY, FIELD),
        lambda: player.update(BODY),
        lambda: player.use("random"),
        player.reset,
        lambda: player.reset(1),
        player.pause,
        player.play,
    )
    threads = [threading.Thread(target=look, args=(change,), daemon=True) for change in changes]
    for thread in threads:
        thread.start()
    time.sleep(1)
    stop.set()
    for thread in threads:
        thread.join(120)
        assert not thread.is_alive()
    assert not errors
    assert player.frame()["error"] is None


def test_an_error_in_a_step_pauses_and_is_told(player):
    def broken(engine):
        raise ValueError("no idea what to do")

    player._stage._gait = broken
    player.play()
    deadline = time.monotonic() + 120
    while player.frame()["error"] is None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert player.frame()["error"] == "no idea what to do"
    assert not player.is_playing
    player.use("still")
    player.step(2)
    assert (player.frame()["episode"], player.frame()["step"]) == (1, 1)
    player.play()
    assert player.frame()["error"] is None


def test_a_player_that_nobody_holds_ends_its_thread(sprint):
    before = len(clocks())
    player = Player(BODY, task=sprint)
    player.play()
    assert len(clocks()) == before + 1
    del player
    gc.collect()
    deadline = time.monotonic() + 120
    while len(clocks()) > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert len(clocks()) == before
