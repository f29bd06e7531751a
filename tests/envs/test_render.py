"""Pictures, videos, and the adapters' render modes. All without a display."""

import copy
import pickle
import sys

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs import Compose, TransformedEnv
from torchrl.record import PixelRenderTransform, VideoRecorder
from torchrl.record.loggers.csv import CSVLogger

from evogymcm import tasks
from evogymcm.__main__ import main
from evogymcm.algos import make_actor
from evogymcm.envs import Renderer, SoftRobotEnv, parallel_env, population_env, sine_gait, write_picture, write_video
from evogymcm.envs.render import palette
from evogymcm.envs.render.downscale import downscale
from evogymcm.sim.constants import FIXED, H_ACT, RIGID, SOFT, V_ACT
from tests.envs.tools import SMALL, TALL, WIDE, make_engine

pygame = pytest.importorskip("pygame")
imageio = pytest.importorskip("imageio.v3")


pytestmark = pytest.mark.usefixtures("headless")


def walk(engine, steps):
    for _ in range(steps):
        engine.step(*sine_gait(engine))


def has_color(picture, color, at_least=1):
    return (np.abs(picture.astype(int) - color).max(-1) <= 1).sum() >= at_least


@pytest.mark.parametrize("task", sorted(tasks))
def test_every_task_has_a_picture(task):
    renderer = Renderer(make_engine(task, SMALL), 640, 320)
    picture = renderer.frame()
    assert picture.shape == (320, 640, 3)
    assert picture.dtype == np.uint8
    assert has_color(picture, palette.SKY, 1000)
    assert has_color(picture, palette.type_color(H_ACT), 4)
    assert has_color(picture, palette.type_color(FIXED), 4)


def test_picture_shows_where_the_robot_is():
    engine = make_engine("Walker-v0", "HHH/HHH")
    picture = Renderer(engine, 320, 160, legend=False).frame().astype(int)
    orange = np.abs(picture - palette.type_color(H_ACT)).max(-1) <= 1
    ground = np.abs(picture - palette.type_color(FIXED)).max(-1) <= 1
    rows, columns = np.nonzero(orange)
    width, height = np.ptp(columns), np.ptp(rows)
    assert width / height == pytest.approx(3 / 2, rel=0.1)
    assert columns.mean() == pytest.approx(160, abs=2)  # the camera follows
    assert rows.max() < np.nonzero(ground)[0].min()  # it stands on the ground
    assert np.nonzero(ground)[1].min() == pytest.approx(columns.min() - width / 3, abs=6)  # which begins at x = 0


def test_pictures_follow_the_state():
    engine = make_engine("BridgeWalker-v0", "Bridge_Bot")
    renderer = Renderer(engine)
    first = renderer.frame()
    assert first.shape == (320, 640, 3)
    np.testing.assert_array_equal(renderer.frame(), first)  # drawing changes nothing
    walk(engine, 10)
    second = renderer.frame()
    assert (first != second).any(-1).sum() > 1000
    engine.reset()
    np.testing.assert_array_equal(renderer.frame(), first)  # the camera starts anew


def test_camera_is_smooth():
    engine = make_engine("Walker-v0", "Walk_Bot")
    followed, jumping = Renderer(engine, 200, 100), Renderer(engine, 200, 100)
    followed.frame()
    for _ in range(30):
        walk(engine, 1)
        smooth = followed.frame()
    walk(engine, 1)
    assert (smooth != jumping.frame()).any()  # one camera lags behind, one begins here


def test_stiffness_view_shows_only_stiffness():
    engine = make_engine("Walker-v0", "HHH/S.R", material="reactive")
    ones = np.ones(engine.occupancy.shape)
    pictures, typed = [], []
    for factor in (0.5, 2.0):
        engine.reset()
        engine.step(ones, factor * ones)
        pictures.append(Renderer(engine, view="stiffness", legend=False).frame())
        typed.append(Renderer(engine, legend=False).frame())
        for other in (0.5, 2.0):
            color = palette.stiffness_colors(np.array([other]))[0]
            assert has_color(pictures[-1], color, 200) == (other == factor)
    assert typed[0].sum() > typed[1].sum()  # darker where stiffer
    assert not has_color(pictures[0], palette.type_color(H_ACT, stiffness=0.5), 20)


def test_colors():
    codes = np.array([RIGID, SOFT, H_ACT, V_ACT])
    ones = np.ones(4)
    values = [palette.type_colors(codes, ones, factor * ones).max(1) for factor in (0.5, 1.0, 2.0)]
    np.testing.assert_allclose(values[0] / values[1], np.sqrt(2), rtol=0.02)  # 0.9 / sqrt(S): none is clipped
    np.testing.assert_allclose(values[1] / values[2], np.sqrt(2), rtol=0.02)
    short, long = (palette.type_colors(codes, length * ones, ones) for length in (0.7, 1.4))
    np.testing.assert_array_equal(short[:2], long[:2])
    assert (long[2:].min(1) > short[2:].min(1) + 30).all()  # paler
    np.testing.assert_array_equal(short.max(1), long.max(1))  # and as bright
    lightness = palette.stiffness_colors(np.geomspace(0.5, 2.0, 20)) @ [0.30, 0.59, 0.11]
    assert (np.diff(lightness) < 0).all()


