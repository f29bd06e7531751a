"""What a user of EvoGym brings along: its tasks, arguments, render modes and methods, with only the id changed."""

import gymnasium
import numpy as np
import pytest

import evogymcm as cm

pytest.importorskip("pygame")

MODES = ("human", "screen", "img", "rgb_array")
OPTIONS = {"verbose": False, "hide_background": False, "hide_grid": True, "hide_edges": False, "hide_voxels": False}
GRID = np.array([[3, 4, 3], [2, 0, 1]])


pytestmark = pytest.mark.usefixtures("headless")


def make(task, body=GRID, **options):
    return gymnasium.make(f"evogymcm/{task}", body=body, **options)


@pytest.mark.parametrize("task", sorted(cm.tasks))
def test_every_task_runs_as_in_evogym(task):
    body = cm.sample_body((5, 5), np.random.default_rng(0))
    env = make(task, body.grid, connections=body.connections, render_mode="img", render_options=OPTIONS)
    assert set(MODES) <= set(env.metadata["render_modes"])
    env.action_space.seed(0)
    for seed in (None, 17):
        observation, info = env.reset(seed=seed, options={})
        assert isinstance(info, dict)
        for _ in range(3):
            assert observation in env.observation_space
            assert env.unwrapped.get_time() <= 3
            observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
            assert isinstance(reward, float)
            assert (isinstance(terminated, bool), isinstance(truncated, bool)) == (True, True)
            assert isinstance(info, dict)
            picture = env.render()
            assert (picture.dtype, picture.ndim, picture.shape[2]) == (np.uint8, 3, 3)
    with pytest.raises(ValueError, match="action"):
        env.step(np.ones(body.n_actuators + 1))
    env.close()


def test_every_render_mode():
    pictures = {}
    for mode in (None, *MODES):
        env = make("Walker-v0", render_mode=mode, render_options=OPTIONS)
        assert env.render_mode == mode
        env.reset(seed=0)
        env.step(env.action_space.high)
        pictures[mode] = env.render() if mode else None
        env.close()
    assert [mode for mode, picture in pictures.items() if picture is not None] == ["img", "rgb_array"]
    np.testing.assert_array_equal(pictures["img"], pictures["rgb_array"])


def test_parts_of_pictures_can_be_hidden():
    def picture(**options):
        env = make("Walker-v0", render_mode="img", render_options=options)
        env.reset()
        return env.render()

    full = picture()
    np.testing.assert_array_equal(picture(verbose=True, hide_grid=True), full)
    colors = [len(np.unique(p.reshape(-1, 3), axis=0)) for p in (full, picture(hide_edges=True))]
    assert colors[1] < colors[0]
    assert (picture(hide_voxels=True)[:250] > 240).mean() > (full[:250] > 240).mean() + 0.05
    assert (picture(hide_background=True) != full).any()
    nothing = picture(hide_background=True, hide_edges=True, hide_voxels=True, legend=False)
    assert len(np.unique(nothing[40:].reshape(-1, 3), axis=0)) == 1


def test_seeds_decide_as_in_evogym():
    first, second = make("BidirectionalWalker-v0"), make("BidirectionalWalker-v0")
    starts = [first.reset(seed=seed)[0] for seed in (5, 6, 5, None)]
    np.testing.assert_array_equal(starts[0], starts[2])
    np.testing.assert_array_equal(second.reset(seed=5)[0], starts[0])
    assert (starts[0] != starts[1]).any() or (starts[0] != starts[3]).any()


def test_evogyms_methods_give_evogyms_numbers():
    """The expected numbers are those of EvoGym 2.0.0 after the same five steps."""
    env = make("Carrier-v1")
    env.reset(seed=0)
    one = env.unwrapped
    for i in range(5):
        observation = env.step(np.array([0.6, 1.6, 1.2]) if i % 2 else np.array([1.6, 0.7, 0.6]))[0]

    def close(got, expected, atol=1e-6):
        assert isinstance(got, np.ndarray)
        assert got.dtype == np.float64
        np.testing.assert_allclose(got, expected, rtol=0, atol=atol)

    now = one.get_time()
    assert (now, type(now), one.VOXEL_SIZE) == (5, int, 0.1)
    close(one.get_pos_com_obs("robot"), [0.246072, 0.510118])
    close(one.get_vel_com_obs("robot"), [-0.36225, 0.427085])
    close(one.get_ort_obs("robot"), [6.261446])
    close(one.get_pos_com_obs("package"), [0.45, 1.087631])
    close(one.get_vel_com_obs("package"), [0.0, -1.648763])
    close(one.get_pos_com_obs("ground"), [3.111852, 0.245185])
    close(one.get_vel_com_obs("ground"), [0.0, 0.0])
    for still in ("package", "ground"):  # what is left is EvoGym's rounding of cosines
        assert one.get_ort_obs(still).shape == (1,)
        assert abs(np.sin(one.object_orientation_at_time(now, still))) < 0.005
    close(one.object_pos_at_time(now, "robot")[:, :2], [[0.088574, 0.202965], [0.608231, 0.610327]])
    close(one.object_vel_at_time(now, "robot")[:, :2], [[-3.188034, 0.722102], [0.013245, -1.814517]])
    close(one.pos_at_time(now).sum(1), [428.452863, 52.272996], atol=1e-5)
    close(one.vel_at_time(now).sum(1), [-4.346998, -14.660135], atol=1e-5)
    close(one.get_floor_obs("robot", ["ground"], 3), [0.5, *[0.110118] * 6])
    close(one.get_ceil_obs("robot", ["package"], 3, 4), [0.4] * 7)
    close(one.get_floor_obs("package", ["robot", "ground"], 2, 3), [0.3] * 5)
    assert one.get_actuator_indices("robot").tolist() == [0, 1, 2]
    assert one.get_dim_action_space("robot") == 3
    relative = one.get_relative_pos_obs("robot")
    np.testing.assert_allclose(one.object_pos_at_time(now, "robot"), one.points("robot"), rtol=0, atol=1e-15)
    assert all(part in observation for part in relative)
    kept = relative.copy()
    env.reset()
    np.testing.assert_array_equal(relative, kept)  # no view of what a reset writes
    assert one.get_time() == 0


def test_what_evogym_has_and_is_not_here_is_named():
    env = make("Walker-v0")
    env.reset()
    env.step(env.action_space.low)
    one = env.unwrapped
    for time in (0, 2):
        with pytest.raises(ValueError, match=f"time: got {time}, only the present env-step is kept, 1"):
            one.object_pos_at_time(time, "robot")
    for call in (one.get_pos_com_obs, one.get_ort_obs, lambda name: one.get_floor_obs("robot", [name], 2)):
        with pytest.raises(ValueError, match=r"package.*ground"):
            call("package")
    with pytest.raises(ValueError, match="only robot is 'robot'"):
        one.get_actuator_indices("ground")
    for name, instead in (("sim", "engine.simulator"), ("default_viewer", "render_options"), ("world", "task.world")):
        with pytest.raises(AttributeError, match=f"no attribute '{name}'.*{instead}"):
            getattr(one, name)
    assert not hasattr(one, "nonsense")
