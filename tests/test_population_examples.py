"""How the example of PPO over a population sees its rollouts."""

import importlib.util
import sys
from pathlib import Path

import pytest
import torch

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.fixture
def example(monkeypatch):
    """The example's module."""
    spec = importlib.util.spec_from_file_location("example_population_ppo", EXAMPLES / "population_ppo.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


def test_a_rollout_by_body_is_that_of_single_worlds(example):
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
