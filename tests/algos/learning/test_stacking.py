"""Stacked networks are the single ones side by side; weights move between them and onto other bodies."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

from evogymcm.algos import PPOConfig, PPOLearner, RunFolder, Trainer, load_actor, make_actor, make_critic
from evogymcm.algos.learning import PerDesign, by_design, by_world, stack_states, take_state
from evogymcm.algos.learning.ppo import clip_gradients
from evogymcm.envs import SoftRobotEnv
from tests.algos.toy_env import SMALL, WIDE, ToyEnv

BODIES = [SMALL, WIDE, SMALL[:, ::-1].copy()]
CONFIG = PPOConfig(num_worlds=6, rollout_steps=12, epochs=2, minibatch=8, hidden=8, target_kl=0.0)
CONTEXTS = ("none", "body", "message", "attention")


def _networks(env, seed, **options):
    """Three singles and their stack, with outputs that depend on everything."""
    torch.manual_seed(seed)
    kinds = {make_actor: options, make_critic: {}}
    singles = {make: [make(env, 8, **given) for _ in BODIES] for make, given in kinds.items()}
    stacks = {make: make(env, 8, copies=len(BODIES), **given) for make, given in kinds.items()}
    with torch.no_grad():
        for actor in singles[make_actor]:
            actor.heads.weight.mul_(30)
            actor.log_std.uniform_(-1, 0)
    for make, stack in stacks.items():
        stack.load_state_dict(stack_states([single.state_dict() for single in singles[make]]))
    return singles[make_actor], singles[make_critic], stacks[make_actor], stacks[make_critic]


def _rollout(env, policy):
    torch.manual_seed(3)
    with torch.no_grad():
        return env.rollout(12, policy, break_when_any_done=False)


def test_rows_of_designs_and_of_worlds():
    worlds = torch.arange(6)  # worlds 0 and 3 hold design 0
    assert by_design(worlds, 3).tolist() == [[0, 3], [1, 4], [2, 5]]
    assert by_world(by_design(worlds, 3)).tolist() == worlds.tolist()


@pytest.mark.parametrize("context", CONTEXTS)
def test_stacked_policies_are_the_single_ones(context):
    env = ToyEnv(bodies=BODIES, num_worlds=6)
    actors, critics, actor, critic = _networks(env, 0, context=context)
    observation = _rollout(env, PerDesign(actor, 3))[:, 5]
    together = by_design(observation, 3)
    dist, values = actor.get_dist(together), critic(together.clone())["state_value"]
    for design in range(3):
        alone = observation[design::3]
        single = actors[design].get_dist(alone)
        for head, mode in single.mode.items():
            torch.testing.assert_close(dist.mode[head][design], mode)
        action = single.mode
        torch.testing.assert_close(dist.heads["actuation"].log_prob(dist.mode["actuation"])[design],
                                   single.heads["actuation"].log_prob(action["actuation"]))  # fmt: skip
        torch.testing.assert_close(values[design], critics[design](alone.clone())["state_value"])


def test_stacked_policies_act_in_their_own_worlds():
    env = ToyEnv(bodies=BODIES, num_worlds=6)
    _, _, actor, _ = _networks(env, 0)
    observation = env.reset()
    torch.manual_seed(0)
    acted = PerDesign(actor, 3)(observation.clone())
    dist = actor.get_dist(by_design(observation, 3))
    expected = by_world(dist.log_prob(by_design(acted["action"], 3)))
    torch.testing.assert_close(acted["action_log_prob"], expected)


def test_learning_side_by_side_is_learning_alone():
    env = ToyEnv(bodies=BODIES, num_worlds=6)
    actors, critics, actor, critic = _networks(env, 1)
    rollout = _rollout(env, PerDesign(actor, 3))
    together = PPOLearner(actor, critic, CONFIG)
    torch.manual_seed(7)
    together.update(rollout, 0.5)
    for design in range(3):
        alone = PPOLearner(actors[design], critics[design], CONFIG)
        torch.manual_seed(7)
        alone.update(rollout[design::3], 0.5)
        for name, network in (("actor", actors[design]), ("critic", critics[design])):
            learnt = take_state(together.state_dict()[name], design)
            for key, values in network.state_dict().items():
                torch.testing.assert_close(learnt[key], values, atol=2e-5, rtol=1e-4, msg=f"{name} {key}")


def test_normalisation_is_each_designs_own():
    env = ToyEnv(bodies=BODIES, num_worlds=6)
    actors, _, actor, _ = _networks(env, 2)
    rollout = _rollout(env, PerDesign(actor, 3))
    actor.observe(by_design(rollout, 3))
    for design in range(3):
        actors[design].observe(rollout[design::3])
        for key, values in actors[design].state_dict().items():
            torch.testing.assert_close(take_state(actor.state_dict(), design)[key], values)


def test_a_gradient_that_is_not_finite_stops_no_other():
    layer = torch.nn.Module()
    layer.weight = torch.nn.Parameter(torch.zeros(3, 2))
    layer.weight.grad = torch.tensor([[3.0, 4.0], [float("inf"), 1.0], [0.3, 0.4]])
    assert clip_gradients(layer, 1.0, 3) == 5.0
    torch.testing.assert_close(layer.weight.grad, torch.tensor([[0.6, 0.8], [0.0, 0.0], [0.3, 0.4]]))


TINY = PPOConfig(total_steps=960, num_worlds=6, rollout_steps=20, epochs=2, minibatch=40, hidden=16, eval_interval=240)
make_toy = functools.partial(ToyEnv, bodies=BODIES)


@pytest.fixture(scope="module")
def independent(tmp_path_factory):
    """A run of independent policies: its folder and its result."""
    run = RunFolder(tmp_path_factory.mktemp("independent") / "run", {})
    return run, Trainer(make_toy, replace(TINY, sharing="independent")).train(run=run)


def test_independent_policies_train_and_are_kept_each_at_its_best(independent):
    run, result = independent
    assert result.final.score.shape == (3,)
    best, final = run.load("best"), run.load("final")
    assert best["score"].shape == (3,)
    assert (best["score"].numpy() >= result.final.score).all()
    env = ToyEnv(bodies=BODIES, num_worlds=3)
    for design in range(3):
        one = load_actor(final, design)
        observation = env.reset()
        expected = PerDesign(result.actor, 3)(observation.clone())
        mode = one.get_dist(observation[design : design + 1]).mode
        assert mode["actuation"].shape == expected["action", "actuation"][design : design + 1].shape


def test_independent_policies_resume_exactly(independent, tmp_path):
    config = replace(TINY, sharing="independent")
    (other, whole), calls = independent, iter(range(100))
    Trainer(make_toy, config).train(run=RunFolder(tmp_path / "run", {}), should_stop=lambda: next(calls) >= 3)
    run = RunFolder(tmp_path / "run", {}, resume=True)
    resumed = Trainer(make_toy, config).train(run=run)
    assert all(torch.equal(a, b) for a, b in zip(whole.actor.parameters(), resumed.actor.parameters(), strict=True))
    for name in ("best", "final"):
        resumed, whole = (folder.load(name)["actor"] for folder in (run, other))
        assert all(torch.equal(resumed[key], whole[key]) for key in whole)


def test_independent_sharing_needs_whole_rounds():
    with pytest.raises(ValueError, match=r"num_worlds: got 7, .* 3 designs"):
        Trainer(make_toy, replace(TINY, sharing="independent", num_worlds=7)).train()
    with pytest.raises(ValueError, match="sharing: got 'both'"):
        replace(TINY, sharing="both")


def test_warm_starts(tmp_path):
    run = RunFolder(tmp_path / "run", {})
    first = Trainer(functools.partial(ToyEnv, bodies=SMALL), TINY).train(run=run)
    checkpoint = run.load("final")
    one_update = replace(TINY, total_steps=120)
    again = Trainer(functools.partial(ToyEnv, bodies=SMALL), one_update).train(initial=checkpoint)
    assert again.rows[0]["score"] == first.rows[-1]["score"]  # it starts where the other ended
    other = Trainer(functools.partial(ToyEnv, bodies=WIDE), one_update).train(initial=checkpoint)
    assert other.finished
    many = Trainer(make_toy, replace(one_update, sharing="independent")).train(initial=checkpoint)
    assert many.rows[0]["score"] != 0


@pytest.mark.parametrize("sharing", ["shared", "independent"])
def test_the_plain_network_trains_on_the_flat_observation(sharing):
    make = functools.partial(SoftRobotEnv, "Walker-v0", bodies="HVH/S.R", material="reactive", num_threads=1)
    config = PPOConfig(total_steps=64, num_worlds=4, rollout_steps=8, hidden=8, network="mlp", sharing=sharing)
    result = Trainer(make, replace(config, eval_interval=0)).train()
    assert np.isfinite(result.final.score).all()
    env = make(num_worlds=2)
    action = make_actor(env, network="mlp")(env.reset())["action"]
    assert action["stiffness"].shape == (2, 6)
    assert (action["actuation"][:, 4] == 1).all()  # an empty cell idles


def test_the_plain_network_refuses_mixed_bodies():
    env = SoftRobotEnv("Walker-v0", ["HVH/S.R", "HH"], num_threads=1)
    with pytest.raises(ValueError, match="flat observation"):
        make_actor(env, network="mlp")
    with pytest.raises(ValueError, match="network: got 'cnn'"):
        make_critic(env, network="cnn")
