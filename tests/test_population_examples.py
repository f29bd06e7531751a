"""How the example of PPO over a population sees its rollouts."""

import torch

from tests.examples import load_example


def test_a_rollout_by_body_is_that_of_single_worlds():
    example = load_example("population_ppo")
    env = example.population_env("Walker-v0", ["HVH/S.R", "RHSV/H..H"], material="reactive")
    actor = example.make_actor(env.worlds)
    torch.manual_seed(0)
    with torch.no_grad():
        rollout = example.by_body(env.rollout(5, example.OnBodies(actor)))
        torch.manual_seed(0)
        expected = env.worlds.rollout(5, actor)
    assert rollout.shape == expected.shape == (2, 5)
    for key in expected.keys(True, True):
        assert torch.equal(rollout[key], expected[key]), key