def test_grid_of_a_population():
    engine = make_engine("Walker-v0", [SMALL, WIDE, TALL], 5)
    renderer = Renderer(engine, 640, 320)
    picture = renderer.grid()
    assert picture.shape[1:] == (640, 3)
    walk(engine, 5)
    later = renderer.grid(range(5), columns=3)
    assert (picture != later).any()
    assert renderer.grid([4], columns=1).shape == renderer.frame().shape
    wide = Renderer(engine, 64, 32).grid(columns=5)
    assert wide.shape == (24, 240, 3)  # tiles are never too small to see
    for worlds, columns in (([], None), ([0], 0)):
        with pytest.raises(ValueError, match="at least one"):
            renderer.grid(worlds, columns)


def test_bad_arguments():
    engine = make_engine("Walker-v0", SMALL)
    with pytest.raises(ValueError, match=r"'depth'.*types"):
        Renderer(engine, view="depth")
    with pytest.raises(ValueError, match="8 x 320"):
        Renderer(engine, 8)


def test_downscale_is_the_mean():
    fine = np.random.default_rng(0).integers(0, 256, (6, 8, 3)).astype(np.uint32)
    packed = fine[..., 0] << 16 | fine[..., 1] << 8 | fine[..., 2]
    means = fine.reshape(3, 2, 4, 2, 3).mean((1, 3))
    np.testing.assert_array_equal(downscale(packed), np.floor(means + 0.5))


def frames(count, shape=(33, 65)):
    for i in range(count):
        picture = np.full((*shape, 3), 255, np.uint8)
        picture[:, : 10 * (i + 1)] = (200, 30, 30)
        yield picture


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_videos_can_be_read_back(tmp_path, suffix):
    path = write_video(tmp_path / f"walk{suffix}", frames(4), fps=25)
    read = imageio.imread(path, index=None)
    assert len(read) == 4
    height, width = read.shape[1:3]
    assert (height, width) == ((33, 65) if suffix == ".gif" else (34, 66))
    for i, picture in enumerate(read):
        np.testing.assert_allclose(picture[16, [2, 60], :3], [(200, 30, 30), (255, 255, 255)], atol=12, err_msg=str(i))
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_broken_videos_leave_nothing(tmp_path):
    path = tmp_path / "walk.gif"
    write_video(path, frames(2))
    before = path.read_bytes()

    def failing():
        yield from frames(1)
        yield np.zeros((2, 2, 3), np.uint8)

    with pytest.raises(ValueError, match=r"\(2, 2, 3\), expected uint8 \(33, 65, 3\)"):
        write_video(path, failing())
    with pytest.raises(ValueError, match="no frame"):
        write_video(path, [])
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ValueError, match=r"walk\.avi.*\.mp4"):
        write_video(tmp_path / "walk.avi", frames(1))
    with pytest.raises(ValueError, match=r"\.png"):
        write_picture(path, next(frames(1)))


def test_without_the_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pygame", None)
    monkeypatch.setitem(sys.modules, "imageio.v2", None)
    env = gymnasium.make("evogymcm/Walker-v0", body=SMALL)  # all else works
    env.reset()
    with pytest.raises(ImportError, match=r"pygame-ce.*pip install evogymcm\[render\]"):
        gymnasium.make("evogymcm/Walker-v0", body=SMALL, render_mode="rgb_array")
    with pytest.raises(ImportError, match=r"imageio.*pip install evogymcm\[render\]"):
        write_video(tmp_path / "walk.gif", frames(1))


