# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm[sb3]"]
# ///
"""Stable-Baselines3 on one environment: its checker, PPO, SAC that is saved and goes on, evaluation."""

import tempfile

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import evogymcm  # noqa: F401 - registers the ids


def make_env(**options):
    env = gym.make("evogymcm/AreaMaximizer-v0", body="HHH/V.V", max_episode_steps=20, **options)
    return Monitor(gym.wrappers.RescaleAction(env, -1.0, 1.0))  # a range that SB3 recommends; it works without, too


def train_ppo(steps):
    model = PPO("MlpPolicy", make_env(), n_steps=320, batch_size=64, learning_rate=3e-3, seed=0, device="cpu")
    return model.learn(steps)


def main():
    check_env(make_env(material="reactive").unwrapped)

    env = make_env()
    before, spread = evaluate_policy(train_ppo(0), env, 2)
    assert spread == 0, "the task draws nothing at random, and neither does the policy's mean"
    model = train_ppo(3200)
    after, _ = evaluate_policy(model, env, 2)
    assert after > before + 0.05, f"return {before} before, {after} after"
    assert {episode["l"] for episode in model.ep_info_buffer} == {20}

    first, again = (train_ppo(320).policy.state_dict() for _ in range(2))
    assert all((first[name] == again[name]).all() for name in first), "one seed gave two policies"

    model = SAC("MlpPolicy", make_env(material="reactive"), learning_starts=40, batch_size=32, seed=0, device="cpu")
    model.learn(80)
    with tempfile.TemporaryDirectory() as folder:
        model.save(f"{folder}/sac")
        loaded = SAC.load(f"{folder}/sac", env=make_env(material="reactive"), device="cpu")
    observation, _ = make_env(material="reactive").reset(seed=0)
    np.testing.assert_array_equal(*(m.predict(observation, deterministic=True)[0] for m in (model, loaded)))
    loaded.learn(40, reset_num_timesteps=False)
    assert loaded.num_timesteps == 120


if __name__ == "__main__":
    main()
