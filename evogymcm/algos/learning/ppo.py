"""Proximal policy optimisation, Schulman et al., 2017 (clipped objective), with generalised advantage estimation."""

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from evogymcm.algos.learning.actor import Actor
from evogymcm.algos.learning.config import PPOConfig
from evogymcm.algos.learning.critic import Critic
from evogymcm.algos.learning.devices import on_cpu
from evogymcm.algos.learning.stacking import by_design, by_world

_LOGGED = {
    "loss_policy": "loss_objective",
    "loss_value": "loss_critic",
    "entropy": "entropy",
    "kl": "kl_approx",
    "clipped": "clip_fraction",
}


class PPOLearner:
    """Improves an actor and a critic from rollouts, without an environment.

    Stacked networks (with `copies`) learn side by side, each from its own designs' worlds: advantages are normalised
    and gradients clipped for each separately. Only the limit on the KL divergence applies to all together.

    Args:
        actor: the policy, changed in place.
        critic: the state value, changed in place.
        config: settings of the run.
        generator: random generator for the order of samples; torch's global one by default.
    """

    def __init__(
        self, actor: Actor, critic: Critic, config: PPOConfig, generator: torch.Generator | None = None
    ) -> None:
        self.actor, self.critic, self.config, self.generator = actor, critic, config, generator
        self.copies = actor.copies
        self.loss = ClipPPOLoss(
            actor,
            critic,
            clip_epsilon=config.clip,
            entropy_coeff=config.entropy_weight,
            critic_coeff=config.value_weight,
            loss_critic_type="l2",
            functional=False,
        )
        self.gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None, device=actor.log_std.device)
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
            order = torch.randperm(samples.shape[-1], generator=self.generator)
            shuffled = samples[..., order.to(self.actor.log_std.device)]
            logged = torch.stack([self._step(batch) for batch in shuffled.split(config.minibatch, -1)]).mean(0)
            stats = dict(zip(_LOGGED, logged.tolist(), strict=True))
            if config.target_kl and stats["kl"] > 1.5 * config.target_kl:
                break
        # Between rollouts, so that the next one is collected by the policy as it then is.
        self.actor.limit_std(config.initial_std**remaining * config.final_std ** (1 - remaining))
        return {**stats, "epochs": epoch, "explained_variance": explained, "learning_rate": rate}

    def _rows(self, data: TensorDictBase | Tensor) -> Any:
        """Returns (worlds, steps, ...) as rows of samples: (n, ...), or of each design, (D, n, ...)."""
        return data.flatten(0, 1) if self.copies is None else by_design(data, self.copies).flatten(1, 2)

    def _samples(self, rollout: TensorDictBase) -> tuple[TensorDict, float]:
        """Training samples with advantages, and the explained variance of the critic."""
        samples = rollout.select(*self.actor.in_keys, *self.critic.in_keys, "action", "action_log_prob")
        samples = self.actor.prepare(self._rows(samples))
        values, next_values = self._values(rollout, samples)
        outcome = rollout.select(("next", "done"), ("next", "terminated"))
        outcome["state_value"], outcome["next", "state_value"] = values, next_values
        outcome["next", "reward"] = rollout["next", "reward"] * self.config.reward_scale
        with torch.no_grad():
            self.gae(outcome)  # over (worlds, steps): time must still be the last dimension
        targets = outcome["value_target"]
        explained = 1 - (targets - values).var() / targets.var().clamp_min(1e-12)
        advantage = outcome["advantage"]
        if self.config.advantage_scale == "world":
            advantage = evened(advantage, self.copies)
        advantage = self._rows(advantage)
        spread = advantage.std(-2, keepdim=True).clamp_min(1e-6)
        samples["advantage"] = (advantage - advantage.mean(-2, keepdim=True)) / spread
        samples["value_target"] = self._rows(targets)
        return samples, explained.item()

    @torch.no_grad()
    def _values(self, rollout: TensorDictBase, samples: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Values of all states (those of `samples`) and of the states that followed, before any reset.

        Two of (worlds, steps, 1).
        """
        values = self._value(samples, rollout.batch_size)
        following = torch.cat([values[:, 1:], values[:, -1:]], 1)
        is_cut = rollout["next", "done"].squeeze(-1).clone()  # the next row is no continuation: ask the critic
        is_cut[:, -1] = True
        steps = is_cut.any(0)
        ends = rollout["next"].select(*self.critic.in_keys)[:, steps]
        cut = self._value(self._rows(ends), ends.batch_size)
        following[:, steps] = torch.where(is_cut[:, steps].unsqueeze(-1), cut, following[:, steps])
        return values, following

    def _value(self, rows: TensorDictBase, shape: torch.Size) -> Tensor:
        """Critic's values of rows of samples as (worlds, steps, 1), in pieces that stay in the processor's cache."""
        pieces = [self.critic(piece)["state_value"] for piece in rows.split(1024 // (self.copies or 1) + 1, -1)]
        values = torch.cat(pieces, -2)
        if self.copies is not None:
            values = by_world(values.unflatten(1, (-1, shape[1])))
        return values.reshape(*shape, 1)

    def _step(self, batch: TensorDictBase) -> Tensor:
        """One gradient step; returns the numbers that `update` logs, in `_LOGGED`'s order."""
        out = self.loss(batch)
        self.optimizer.zero_grad()
        loss = out["loss_objective"] + out["loss_critic"] + out["loss_entropy"]
        (loss * (self.copies or 1)).backward()  # the mean over a design's own samples, whatever stands beside it
        norms = [
            clip_gradients(network, self.config.max_grad_norm, self.copies) for network in (self.actor, self.critic)
        ]
        if torch.stack(norms).isfinite().all():  # a probability ratio may overflow; one such step would be the end
            self.optimizer.step()
        return torch.stack([out[key].detach() for key in _LOGGED.values()])

    def state_dict(self) -> dict[str, dict]:
        """Returns the networks (with their normalisation) and the optimiser's state, on the CPU."""
        parts = {"actor": self.actor, "critic": self.critic, "optimizer": self.optimizer}
        return {name: on_cpu(part.state_dict()) for name, part in parts.items()}

    def load_state_dict(self, state: dict[str, dict]) -> None:
        """Restores what `state_dict` returned."""
        self.actor.load_state_dict(state["actor"])
        self.critic.load_state_dict(state["critic"])
        self.optimizer.load_state_dict(state["optimizer"])


def evened(advantage: Tensor, copies: int | None) -> Tensor:
    """Returns advantages divided by the root of the mean of two variances: that of all worlds, and each world's own.

    Args:
        advantage: (worlds, steps, 1).
        copies: D designs that learn by themselves, world w having design w % D; None where all worlds learn together.
    """
    worlds = advantage.squeeze(-1).unflatten(0, (-1, copies or 1))  # (n, D, steps)
    own = worlds.var(-1, keepdim=True)
    scale = ((own + worlds.var((0, 2), keepdim=True)) / 2).sqrt().clamp_min(1e-6)
    return ((worlds - worlds.mean((0, 2), keepdim=True)) / scale).reshape(advantage.shape)


@torch.no_grad()
def clip_gradients(network: nn.Module, limit: float, copies: int | None) -> Tensor:
    """Scales gradients down to a norm of `limit`, those of each of the stacked networks by itself.

    Returns:
        The norm before, the largest of the stacked networks'. A stacked network whose gradient is not finite is given
        none, so that it does not stop the others.
    """
    if copies is None:
        return nn.utils.clip_grad_norm_(network.parameters(), limit)
    gradients = [p.grad for p in network.parameters() if p.grad is not None]
    norms = torch.stack([grad.flatten(1).square().sum(1) for grad in gradients]).sum(0).sqrt()  # (D,)
    is_finite = norms.isfinite()
    scale = torch.where(is_finite, (limit / (norms + 1e-6)).clamp(max=1.0), 0.0)
    for grad in gradients:
        grad.nan_to_num_(0.0, 0.0, 0.0).mul_(scale.reshape(-1, *[1] * (grad.dim() - 1)))
    return torch.where(is_finite, norms, 0.0).max()
