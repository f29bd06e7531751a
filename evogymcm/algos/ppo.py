"""Proximal policy optimisation, Schulman et al., 2017 (clipped objective), with generalised advantage estimation."""

from dataclasses import dataclass, fields

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from evogymcm.algos.actor import VoxelActor
from evogymcm.algos.critic import VoxelCritic

__all__ = ["PPOConfig", "PPOLearner"]


_MAY_BE_ZERO = {
    "decay_learning_rate",
    "gamma",
    "gae_lambda",
    "entropy_weight",
    "value_weight",
    "target_kl",
    "eval_interval",
    "seed",
}
_LOGGED = {
    "loss_policy": "loss_objective",
    "loss_value": "loss_critic",
    "entropy": "entropy",
    "kl": "kl_approx",
    "clipped": "clip_fraction",
}


@dataclass(frozen=True)
class PPOConfig:
    """Everything that a training run depends on besides its environment.

    Attributes:
        total_steps: env-steps of all worlds together, rounded up to whole rollouts.
        num_worlds: worlds simulated together.
        rollout_steps: env-steps per world between two updates.
        epochs: passes over a rollout per update.
        minibatch: env-steps per gradient step.
        learning_rate: of Adam, at the start.
        decay_learning_rate: whether it falls linearly to zero at the end.
        gamma: discount per env-step.
        gae_lambda: of the advantage estimate.
        clip: how far the probability ratio may move from 1.
        entropy_weight: of the exploration bonus (entropy before squashing, summed over voxels and heads).
        value_weight: of the critic's squared error.
        max_grad_norm: limit of the gradient's norm, of actor and critic each.
        target_kl: an update stops after an epoch that moved the policy further than 1.5 times this; 0 for no limit.
        reward_scale: factor on rewards within the learner; scores and returns are never scaled.
        hidden: width of the networks.
        initial_std: exploration at the start, standard deviation before squashing.
        final_std: the most exploration at the end; the limit falls geometrically from `initial_std`. A policy that has
            only ever acted with much noise may get stuck without it.
        eval_interval: env-steps between evaluations; 0 for only the untrained and the final policy.
        eval_worlds: worlds in an evaluation: the number of bodies, 1 for a single one.
        seed: of weights, exploration and environments.
        torch_threads: threads of torch while training.
    """

    total_steps: int = 1_000_000
    num_worlds: int = 64
    rollout_steps: int = 32
    epochs: int = 4
    minibatch: int = 512
    learning_rate: float = 1e-3
    decay_learning_rate: bool = True
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy_weight: float = 1e-4
    value_weight: float = 0.5
    max_grad_norm: float = 0.5
    target_kl: float = 0.03
    reward_scale: float = 10.0
    hidden: int = 64
    initial_std: float = 1.0
    final_std: float = 0.3
    eval_interval: int = 50_000
    eval_worlds: int = 1
    seed: int = 0
    torch_threads: int = 1

    def __post_init__(self) -> None:
        for field in fields(self):
            value, may_be_zero = getattr(self, field.name), field.name in _MAY_BE_ZERO
            if value < 0 or (value == 0 and not may_be_zero):
                raise ValueError(
                    f"{field.name}: got {value}, must {'not be negative' if may_be_zero else 'be positive'}"
                )
        if self.gamma > 1 or self.gae_lambda > 1:
            raise ValueError(f"gamma, gae_lambda: got {self.gamma}, {self.gae_lambda}, must be at most 1")

    @property
    def frames_per_update(self) -> int:
        """Env-steps of one rollout, all worlds together."""
        return self.num_worlds * self.rollout_steps


