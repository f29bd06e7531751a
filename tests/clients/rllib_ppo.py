# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm", "ray[rllib]"]
# ///
"""RLlib: PPO in one process, in two, and on vectorised worlds; saved and restored; and on a population of bodies."""

import tempfile
from dataclasses import replace

import gymnasium as gym
import numpy as np
import ray
from ray.rllib.algorithms.ppo import PPO, PPOConfig
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

import evogymcm as cm
from evogymcm.envs import parallel_env

BODIES = ["HHH/V.V", "VVV/H.H", "HV/VH"]
WORLD = {"body": "HHH/V.V", "max_episode_steps": 20}


def make_world(config):
    """Returns one world; `config` holds the arguments of `gym.make`."""
    return gym.make("evogymcm:evogymcm/AreaMaximizer-v0", **config)


def make_bodies(config):
    """Returns a population as agents."""
    task = replace(cm.tasks["AreaMaximizer-v0"], time_limit=20)
    return ParallelPettingZooEnv(parallel_env(task, BODIES, flat=True))


def make_config(env, **config):
    training = {"train_batch_size_per_learner": 400, "minibatch_size": 80, "num_epochs": 5, "lr": 3e-3}
    config = PPOConfig().environment(env, env_config=config).training(**training).debugging(seed=0)
    return config.env_runners(num_env_runners=0, num_envs_per_env_runner=1)


def train(config, updates):
    """Returns the algorithm, and the mean return of the episodes of each update."""
    algorithm = config.build_algo()
    results = [algorithm.train()["env_runners"] for _ in range(updates)]
    # RLlib counts the step that resets a world into some episodes, where a runner has several; Gymnasium's own too.
    assert {round(result["episode_len_mean"]) for result in results} == {20}
    return algorithm, [result["episode_return_mean"] for result in results]


def main():
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    register_env("world", make_world)
    register_env("bodies", make_bodies)

    algorithm, returns = train(make_config("world", **WORLD), 8)
    assert returns[-1] > returns[0] + 0.05, f"mean returns {returns}"
    with tempfile.TemporaryDirectory() as folder:
        algorithm.save_to_path(folder)
        restored = PPO.from_checkpoint(folder)
    for name, values in algorithm.get_module().state_dict().items():
        assert (restored.get_module().state_dict()[name] == values).all(), name
    restored.stop()
    algorithm.stop()

    vectorised = make_config("evogymcm/AreaMaximizer-v0", **WORLD)
    vectorised.env_runners(num_envs_per_env_runner=8, gym_env_vectorize_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT)
    for config in (vectorised, make_config("world", **WORLD, material="reactive").env_runners(num_env_runners=1)):
        algorithm, returns = train(config, 2)
        assert np.isfinite(returns).all()
        algorithm.stop()

    config = make_config("bodies").multi_agent(policies={"shared"}, policy_mapping_fn=lambda *_, **__: "shared")
    algorithm, returns = train(config, 10)
    assert returns[-1] > returns[0] + 0.05, f"mean returns of the bodies together {returns}"
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
