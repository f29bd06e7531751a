"""SoftRobotEnv: specs, memory, partial resets, endings, seeds, saved states."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, RewardSum, StepCounter, TransformedEnv, check_env_specs

import evogymcm as cm
from evogymcm.envs import SoftRobotEnv
from tests.envs.lottery import LOTTERY
from tests.envs.tools import MATERIALS, PAPER_ROBOTS, SMALL, WIDE, make_engine, random_actions


def make_env(bodies=SMALL, num_worlds=3, material="reactive", time_limit=None, task="Walker-v0", **options):
    task = cm.tasks[task]
    task = task if time_limit is None else replace(task, time_limit=time_limit)
    return SoftRobotEnv(task, bodies, num_worlds, material=material, **{"num_threads": 1} | options)


def as_action(env, actuation, stiffness):
    action = {"actuation": torch.from_numpy(actuation)}
    if env.engine.material == "reactive":
        action["stiffness"] = torch.from_numpy(stiffness)
    return TensorDict({"action": TensorDict(action, env.batch_size)}, env.batch_size)


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("task", sorted(cm.tasks))
def test_specs_of_every_task(task, material):
    env = make_env(PAPER_ROBOTS.get(task, SMALL), 2, material, task=task)
    check_env_specs(env)
    n, v = 2, env.grid_shape[0] * env.grid_shape[1]
    size = 1 + (material == "reactive")
    assert len(env.action_keys) == size
    data = env.rollout(3)
    assert data["voxels"].shape == (n, 3, v, env.voxel_features)
    assert data["voxels"].dtype == data["task"].dtype == torch.float32
    assert data["observation"].dtype == torch.float64
    assert data["task"].shape[-1] >= 4
    for key in ("reward", "done", "terminated", "truncated"):
        assert data["next", key].shape == (n, 3, 1)


@pytest.mark.parametrize("num_worlds", [1, 5])
@pytest.mark.parametrize("material", MATERIALS)
def test_specs_with_mixed_bodies(material, num_worlds):
    env = make_env([SMALL, WIDE], num_worlds, material)
    check_env_specs(env, break_when_any_done="both")
    assert ("observation" in env.observation_spec.keys()) == (num_worlds == 1)


def test_action_bounds_and_static_observations():
    env = make_env([SMALL, WIDE], 2)
    assert env.grid_shape == (2, 4)
    actuation, stiffness = env.action_spec["action", "actuation"], env.action_spec["action", "stiffness"]
    assert (actuation.low == 0.6).all()
    assert (actuation.high == 1.6).all()
    assert (stiffness.low == 0.5).all()
    assert (stiffness.high == 2.0).all()
    data = env.reset()
    assert data["occupancy"].int().tolist() == [[1, 1, 1, 0, 1, 0, 1, 0], [1, 1, 1, 1, 1, 0, 0, 1]]
    assert data["actuators"].int().tolist() == [[1, 1, 1, 0, 0, 0, 0, 0], [0, 1, 0, 1, 1, 0, 0, 1]]
    assert (data["voxels"][~data["occupancy"]] == 0).all()
    assert data["types"][1].tolist()[:2] == [[1, 0, 3, 3, 0], [3, 0, 2, 0, 1]]


@pytest.mark.parametrize("material", MATERIALS)
def test_steps_are_those_of_the_engine(material):
    env = make_env([SMALL, WIDE], 4, material, task="DownStepper-v0")
    engine = make_engine("DownStepper-v0", [SMALL, WIDE], 4, material=material)
    env.reset()
    for actuation, stiffness in zip(*random_actions(engine, 8), strict=True):
        data = env.step(as_action(env, actuation, stiffness))["next"]
        engine.step(actuation, stiffness if material == "reactive" else None)
        np.testing.assert_array_equal(data["reward"].squeeze(-1), engine.reward.astype(np.float32))
        np.testing.assert_array_equal(data["voxels"], engine.voxels)
        np.testing.assert_array_equal(data["task"], engine.features.astype(np.float32))
        np.testing.assert_array_equal(data["com"], engine.com)
        np.testing.assert_array_equal(data["score"].squeeze(-1), engine.score)
        np.testing.assert_array_equal(data["return"].squeeze(-1), engine.returns)
        np.testing.assert_array_equal(data["unstable"].squeeze(-1), engine.unstable)


@pytest.mark.parametrize("device", [None, "cpu"])
@pytest.mark.parametrize("bodies", [SMALL, [SMALL, WIDE]])
def test_steps_need_no_completion(bodies, device):
    # What TensorDict and TorchRL would check or complete in every step, and this environment leaves out.
    env = make_env(bodies, 4, device=device)
    action = env.rand_action(env.reset())
    raw = env._step(action)
    checked = TensorDict(dict(raw.items()), env.batch_size, device=env.device)
    completed = EnvBase._step_proc_data(env, checked)
    specs = {**env.full_observation_spec, **env.full_reward_spec, **env.full_done_spec}
    assert set(raw.keys()) == set(completed.keys()) == set(specs)
    assert raw.device == completed.device == env.device
    for key, spec in specs.items():
        assert raw[key].shape == completed[key].shape == spec.shape
        assert raw[key].dtype == spec.dtype


def test_steps_are_those_with_torchrls_checks():
    class Checked(SoftRobotEnv):
        _step_proc_data = EnvBase._step_proc_data

        def _pack(self, values):
            tensors = {key: torch.from_numpy(value) for key, value in values.items()}
            return TensorDict(tensors, batch_size=self.batch_size, device=self.device)

    rollouts = []
    for kind in (SoftRobotEnv, Checked):
        env = kind(replace(cm.tasks["Walker-v0"], time_limit=4), "Walk_Bot", 3, num_threads=1)
        start = env.reset()
        env.engine.simulator.move("robot", (9.6, 0.0), 1)  # ends at once, and begins anew apart from the others
        env.engine.refresh()
        torch.manual_seed(0)
        rollouts.append(env.rollout(10, break_when_any_done=False, auto_reset=False, tensordict=start))
    ours, theirs = rollouts
    assert ours["next", "done"].squeeze(-1).sum(1).tolist() == [2, 3, 2]
    assert set(ours.keys(True, True)) == set(theirs.keys(True, True))
    assert (ours == theirs).all()


def test_time_slices_are_not_one_memory():
    env = make_env()
    carrier, seen = env.reset(), []
    for _ in range(5):
        shown = env.step(env.rand_action(carrier))["next"]
        seen.append((shown, shown.clone()))
        carrier = shown.copy()  # the same tensors in a tensordict that may get an action
    for kept, copy in seen:
        assert (kept == copy).all()
    voxels = torch.stack([kept["voxels"] for kept, _ in seen])
    assert (voxels[1:] != voxels[:-1]).flatten(1).any(-1).all()
    pointers = [kept[key].data_ptr() for kept, _ in seen for key in kept.keys()]
    assert len(set(pointers)) == len(pointers)


def test_truncated_stands_apart_from_terminated():
    env = make_env("Walk_Bot", 2, time_limit=4)
    env.reset()
    env.engine.simulator.move("robot", (9.6, 0.0), 1)
    env.engine.refresh()
    first = env.rand_step()["next"]
    assert first["terminated"].flatten().tolist() == [False, True]
    assert first["truncated"].flatten().tolist() == [False, False]
    assert first["done"].flatten().tolist() == [False, True]
    last = make_env("Walk_Bot", 2, time_limit=4).rollout(9)["next"]
    assert last["truncated"][..., 0].tolist() == [[False, False, False, True]] * 2
    assert not last["terminated"].any()


def test_partial_reset_by_mask():
    env = make_env(num_worlds=3)
    start = env.reset()
    carrier = env.rollout(3, auto_reset=False, tensordict=start.clone())[:, -1]["next"]
    mask = torch.tensor([[True], [False], [True]])
    again = env.reset(carrier.clone().set("_reset", mask))
    for key in ("voxels", "observation", "com", "score"):
        assert (again[key][::2] == start[key][::2]).all()
        assert (again[key][1] == carrier[key][1]).all()
    assert (again["voxels"][1] != start["voxels"][1]).any()


def test_partial_steps_leave_the_others_alone():
    env = SoftRobotEnv(LOTTERY, [SMALL, WIDE] * 3, material="reactive", num_threads=1)
    torch.manual_seed(0)
    data = env.rollout(9, break_when_all_done=True)  # TorchRL asks for those only whose episode goes on
    assert len(set(env.engine.length.tolist())) > 2
    assert env.engine.length.max() == data.shape[1]
    ended = data["next", "done"].squeeze(-1).cumsum(1) > 1  # all env-steps after the one that ended an episode
    assert (ended.sum(1) == data.shape[1] - torch.from_numpy(env.engine.length)).all()
    for world, length in enumerate(env.engine.length.tolist()):
        for key in ("voxels", "task", "com", "return", "done"):
            assert (data["next", key][world, length:] == data["next", key][world, length - 1]).all()
    again = env.step(env.rand_action(env.reset()).set("_step", torch.tensor([True, False] * 3)))["next", "reward"]
    assert again[::2].all()
    assert not again[1::2].any()


def test_transforms_follow_partial_resets_in_a_collector():
    # Worlds end apart: the second one stands at the goal at first, all are cut after five steps.
    def factory():
        env = TransformedEnv(make_env("Walk_Bot", 2, time_limit=5), Compose(RewardSum(), StepCounter()))
        env.reset()
        return env

    collector = Collector(factory, frames_per_batch=2 * 12, total_frames=2 * 12)
    collector.env.base_env.engine.simulator.move("robot", (9.6, 0.0), 1)
    collector.env.base_env.engine.refresh()
    (data,) = list(collector)
    collector.shutdown()
    steps = data["next", "step_count"].squeeze(-1)
    assert steps[0].tolist() == [1, 2, 3, 4, 5, 1, 2, 3, 4, 5, 1, 2]
    assert steps[1].tolist() == [1, 1, 2, 3, 4, 5, 1, 2, 3, 4, 5, 1]
    done = data["next", "done"].squeeze(-1)
    assert done[0].nonzero().flatten().tolist() == [4, 9]
    assert done[1].nonzero().flatten().tolist() == [0, 5, 10]
    assert data["next", "terminated"].squeeze(-1).nonzero().tolist() == [[1, 0]]
    # Both sums start again with each world's episode; the environment's own is float64.
    torch.testing.assert_close(
        data["next", "episode_reward"], data["next", "return"].float(), rtol=0, atol=1e-6, msg="sums differ"
    )
    # Observations go on within an episode, and start from the reset's after it.
    same = (data["voxels"][:, 1:] == data["next", "voxels"][:, :-1]).flatten(2).all(-1)
    assert (same == ~done[:, :-1]).all()
    assert (data["voxels"][0, 5] == data["voxels"][0, 0]).all()


def test_score_is_the_return_without_the_last_reward():
    data = make_env("Walk_Bot", 2, time_limit=6).rollout(10)["next"]
    rewards = data["reward"].double()
    torch.testing.assert_close(data["return"][:, -1], rewards.sum(1), rtol=0, atol=1e-6)
    torch.testing.assert_close(data["score"][:, -1], rewards[:, :-1].sum(1), rtol=0, atol=1e-6)


def test_equal_seeds_give_equal_rollouts():
    rollouts = []
    for _ in range(2):
        env = make_env([SMALL, WIDE], 4)
        env.set_seed(7)
        torch.manual_seed(7)
        rollouts.append(env.rollout(6))
    assert (rollouts[0] == rollouts[1]).all()


@pytest.mark.parametrize("material", MATERIALS)
def test_saved_state_goes_on_exactly(material):
    env = make_env([SMALL, WIDE], 4, material)
    torch.manual_seed(0)
    carrier = env.rollout(4)[:, -1]["next"]
    saved = pickle.loads(pickle.dumps(env.state_dict()))
    torch.manual_seed(1)
    first = env.rollout(5, auto_reset=False, tensordict=carrier.clone())
    other = make_env([SMALL, WIDE], 4, material)
    other.load_state_dict(saved)
    torch.manual_seed(1)
    second = other.rollout(5, auto_reset=False, tensordict=carrier.clone())
    assert (first == second).all()


def test_actions_out_of_range_are_clipped_and_nan_is_refused():
    env, other = make_env(), make_env()
    for e in (env, other):
        e.reset()
    wild = as_action(env, np.full((3, 6), 9.0), np.full((3, 6), -9.0))
    tame = as_action(env, np.full((3, 6), 1.6), np.full((3, 6), 0.5))
    assert (env.step(wild)["next"] == other.step(tame)["next"]).all()
    with pytest.raises(ValueError, match="NaN"):
        env.step(as_action(env, np.full((3, 6), np.nan), np.ones((3, 6))))


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize(
    ("action", "got"),
    [
        (torch.ones(3, 6), r"a tensor \[3, 6\]"),
        (None, "None"),
        (TensorDict(batch_size=[3]), "nothing"),
        (TensorDict({"actuator": torch.ones(3, 6)}, [3]), r"'actuator' \[3, 6\]"),
        (TensorDict({"actuation": torch.ones(3, 5)}, [3]), r"'actuation' \[3, 5\]"),
        (TensorDict({"actuation": TensorDict({"x": torch.ones(3, 6)}, [3])}, [3]), r"'actuation' \[3\]"),
    ],
)
def test_an_action_that_is_not_made_of_its_keys_is_refused_with_them(material, action, got):
    env = make_env(material=material)
    state = env.reset()
    if action is not None:
        state["action"] = action
    keys = r"\('action', 'actuation'\) \[3, 6\]" + r" and \('action', 'stiffness'\) \[3, 6\]" * (material == "reactive")
    with pytest.raises(ValueError, match=f"action: got {got}, expected {keys}$"):
        env.step(state)
    assert not env.engine.length.any()


def test_pickled_environment_goes_on_exactly():
    env = make_env([SMALL, WIDE], 4)
    carrier = env.rollout(3)[:, -1]["next"]
    twin = pickle.loads(pickle.dumps(env))
    rollouts = []
    for e in (env, twin):
        torch.manual_seed(0)
        rollouts.append(e.rollout(3, auto_reset=False, tensordict=carrier.clone()))
    assert (rollouts[0] == rollouts[1]).all()


def test_attributes():
    env = make_env([SMALL, WIDE], 3)
    assert env.task.id == "Walker-v0"
    assert [body.text for body in env.bodies] == [SMALL, WIDE, SMALL]
    assert env.score_ceiling.shape == (3,)
