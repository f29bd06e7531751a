# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm[sb3]"]
# ///
"""Stable-Baselines3 on the batched simulator: PPO on normalised worlds, whose statistics are saved and read."""

import tempfile

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

from evogymcm.envs import SB3VecEnv


def make_env(num_envs):
    return SB3VecEnv("AreaMaximizer-v0", "HHH/V.V", num_envs, max_episode_steps=20)


def train(steps):
    env = VecNormalize(make_env(16))
    model = PPO("MlpPolicy", env, n_steps=20, batch_size=64, n_epochs=5, learning_rate=3e-3, seed=0, device="cpu")
    return model.learn(steps)


def evaluate(model, worlds):
    worlds.training = worlds.norm_reward = False
    returns, lengths = evaluate_policy(model, worlds, 4, return_episode_rewards=True)
    assert lengths == [20] * 4
    return np.mean(returns)


def main():
    model = train(8000)
    with tempfile.TemporaryDirectory() as folder:
        model.save(f"{folder}/ppo")
        model.get_vec_normalize_env().save(f"{folder}/normal.pkl")
        worlds = VecNormalize.load(f"{folder}/normal.pkl", make_env(4))
        loaded = PPO.load(f"{folder}/ppo", device="cpu")
    before, after = evaluate(train(0), VecNormalize(make_env(4))), evaluate(loaded, worlds)
    assert after > before + 0.1, f"return {before} before, {after} after"
    assert {episode["l"] for episode in model.ep_info_buffer} == {20}

    first, again = (train(320).policy.state_dict() for _ in range(2))
    assert all((first[name] == again[name]).all() for name in first), "one seed gave two policies"


if __name__ == "__main__":
    main()