class PPOLearner:
    """Improves an actor and a critic from rollouts; never sees an environment.

    Args:
        actor: the policy, changed in place.
        critic: the state value, changed in place.
        config: settings of the run.
    """

    def __init__(self, actor: VoxelActor, critic: VoxelCritic, config: PPOConfig) -> None:
        self.actor, self.critic, self.config = actor, critic, config
        self.loss = ClipPPOLoss(
            actor,
            critic,
            clip_epsilon=config.clip,
            entropy_coeff=config.entropy_weight,
            critic_coeff=config.value_weight,
            loss_critic_type="l2",
            functional=False,
        )
        self.gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None, average_gae=True)
        parameters = [*actor.parameters(), *critic.parameters()]
        self.optimizer = torch.optim.Adam(parameters, config.learning_rate, eps=1e-5, fused=True)

    def update(self, rollout: TensorDictBase, remaining: float = 1.0) -> dict[str, float]:
        """Improves the networks from one rollout and returns what to log.

        Args:
            rollout: what a collector returns, batch size (worlds, steps).
            remaining: share of the run that is left, from 1 to 0; scales a decaying learning rate and the limit of
                exploration.

        Returns:
            Means over the update's last epoch: losses, entropy, approximate KL divergence, clipped share; the number of
            epochs done; the share of the value's variance that the critic explained before the update.
        """
        config = self.config
        rate = config.learning_rate * (remaining if config.decay_learning_rate else 1.0)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        samples, explained = self._samples(rollout)
        for epoch in range(1, config.epochs + 1):  # noqa: B007  (used after the loop)
            shuffled = samples[torch.randperm(len(samples))]
            logged = torch.stack([self._step(batch) for batch in shuffled.split(config.minibatch)]).mean(0)
            stats = dict(zip(_LOGGED, logged.tolist(), strict=True))
            if config.target_kl and stats["kl"] > 1.5 * config.target_kl:
                break
        # Between rollouts, so that the next one is collected by the policy as it then is.
        self.actor.limit_std(config.initial_std**remaining * config.final_std ** (1 - remaining))
        return {**stats, "epochs": epoch, "explained_variance": explained, "learning_rate": rate}

    def _samples(self, rollout: TensorDictBase) -> tuple[TensorDict, float]:
        """Flat training samples with advantages, and the explained variance of the critic."""
        values, next_values = self._values(rollout)
        outcome = rollout.select(("next", "done"), ("next", "terminated"))
        outcome["state_value"], outcome["next", "state_value"] = values, next_values
        outcome["next", "reward"] = rollout["next", "reward"] * self.config.reward_scale
        with torch.no_grad():
            self.gae(outcome)  # over (worlds, steps): time must still be the last dimension
        targets = outcome["value_target"]
        explained = 1 - (targets - values).var() / targets.var().clamp_min(1e-12)
        samples = rollout.select(*self.actor.in_keys, *self.critic.in_keys, "action", "action_log_prob")
        samples["advantage"], samples["value_target"] = outcome["advantage"], targets
        return samples.reshape(-1), explained.item()

    @torch.no_grad()
    def _values(self, rollout: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Values of all states and of the states that followed, before any reset: two of (worlds, steps, 1)."""
        values = self._value(rollout.select(*self.critic.in_keys))
        following = torch.cat([values[:, 1:], values[:, -1:]], 1)
        is_cut = rollout["next", "done"].squeeze(-1).clone()  # the next row is no continuation: ask the critic
        is_cut[:, -1] = True
        following[is_cut] = self._value(rollout["next"].select(*self.critic.in_keys)[is_cut])
        return values, following

    def _value(self, observations: TensorDictBase) -> Tensor:
        """Critic's values in pieces that stay in the processor's cache."""
        pieces = [self.critic(piece)["state_value"] for piece in observations.reshape(-1).split(1024)]
        return torch.cat(pieces).reshape(*observations.batch_size, 1)

    def _step(self, batch: TensorDictBase) -> Tensor:
        """One gradient step; returns the numbers that `update` logs, in `_LOGGED`'s order."""
        out = self.loss(batch)
        self.optimizer.zero_grad()
        (out["loss_objective"] + out["loss_critic"] + out["loss_entropy"]).backward()
        norms = [
            nn.utils.clip_grad_norm_(network.parameters(), self.config.max_grad_norm)
            for network in (self.actor, self.critic)
        ]
        if torch.stack(norms).isfinite().all():  # a probability ratio may overflow; one such step would be the end
            self.optimizer.step()
        return torch.stack([out[key].detach() for key in _LOGGED.values()])

    def state_dict(self) -> dict[str, dict]:
        """Returns the networks (with their normalisation) and the optimiser's state."""
        return {
            "actor": self.actor.state_dict(),
            "critic": self.critic.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }

    def load_state_dict(self, state: dict[str, dict]) -> None:
        """Restores what `state_dict` returned."""
        self.actor.load_state_dict(state["actor"])
        self.critic.load_state_dict(state["critic"])
        self.optimizer.load_state_dict(state["optimizer"])
