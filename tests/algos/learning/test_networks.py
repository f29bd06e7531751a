"""Actor, critic and their input normalisation."""

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from evogymcm.algos import VoxelActor, make_actor, make_critic
from evogymcm.algos.learning.layers import N_INPUTS, NormalizedDense, pool, voxel_frame, voxel_inputs
from tests.algos.toy_env import SMALL, WIDE, ToyEnv


def _trained_like(env: ToyEnv) -> tuple[VoxelActor, torch.nn.Module]:
    """Networks whose outputs depend on everything, as after training."""
    torch.manual_seed(0)
    actor, critic = make_actor(env), make_critic(env)
    with torch.no_grad():
        actor.heads.weight.mul_(100)
    rollout = env.rollout(10)
    actor.observe(rollout)
    critic.observe(rollout)
    return actor, critic


def _embed(observation: TensorDict, shape: tuple[int, int], larger: tuple[int, int]) -> TensorDict:
    """The same bodies in a larger padded grid."""
    n = observation.batch_size[0]
    cells = (np.arange(shape[0])[:, None] * larger[1] + np.arange(shape[1])).ravel()
    padded = observation.clone()
    for key in ("voxels", "types", "occupancy", "actuators"):
        old = observation[key]
        new = torch.zeros(n, larger[0] * larger[1], *old.shape[2:], dtype=old.dtype)
        new[:, cells] = old
        padded[key] = new
    return padded


def test_outputs_do_not_depend_on_padding():
    env = ToyEnv(bodies=[SMALL, WIDE], num_worlds=4)
    actor, critic = _trained_like(env)
    observation = env.rollout(3)[:, -1]
    larger = (6, 5)
    padded = _embed(observation, env.grid_shape, larger)
    cells = (np.arange(env.grid_shape[0])[:, None] * larger[1] + np.arange(env.grid_shape[1])).ravel()
    small, large = actor.get_dist(observation), actor.get_dist(padded)
    for name in ("actuation", "stiffness"):
        torch.testing.assert_close(small.mode[name], large.mode[name][:, cells])
    action = small.mode
    same = TensorDict({name: torch.ones(4, 30) for name in action.keys()}, batch_size=[4])
    for name in action.keys():
        same[name][:, cells] = action[name]
    torch.testing.assert_close(small.log_prob(action), large.log_prob(same))
    torch.testing.assert_close(critic(observation)["state_value"], critic(padded)["state_value"])


@pytest.mark.parametrize("context", ["none", "body", "message", "attention"])
def test_prepared_samples_give_the_same(context):
    env = ToyEnv(bodies=[SMALL, WIDE], num_worlds=4)
    torch.manual_seed(0)
    actor, critic = make_actor(env, context=context), make_critic(env)
    with torch.no_grad():
        actor.heads.weight.mul_(100)
    samples = env.rollout(3, policy=actor).flatten()
    samples = samples.select(*actor.in_keys, "action", "action_log_prob")
    cells = samples["occupancy"].shape[-1]
    prepared = actor.prepare(samples.clone())
    most = samples["occupancy"].sum(-1).max()
    assert cells > most
    assert prepared["occupancy"].shape[-1] == (cells if context == "message" else most)
    torch.testing.assert_close(prepared["occupancy"].sum(-1), samples["occupancy"].sum(-1))
    torch.testing.assert_close(prepared["task"], samples["task"])
    torch.testing.assert_close(actor.get_dist(prepared).log_prob(prepared["action"]), samples["action_log_prob"])
    torch.testing.assert_close(critic(prepared)["state_value"], critic(samples)["state_value"])


@pytest.mark.parametrize("context", ["none", "body", "message", "attention"])
def test_networks_stay_on_their_device(context):
    """Torch's device "meta" computes nothing, and refuses tensors of another one as a GPU does."""
    env = ToyEnv(bodies=[SMALL, WIDE], num_worlds=4)
    actor, critic = make_actor(env, context=context).to("meta"), make_critic(env).to("meta")
    samples = env.rollout(3).select(*actor.in_keys).to("meta")
    actor.noise_correlation, actor.generator = 0.5, torch.Generator()
    for _ in range(2):
        out = critic(actor(samples.clone()))
    assert {value.device.type for value in out.values(True, True)} == {"meta"}
    actor.observe(samples)
    critic.observe(samples)


def test_outputs_do_not_depend_on_the_other_bodies_of_the_batch():
    env = ToyEnv(bodies=[SMALL, WIDE], num_worlds=4)
    actor, critic = _trained_like(env)
    observation = env.rollout(3)[:, -1]
    alone = observation[1:2]
    for name, mode in actor.get_dist(alone).mode.items():
        torch.testing.assert_close(mode, actor.get_dist(observation).mode[name][1:2])
    torch.testing.assert_close(critic(alone)["state_value"], critic(observation)["state_value"][1:2])


