# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm", "skrl[torch]>=2.1"]
# ///
"""skrl: PPO on the batched simulator, IPPO and MAPPO on a population of bodies, by its runner and trainer."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import torch
from skrl.envs.wrappers.torch import MultiAgentEnvWrapper, wrap_env
from skrl.utils.runner.torch import Runner

import evogymcm as cm
from evogymcm.envs import parallel_env

BODIES = ["HHH/V.V", "VVV/H.H", "HV/VH"]


def make_runner(env, agent, timesteps):
    """Returns skrl's runner of networks with one hidden layer."""

    def network(model, output, **options):
        sees = "STATES" if (agent, output) == ("MAPPO", "ONE") else "OBSERVATIONS"
        layers = [{"name": "net", "input": sees, "layers": [64], "activations": "tanh"}]
        return {"class": model, "network": layers, "output": output, **options}

    settings = {
        "rollouts": 40,
        "learning_epochs": 5,
        "mini_batches": 4,
        "learning_rate": 3e-3,
        "experiment": {"write_interval": 0, "checkpoint_interval": 0},
    }
    if isinstance(env, MultiAgentEnvWrapper):  # skrl 2.1.1 takes its own default, {}, for a dict that lacks the agents
        settings["learning_rate_scheduler_kwargs"] = {name: {} for name in env.possible_agents}
    return Runner(
        env,
        {
            "seed": 0,
            "models": {
                "separate": True,
                "policy": network("GaussianMixin", "ACTIONS", clip_actions=True),
                "value": network("DeterministicMixin", "ONE"),
            },
            "memory": {"class": "RandomMemory", "memory_size": -1},
            "agent": {"class": agent, **settings},
            "trainer": {
                "class": "SequentialTrainer",
                "timesteps": timesteps,
                "headless": True,
                "disable_progressbar": True,
            },
        },
    )


def train_worlds(timesteps):
    """Returns the networks of PPO on 16 worlds, and the mean return of an episode before training and after it."""
    envs = gym.make_vec("evogymcm/AreaMaximizer-v0", num_envs=16, body="HHH/V.V", max_episode_steps=20)
    env = wrap_env(gym.wrappers.vector.DtypeObservation(envs, np.float32))  # which skrl's networks are
    runner = make_runner(env, "PPO", timesteps)
    before = play(env, runner.agent)
    runner.run("train")
    return runner.agent.models, before, play(env, runner.agent)


def train_bodies(agent, timesteps):
    """Returns the mean return of an episode of three bodies before training and after it."""
    task = replace(cm.tasks["AreaMaximizer-v0"], time_limit=20)
    env = wrap_env(parallel_env(task, BODIES, flat=True))
    runner = make_runner(env, agent, timesteps)
    before = play(env, runner.agent)
    runner.run("train")
    return before, play(env, runner.agent)


def play(env, agent):
    """Returns the mean return of an episode in all worlds, or of all bodies, by the means of the policies."""
    observations, _ = env.reset()
    total = 0.0
    for step in range(20):
        with torch.no_grad():
            outputs = agent.act(observations, env.state(), timestep=step, timesteps=20)[1]
        if isinstance(env, MultiAgentEnvWrapper):
            actions = {name: of_body["mean_actions"] for name, of_body in outputs.items()}
        else:
            actions = outputs["mean_actions"]
        observations, rewards, _, truncated, _ = env.step(actions)
        rewards, truncated = (
            np.mean(list(values.values())) if isinstance(values, dict) else values.float().mean()
            for values in (rewards, truncated)
        )
        total += float(rewards)
    assert truncated == 1
    return total


def main():
    models, before, after = train_worlds(400)
    assert after > before + 0.05, f"PPO: return {before} before, {after} after"
    again = train_worlds(400)[0]
    for name, values in models["policy"].state_dict().items():
        assert torch.equal(values, again["policy"].state_dict()[name]), "one seed gave two policies"
    for agent in ("IPPO", "MAPPO"):
        before, after = train_bodies(agent, 800)
        assert after > before + 0.05, f"{agent}: return {before} before, {after} after"


if __name__ == "__main__":
    main()