def test_gymnasium_render_modes():
    env = gymnasium.make("evogymcm/Walker-v0", body=SMALL, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.reset()
    assert env.render().shape == (320, 640, 3)
    human = gymnasium.make("evogymcm/Walker-v0", body=SMALL, render_mode="human", render_options={"width": 200})
    human.reset()
    human.step(human.action_space.sample())
    assert pygame.display.get_surface().get_size() == (200, 320)
    assert human.render() is None
    human.close()
    assert pygame.display.get_surface() is None


SIZE = {"width": 64, "height": 32}
WITH_PICTURES = {
    "gymnasium": lambda options: gymnasium.make("evogymcm/Walker-v0", body=SMALL, **options),
    "vector": lambda options: gymnasium.make_vec("evogymcm/Walker-v0", 2, body=SMALL, num_threads=1, **options),
    "pettingzoo": lambda options: parallel_env("Walker-v0", [SMALL, TALL], num_threads=1, **options),
    "torchrl": lambda options: SoftRobotEnv("Walker-v0", [SMALL, TALL], num_threads=1),
    "population": lambda options: population_env("Walker-v0", [SMALL, TALL], num_threads=1),
}


def pickled(env):
    return pickle.loads(pickle.dumps(env))


@pytest.mark.parametrize("copied", [copy.deepcopy, pickled])
@pytest.mark.parametrize("adapter", WITH_PICTURES)
def test_environments_that_have_rendered_can_be_copied(adapter, copied):
    env = WITH_PICTURES[adapter]({"render_mode": "rgb_array", "render_options": SIZE})
    size = SIZE if isinstance(env, torch.nn.Module) else {}
    env.reset()
    for _ in range(2):
        walk(getattr(env, "unwrapped", env).engine, 3)
        before = env.render(**size)
        other = copied(env)
        np.testing.assert_array_equal(other.render(**size), before)
        for each in (env, other):
            walk(getattr(each, "unwrapped", each).engine, 5)  # the copy's camera lags behind as the original's does
        np.testing.assert_array_equal(other.render(**size), env.render(**size))
        assert (np.asarray(env.render(**size)) != np.asarray(before)).any()
        env = other


@pytest.mark.parametrize("copied", [copy.deepcopy, pickled])
def test_environments_with_a_window_can_be_copied(copied):
    env = gymnasium.make("evogymcm/Walker-v0", body=SMALL, render_mode="screen", render_options=SIZE)
    env.reset()
    idle = np.ones(env.action_space.shape)
    env.step(idle)
    other = copied(env)
    np.testing.assert_array_equal(other.step(idle)[0], env.step(idle)[0])
    other.close()
    env.step(idle)  # opens the one window anew, which the copy has closed
    assert pygame.display.get_surface().get_size() == (64, 32)
    env.close()
    assert pygame.display.get_surface() is None


def test_closing_the_window_ends_nothing():
    env = gymnasium.make("evogymcm/Walker-v0", body=SMALL, render_mode="human")
    env.reset()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(3):
        env.step(env.action_space.sample())
    assert pygame.display.get_surface() is None
    env.close()


def test_vector_environment_renders_every_world():
    envs = gymnasium.make_vec("evogymcm/Walker-v0", num_envs=3, body=SMALL, render_mode="rgb_array")
    envs.reset()
    pictures = envs.render()
    assert len(pictures) == 3
    assert all(picture.shape == (320, 640, 3) for picture in pictures)


def test_torchrl_video_recorder(tmp_path):
    logger = CSVLogger("walk", log_dir=str(tmp_path), video_format="pt")
    pixels = PixelRenderTransform(width=64, height=32)
    recorder = VideoRecorder(logger, tag="rollout", make_grid=False)
    env = TransformedEnv(SoftRobotEnv("Walker-v0", SMALL, 2, num_threads=1), Compose(pixels, recorder))
    rollout = env.rollout(3)
    assert rollout["pixels"].shape == (2, 3, 32, 64, 3)
    assert rollout["pixels"].dtype is torch.uint8
    env.transform.dump()
    assert list(tmp_path.rglob("*.pt"))


def test_watch_writes_files(tmp_path, capsys):
    gif = tmp_path / "walk.gif"
    size = ["--width", "120", "--height", "60"]
    assert main(["watch", "Walker-v0", "--body", SMALL, "--steps", "6", "--every", "2", "--out", str(gif), *size]) == 0
    assert imageio.imread(gif, index=None).shape == (4, 60, 120, 3)
    png = tmp_path / "two.png"
    main(["watch", "Walker-v0", "--body", SMALL, TALL, "--steps", "2", "--view", "stiffness", "--out", str(png), *size])
    assert imageio.imread(png).shape[2] == 3
    assert f"{SMALL}: 2 env-steps, score" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["watch", "Walker-v0", "--steps", "0"])
    assert "steps: got 0" in capsys.readouterr().err


def test_watch_without_a_display_writes_a_video(tmp_path, monkeypatch):
    for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.chdir(tmp_path)
    main(["watch", "Walker-v0", "--body", SMALL, "--steps", "2", "--width", "64", "--height", "32"])
    assert (tmp_path / "Walker-v0.mp4").stat().st_size > 0


def test_watch_opens_a_window(capsys):
    main(["watch", "Walker-v0", "--body", SMALL, "--steps", "2"])
    assert "wrote" not in capsys.readouterr().out


@pytest.mark.parametrize("material", ["reactive", "invariant"])
def test_watch_plays_a_policy(tmp_path, material, capsys):
    env = SoftRobotEnv("Walker-v0", SMALL, 1, material=material, num_threads=1)
    actor = make_actor(env, hidden=8)
    torch.save({"form": actor.form, "actor": actor.state_dict(), "row": {}}, tmp_path / "final.pt")
    arguments = ["watch", "Walker-v0", "--body", SMALL, "--policy", str(tmp_path), "--steps", "2"]
    assert main([*arguments, "--out", str(tmp_path / "run.png"), "--width", "64", "--height", "32"]) == 0
    other = {"reactive": "invariant", "invariant": "reactive"}[material]
    for wrong, message in (([*arguments, "--material", other], other), (["--policy", "nowhere"], "final.pt")):
        with pytest.raises(SystemExit):
            main(wrong if "watch" in wrong else ["watch", "Walker-v0", *wrong])
        assert message in capsys.readouterr().err
