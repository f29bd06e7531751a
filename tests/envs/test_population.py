"""population_env: bodies as agents of one TorchRL environment, each ending and restarting alone."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import CompositeDistribution, NormalParamExtractor, TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import (
    Compose,
    FlattenObservation,
    MarlGroupMapType,
    RewardSum,
    SerialEnv,
    StepCounter,
    TransformedEnv,
    check_env_specs,
)
from torchrl.modules import MultiAgentMLP, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from torchrl.record import PixelRenderTransform

import evogymcm as cm
from evogymcm.envs import SoftRobotEnv, population_env
from tests.envs.lottery import LOTTERY
from tests.envs.tools import MATERIALS, SMALL, TALL, WIDE

MIXED = (SMALL, WIDE, TALL)  # padded to 3x4
GROUP_MAPS = {
    "one each": MarlGroupMapType.ONE_GROUP_PER_AGENT,
    "all": MarlGroupMapType.ALL_IN_ONE_GROUP,
    "two": {"a": ["body_2", "body_0"], "b": ["body_1"]},
}


def make_env(task="Walker-v0", bodies=MIXED, *args, **options):
    return population_env(task, bodies, *args, **{"material": "reactive", "num_threads": 1} | options)


def random_rollout(env, steps, seed=0):
    """A rollout by random actions, through all restarts."""
    torch.manual_seed(seed)
    return env.rollout(steps, break_when_any_done=False)


def assert_same(got, expected):
    """Both hold the same keys with equal values."""
    assert set(got.keys(True, True)) == set(expected.keys(True, True))
    for key in expected.keys(True, True):
        assert torch.equal(got[key], expected[key]), key


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("task", sorted(cm.tasks))
def test_specs_of_every_task(task, material):
    check_env_specs(make_env(task, (SMALL, WIDE), material=material))


@pytest.mark.parametrize("copies", [None, 1, 2])
@pytest.mark.parametrize("groups", [None, *GROUP_MAPS])
def test_specs_with_copies_and_groups(copies, groups):
    env = make_env(LOTTERY, MIXED, copies, group_map=GROUP_MAPS.get(groups))
    transforms = Compose(RewardSum(in_keys=env.reward_keys), StepCounter())
    check_env_specs(env)
    check_env_specs(TransformedEnv(env, transforms), break_when_any_done="both")


@pytest.mark.parametrize("copies", [None, 2])
def test_keys_are_those_of_worlds_under_the_group(copies):
    env, worlds = make_env(copies=copies), SoftRobotEnv("Walker-v0", MIXED, material="reactive", num_threads=1)
    assert env.group_map == {"bodies": ["body_0", "body_1", "body_2"]}
    assert env.batch_size == (() if copies is None else (2,))
    assert env.grid_shape == (3, 4)
    assert [body.text for body in env.bodies] == list(MIXED)
    assert env.done_keys == [("bodies", "done"), ("bodies", "terminated"), ("bodies", "truncated")]
    group, single = env.rollout(2), worlds.rollout(2)
    for now, expected in ((group["bodies"], single), (group["next", "bodies"], single["next"])):
        assert now.batch_size == (*env.batch_size, 2, 3)
        expected = expected.exclude("next").transpose(0, 1)  # (steps, bodies)
        assert set(now.keys(True, True)) == set(expected.keys(True, True))
        for key, values in expected.items(True, True):
            assert now[key].shape == (*env.batch_size, *values.shape)
            assert now[key].dtype == values.dtype
    assert env.score_ceiling.shape == (3,)


def test_flat_observation_where_bodies_are_equal():
    equal = make_env(bodies=[SMALL, SMALL]).reset()
    assert equal["bodies", "observation"].shape[0] == 2
    assert ("bodies", "observation") not in make_env().reset().keys(True)


@pytest.mark.usefixtures("small_batches_pay")
def test_a_mixed_population_equals_single_worlds():
    rng = np.random.default_rng(0)
    bodies = [cm.sample_body(tuple(rng.integers(2, 6, 2)), rng) for _ in range(64)]
    env = make_env(bodies=bodies, num_threads=2)
    rows, columns = env.grid_shape
    data = random_rollout(env, 6)
    for i, body in enumerate(bodies):
        alone = SoftRobotEnv("Walker-v0", body, material="reactive", num_threads=1)
        cells = (np.arange(body.rows)[:, None] * columns + np.arange(body.cols)).ravel()
        alone.reset()
        for t in range(6):
            action = data[t]["bodies", "action"][i : i + 1].apply(lambda values, cells=cells: values[:, cells])
            step = alone.step(TensorDict(action=action, batch_size=[1]))["next"]
            expected = data[t]["next", "bodies"][i]
            for key in ("voxels", "occupancy", "actuators"):
                padded = expected[key].reshape(rows * columns, -1)
                assert torch.equal(step[key][0].reshape(len(cells), -1), padded[cells])
                assert not padded[np.setdiff1d(np.arange(rows * columns), cells)].any()
            for key in ("task", "com", "score", "return", "reward", "unstable", "reached", "done"):
                assert torch.equal(step[key][0], expected[key]), key


@pytest.mark.parametrize("groups", list(GROUP_MAPS))
def test_groups_hold_the_same_worlds(groups):
    env, other = make_env(LOTTERY), make_env(LOTTERY, group_map=GROUP_MAPS[groups])
    places = {name: (group, i) for group, names in other.group_map.items() for i, name in enumerate(names)}
    data, last = random_rollout(env, 12), other.reset()
    for t in range(12):
        for i, name in enumerate(env.agent_names):
            group, row = places[name]
            seen = last[group].exclude("action", "reward")[row]
            for key in seen.keys():
                assert torch.equal(seen[key], data[t]["bodies", key][i])
        for group, names in other.group_map.items():
            own = [env.agent_names.index(name) for name in names]
            last[group, "action"] = data[t]["bodies", "action"][own]
        _, last = other.step_and_maybe_reset(last)


def test_copies_are_worlds_of_their_own():
    env = make_env(LOTTERY, copies=2)
    flat = SoftRobotEnv(LOTTERY, MIXED, 6, material="reactive", num_threads=1)
    data, last = random_rollout(env, 12), flat.reset()
    for t in range(12):
        now = data[:, t]
        assert_same(last.exclude("action", "reward"), now["bodies"].exclude("action").reshape(6))
        last["action"] = now["bodies", "action"].reshape(6)
        _, last = flat.step_and_maybe_reset(last)


@pytest.mark.parametrize("copies", [None, 2])
def test_bodies_end_and_restart_alone(copies):
    env = make_env(LOTTERY, MIXED, copies)
    env = TransformedEnv(env, Compose(RewardSum(in_keys=[("bodies", "reward")]), StepCounter()))
    data = random_rollout(env, 40)
    data = data["next", "bodies"].reshape(-1, 40, 3)
    done, count = data["done"][..., 0], data["step_count"][..., 0]
    assert torch.equal(done, data["terminated"][..., 0])
    assert (done.any(-1) & ~done.all(-1)).any()  # one ends while another goes on
    for copy in range(len(done)):
        for body in range(3):
            ends = torch.nonzero(done[copy, :, body])[:, 0].tolist()
            lengths = np.diff([-1, *ends])
            assert ((lengths >= 2) & (lengths <= 8)).all()
            assert count[copy, ends, body].tolist() == lengths.tolist()
    torch.testing.assert_close(data["episode_reward"].double(), data["return"], atol=1e-6, rtol=1e-5)


def test_time_limit_truncates():
    data = random_rollout(make_env(replace(cm.tasks["Walker-v0"], time_limit=3)), 7)["next", "bodies"]
    assert data["truncated"].squeeze(-1).all(1).tolist() == [False, False, True] * 2 + [False]
    assert torch.equal(data["done"], data["truncated"])
    assert not data["terminated"].any()


def test_partial_reset_by_hand():
    env = make_env()
    last = random_rollout(env, 3)[-1]["next"]
    start = make_env().reset()["bodies", "com"]
    last["bodies", "_reset"] = torch.tensor([[False], [True], [False]])
    com = env.reset(last)["bodies", "com"]
    assert torch.equal(com[1], start[1])
    assert not torch.equal(com[0], start[0])


@pytest.mark.parametrize("copies", [None, 2])
def test_a_saved_state_replays_exactly(copies):
    env, other = make_env(LOTTERY, MIXED, copies), make_env(LOTTERY, MIXED, copies, seed=9)
    last = random_rollout(env, 5)[..., -1]["next"].exclude(("bodies", "reward"))
    env.rand_action(last)

    def follow(env):
        torch.manual_seed(1)
        rows, now = [], last.clone()
        for _ in range(15):
            step, now = env.step_and_maybe_reset(now)
            rows.append(step)
            env.rand_action(now)
        return torch.stack(rows)

    state = env.get_extra_state()
    copied, pickled = pickle.loads(pickle.dumps(env)), pickle.dumps(state)
    expected = follow(env)
    other.set_extra_state(state)
    env.load_state_dict({"_extra_state": pickle.loads(pickled)})
    for resumed in (other, env, copied):
        assert_same(follow(resumed), expected)


def test_seeds_decide_random_resets():
    first, same, other = (random_rollout(make_env(LOTTERY, seed=seed), 20) for seed in (3, 3, 4))
    assert_same(first, same)
    assert not torch.equal(first["next", "bodies", "done"], other["next", "bodies", "done"])
    env = make_env(LOTTERY)
    env.set_seed(3)
    assert_same(random_rollout(env, 20), first)


def test_steps_return_fresh_memory():
    env = make_env()
    seen = [env.rand_step(env.reset())]
    for _ in range(2):
        seen.append(env.rand_step(seen[-1]["next"]))
    for key in ("voxels", "occupancy", "com", "score"):
        assert len({step["next", "bodies", key].data_ptr() for step in seen}) == 3, key
    assert not torch.equal(seen[0]["next", "bodies", "voxels"], seen[1]["next", "bodies", "voxels"])


@pytest.mark.parametrize("copies", [None, 2])
def test_collector(copies):
    transforms = Compose(RewardSum(in_keys=[("bodies", "reward")]), StepCounter())
    env = TransformedEnv(make_env(LOTTERY, MIXED, copies), transforms)
    shape = (copies,) if copies else ()
    collector = Collector(env, None, frames_per_batch=20 * (copies or 1), total_frames=-1)
    data = next(iter(collector))
    collector.shutdown()
    assert data.shape == (*shape, 20)
    assert (data["next", "bodies", "done"].sum(-3) >= 2).all()


def test_several_populations_together():
    env = SerialEnv(2, lambda: make_env(LOTTERY))
    data = random_rollout(env, 12)
    assert data["next", "bodies", "done"].shape == (2, 12, 3, 1)
    assert (data["next", "bodies", "done"].sum(1) >= 1).all()
    env.close()


def make_multi_agent_networks(env):
    """An actor with two heads and a centralised critic, of TorchRL's own modules."""
    n_in, options = env.observation_spec["bodies", "flat"].shape[-1], {"n_agents": 3, "depth": 1, "num_cells": 16}
    ranges = {head: spec.space for head, spec in env.full_action_spec["bodies", "action"].items()}
    n_cells = ranges["actuation"].low.shape[-1]
    heads = TensorDictSequential(
        *(
            TensorDictModule(
                nn.Sequential(
                    MultiAgentMLP(n_in, 2 * n_cells, centralized=False, share_params=True, **options),
                    NormalParamExtractor(),
                ),
                in_keys=[("bodies", "flat")],
                out_keys=[("bodies", "params", head, "loc"), ("bodies", "params", head, "scale")],
            )
            for head in ranges
        )
    )
    actor = ProbabilisticActor(
        heads,
        in_keys=[("bodies", "params")],
        out_keys=[("bodies", "action", head) for head in ranges],
        distribution_class=CompositeDistribution,
        distribution_kwargs={
            "distribution_map": dict.fromkeys(ranges, TanhNormal),
            "name_map": {head: ("bodies", "action", head) for head in ranges},
            "extra_kwargs": {head: {"low": space.low[0], "high": space.high[0]} for head, space in ranges.items()},
        },
        return_log_prob=True,
    )
    actor.select_out_keys(*actor.out_keys[-4:])  # actions and log-probabilities
    critic = TensorDictModule(
        MultiAgentMLP(n_in, 1, centralized=True, share_params=True, **options),
        in_keys=[("bodies", "flat")],
        out_keys=[("bodies", "state_value")],
    )
    return actor, critic


