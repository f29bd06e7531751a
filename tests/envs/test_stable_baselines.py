"""A client that knows nothing of us: Stable-Baselines3 trains on the Gymnasium form, unchanged."""

import gymnasium
import numpy as np
import pytest

import evogymcm  # noqa: F401 - registers the ids

stable_baselines3 = pytest.importorskip("stable_baselines3")


@pytest.mark.parametrize("material", ["invariant", "reactive"])
def test_ppo_trains(material):
    env = gymnasium.make("evogymcm/Walker-v0", body="Walk_Bot", material=material)
    model = stable_baselines3.PPO("MlpPolicy", env, n_steps=512, batch_size=128, n_epochs=2, seed=0, device="cpu")
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(2048)
    assert any((a != b).any() for a, b in zip(before, model.policy.parameters(), strict=True))
    observation, _ = env.reset(seed=1)
    rewards = []
    for _ in range(50):
        action, _ = model.predict(observation, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        assert not terminated
        assert not truncated
    assert info["return"] == pytest.approx(np.sum(rewards), abs=1e-12)
