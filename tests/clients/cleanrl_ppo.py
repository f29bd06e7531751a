# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm"]
# ///
"""PPO in one file, in the manner of CleanRL: one loop over Gymnasium's vector environment and its wrappers."""

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers import vector as wrappers
from torch import nn, optim

import evogymcm  # noqa: F401 - registers the ids

NUM_ENVS, STEPS, EPOCHS, MINIBATCH = 16, 42, 5, 128
GAMMA, TRACE, CLIP = 0.99, 0.95, 0.2


class Agent(nn.Module):
    def __init__(self, sees, acts):
        super().__init__()
        self.mean, self.value = (nn.Sequential(nn.Linear(sees, 64), nn.Tanh(), nn.Linear(64, out)) for out in (acts, 1))
        self.log_std = nn.Parameter(torch.zeros(acts))

    def forward(self, seen):
        return torch.distributions.Normal(self.mean(seen), self.log_std.exp()), self.value(seen).squeeze(-1)


def train(updates, seed=1):
    """Returns the mean return of the episodes that ended in each update, and the agent."""
    torch.manual_seed(seed)
    envs = gym.make_vec("evogymcm/AreaMaximizer-v0", num_envs=NUM_ENVS, body="HHH/V.V", max_episode_steps=20)
    envs = wrappers.RecordEpisodeStatistics(envs)
    envs = wrappers.RescaleAction(envs, -1.0, 1.0)
    envs = wrappers.ClipAction(envs)
    envs = wrappers.NormalizeObservation(envs)
    envs = wrappers.NormalizeReward(envs, gamma=GAMMA)
    (sees,), (acts,) = envs.single_observation_space.shape, envs.single_action_space.shape
    agent = Agent(sees, acts)
    optimiser = optim.Adam(agent.parameters(), lr=1e-3, eps=1e-5)

    seen = torch.zeros(STEPS, NUM_ENVS, sees)
    taken = torch.zeros(STEPS, NUM_ENVS, acts)
    log_probs, values, rewards = (torch.zeros(STEPS, NUM_ENVS) for _ in range(3))
    goes_on, counts = (torch.zeros(STEPS, NUM_ENVS, dtype=torch.bool) for _ in range(2))
    history = []
    observations, _ = envs.reset(seed=seed)
    ended = np.zeros(NUM_ENVS, bool)
    for _ in range(updates):
        returns = []
        for t in range(STEPS):
            seen[t] = torch.as_tensor(observations)
            with torch.no_grad():
                policy, values[t] = agent(seen[t])
                taken[t] = policy.sample()
                log_probs[t] = policy.log_prob(taken[t]).sum(-1)
            counts[t] = torch.as_tensor(~ended)  # False where this step only resets
            observations, reward, terminated, truncated, infos = envs.step(taken[t].numpy())
            ended = terminated | truncated
            rewards[t], goes_on[t] = torch.as_tensor(reward), torch.as_tensor(~ended)
            if "episode" in infos:
                assert (infos["episode"]["l"][infos["_episode"]] == 20).all()
                returns.extend(infos["episode"]["r"][infos["_episode"]])
        history.append(np.mean(returns))

        with torch.no_grad():
            following = agent(torch.as_tensor(observations, dtype=torch.float32))[1]
        advantages, trace = torch.zeros_like(rewards), torch.zeros(NUM_ENVS)
        for t in reversed(range(STEPS)):
            surprise = rewards[t] + GAMMA * following * goes_on[t] - values[t]
            trace = surprise + GAMMA * TRACE * goes_on[t] * trace
            advantages[t], following = trace, values[t]
        wanted = advantages + values

        rows = counts.flatten().nonzero().squeeze(-1)
        batch = [data.flatten(0, 1) for data in (seen, taken, log_probs, advantages, wanted)]
        for _ in range(EPOCHS):
            for some in rows[torch.randperm(len(rows))].split(MINIBATCH):
                s, a, old, advantage, target = (data[some] for data in batch)
                policy, value = agent(s)
                ratio = (policy.log_prob(a).sum(-1) - old).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                gain = torch.min(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage).mean()
                optimiser.zero_grad()
                (0.5 * (value - target).pow(2).mean() - gain).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimiser.step()
    envs.close()
    return history, agent


def main():
    history, agent = train(12)
    assert history[-1] > history[0] + 0.05, f"mean returns {history}"
    assert all(parameter.isfinite().all() for parameter in agent.parameters())
    assert train(2)[0] == train(2)[0] == history[:2], "one seed gave two runs"


if __name__ == "__main__":
    main()