def test_multi_agent_networks_learn_from_the_group():
    flatten = FlattenObservation(-2, -1, in_keys=[("bodies", "voxels")], out_keys=[("bodies", "flat")])
    env = TransformedEnv(make_env(LOTTERY), Compose(RewardSum(in_keys=[("bodies", "reward")]), flatten))
    check_env_specs(env)
    actor, critic = make_multi_agent_networks(env)
    names = ("value", "reward", "done", "terminated", "advantage", "value_target")
    keys = dict.fromkeys(names) | {name: ("bodies", name) for name in names} | {"value": ("bodies", "state_value")}
    gae = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    gae.set_keys(**keys)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=1e-3)
    loss.set_keys(**keys)
    optimizer = torch.optim.Adam(loss.parameters(), 1e-2)
    collector = Collector(env, actor, frames_per_batch=24, total_frames=48)
    for data in collector:
        assert data["next", "bodies", "reward"].shape == (24, 3, 1)
        assert torch.isfinite(data["next", "bodies", "episode_reward"]).all()
        with torch.no_grad():
            gae(data)
        for rows in data.split(12):
            out = loss(rows)
            total = out["loss_objective"] + out["loss_critic"] + out["loss_entropy"]
            assert torch.isfinite(total)
            optimizer.zero_grad()
            total.backward()
            assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in critic.parameters())
            optimizer.step()
        collector.update_policy_weights_()
    collector.shutdown()


