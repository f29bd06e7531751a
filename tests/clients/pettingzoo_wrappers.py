# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm[sb3]", "supersuit"]
# ///
"""PettingZoo: its tests, conversions and wrappers, on a population whose bodies end one by one."""

import math
import warnings
from dataclasses import replace

import numpy as np
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
from pettingzoo.utils import aec_to_parallel, parallel_to_aec, wrappers

import evogymcm as cm
from evogymcm.envs import parallel_env

TASK = replace(cm.tasks["Walker-v0"], goal_x=0.3, time_limit=20)
BODIES = ["HHH/V.V", "HHHHH/V...V", "HV/VH"]


def make_env(flat=True):
    return parallel_env(TASK, BODIES, flat=flat)


def play(env, seed):
    """Returns the rewards of each agent in one episode of random actions, agent by agent."""
    env.reset(seed=seed)
    for i, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(i)
    rewards = {agent: [] for agent in env.possible_agents}
    for agent in env.agent_iter():
        observation, reward, terminated, truncated, info = env.last()
        assert env.observation_space(agent).contains(observation)
        rewards[agent].append(reward)
        assert math.isclose(info["return"], sum(rewards[agent]), abs_tol=1e-12)
        env.step(None if terminated or truncated else env.action_space(agent).sample())
    return rewards


def main():
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=UserWarning)  # Dict spaces are rare among PettingZoo's own
        parallel_api_test(make_env(flat=False), num_cycles=50)
    parallel_api_test(make_env(), num_cycles=50)
    parallel_seed_test(make_env, num_cycles=10)
    api_test(parallel_to_aec(make_env()), num_cycles=50)

    env = wrappers.OrderEnforcingWrapper(wrappers.ClipOutOfBoundsWrapper(parallel_to_aec(make_env())))
    rewards = play(env, 0)
    assert [len(of_body) for of_body in rewards.values()] == [21, 2, 21], "the second begins beyond the goal"
    assert play(env, 0) == rewards, "one seed gave two episodes"

    episodes = wrappers.MultiEpisodeParallelEnv(aec_to_parallel(parallel_to_aec(make_env())), num_episodes=2)
    episodes.reset(seed=0)
    steps = 0
    while episodes.agents:
        rewards = episodes.step({agent: episodes.action_space(agent).sample() for agent in episodes.agents})[1]
        assert np.isfinite(list(rewards.values())).all()
        steps += 1
    assert steps == 40


if __name__ == "__main__":
    main()