@pytest.mark.parametrize("material", ["reactive", "invariant"])
def test_untrained_actor_is_near_neutral(material):
    env = ToyEnv(material=material)
    actor = make_actor(env)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        action = actor(env.reset())["action"]
    assert set(action.keys()) == ({"actuation", "stiffness"} if material == "reactive" else {"actuation"})
    reset = env.reset()
    torch.testing.assert_close(action["actuation"], torch.where(reset["actuators"], 1.1, 1.0), atol=0.03, rtol=0)
    if material == "reactive":
        torch.testing.assert_close(action["stiffness"], torch.ones(4, 6), atol=0.03, rtol=0)


def test_actor_samples_by_default_and_log_prob_is_that_of_the_sample():
    env = ToyEnv()
    actor = make_actor(env)
    first, second = actor(env.reset()), actor(env.reset())
    assert (first["action", "actuation"] != second["action", "actuation"]).any()
    torch.testing.assert_close(first["action_log_prob"], actor.get_dist(first).log_prob(first["action"]))


def test_actor_refuses_unknown_heads():
    with pytest.raises(ValueError, match="colour"):
        VoxelActor(4, {"colour": (0.0, 1.0)})
    with pytest.raises(ValueError, match="heads"):
        VoxelActor(4, {})


def test_normalized_linear_equals_normalising_first():
    torch.manual_seed(0)
    frame = voxel_frame()
    layer = NormalizedDense(N_INPUTS, 8, frame)
    x = torch.randn(500, N_INPUTS) * torch.linspace(0.1, 5, N_INPUTS) + 3
    x[:, 30] = 2.0  # constant: shifted, not scaled
    for piece in x.split(123):
        layer.observe(piece)
    mapped = (x @ frame.T).double()
    std = mapped.std(0, correction=0)
    scaled = (mapped - mapped.mean(0)) / torch.where(std < 1e-3, 1.0, std)
    expected = torch.nn.functional.linear(scaled, layer.weight.double(), layer.bias.double())
    torch.testing.assert_close(layer(x).double(), expected, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(layer.mean, mapped.mean(0), atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(layer.var, mapped.var(0, correction=0), atol=1e-6, rtol=1e-5)


def test_normalisation_is_saved_and_not_trained():
    layer = NormalizedDense(3, 2)
    layer.observe(torch.randn(10, 3) + 5)
    copy = NormalizedDense(3, 2)
    copy.load_state_dict(layer.state_dict())
    torch.testing.assert_close(copy.mean, layer.mean)
    assert {name for name, _ in layer.named_parameters()} == {"weight", "bias"}


def test_voxel_frame_is_relative_to_the_voxels_centre():
    x = torch.zeros(N_INPUTS)
    x[:8] = torch.tensor([0.0, 1.0, 2.0, 1.0, 0.0, 0.0, 2.0, 0.0]) + 10  # TL TR BL BR; x, y
    mapped = voxel_frame() @ x
    torch.testing.assert_close(mapped[:2], torch.tensor([11.0, 10.5]))
    torch.testing.assert_close(mapped[2:10], torch.tensor([-1, 0.5, 1, 0.5, -1, -0.5, 1, -0.5]))


def test_pool_is_the_mean_over_the_mask():
    x = torch.arange(12.0).reshape(1, 4, 3)
    mask = torch.tensor([[True, False, True, False]])
    torch.testing.assert_close(pool(x, mask), x[:, ::2].mean(1))
    assert (pool(x, torch.zeros(1, 4, dtype=torch.bool)) == 0).all()


def test_initial_std_is_what_was_asked_for():
    actor = make_actor(ToyEnv(), initial_std=0.7)
    assert actor.log_std.exp().tolist() == pytest.approx([0.7, 0.7])
    assert actor.log_std[0].item() == pytest.approx(math.log(0.7))


def test_types_enter_one_hot():
    observation = ToyEnv(bodies=[SMALL, WIDE], num_worlds=2).reset()
    inputs = voxel_inputs(observation)
    torch.testing.assert_close(inputs[..., :20], observation["voxels"])
    one_hot = inputs[..., 20:].reshape(*inputs.shape[:2], 5, 4)
    codes = one_hot @ torch.arange(1.0, 5.0)
    torch.testing.assert_close(codes, observation["types"].float())
    assert (one_hot.sum(-1) == (observation["types"] > 0)).all()