@pytest.mark.parametrize("copies", [None, 2])
def test_render(copies):
    pytest.importorskip("pygame")
    env = make_env(copies=copies)
    pixels = env.render(width=160, height=80)
    assert pixels.dtype == torch.uint8
    assert pixels.shape[-1] == 3
    assert pixels.shape[:-3] == env.batch_size
    assert pixels.shape[-2] == 160
    env.rollout(4)
    assert not torch.equal(env.render(width=160, height=80), pixels)
    transform = PixelRenderTransform(out_keys=["pixels"], width=160, height=80)
    assert TransformedEnv(make_env(copies=copies), transform).rollout(2)["pixels"].shape[-1] == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"copies": 0}, "copies: got 0"),
        ({"material": "invariant", "stiffness": [np.ones((2, 3))]}, "3 bodies"),
        ({"group_map": {"a": ["body_0"], "b": ["body_1"]}}, "body_2"),
        ({"group_map": {"a": ["body_0", "body_7"], "b": ["body_1", "body_2"]}}, "body_7"),
        ({"group_map": {"a": ["body_0", "body_0"], "b": ["body_1", "body_2"]}}, "body_0"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises(ValueError, match=message):
        make_env(**options)


def test_bad_actions():
    env = make_env()
    last = env.rand_action(env.reset())
    last["bodies", "action", "actuation"][1, 1] = float("nan")
    with pytest.raises(ValueError, match="actuation: got NaN in world 1"):
        env.step(last)


@pytest.mark.parametrize("copies", [None, 2])
@pytest.mark.parametrize("groups", [None, "two"])
def test_an_action_that_is_not_made_of_its_keys_is_refused_with_them(copies, groups):
    env = make_env(copies=copies, group_map=GROUP_MAPS.get(groups))
    group, names = list(env.group_map.items())[-1]
    shape = [*env.batch_size, len(names), 12]
    good = env.rand_action(env.reset())
    for bad, got in (
        (good.clone().set((group, "action"), torch.ones(shape)), "a tensor"),
        (good.exclude((group, "action")), "None"),
        (good.exclude(group), "None"),
        (good.exclude((group, "action", "stiffness")), "'actuation'"),
        (good.clone().set((group, "action", "stiffness"), torch.ones(*shape[:-1], 4)), ".*4"),
    ):
        with pytest.raises(ValueError, match=rf"action: got {got}.*\('{group}', 'action', 'stiffness'\)") as error:
            env.step(bad)
        assert str(shape) in str(error.value)
    assert not env.engine.length.any()
    env.step(good)


def test_a_partial_step_advances_the_chosen_copies_only():
    env = make_env("Walker-v0", MIXED, copies=2, group_map=GROUP_MAPS["two"])
    torch.manual_seed(0)
    before = env.rand_action(env.reset())
    after = env.step(before.clone().set("_step", torch.tensor([False, True])))["next"]
    assert env.engine.length.tolist() == [0, 0, 0, 1, 1, 1]
    for group in ("a", "b"):
        assert torch.equal(after[group, "voxels"][0], before[group, "voxels"][0])
        assert not after[group, "reward"][0].any()
        assert after[group, "reward"][1].all()
