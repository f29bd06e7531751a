"""Proximal policy optimisation, Schulman et al., 2017 (clipped objective), with generalised advantage estimation."""

from dataclasses import dataclass, fields
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from evogymcm.algos.actor import Actor
from evogymcm.algos.context import CONTEXTS
from evogymcm.algos.critic import Critic
from evogymcm.algos.settings import check_choice, check_count, check_flag, check_number, check_pair
from evogymcm.algos.sharing import by_design, by_world

__all__ = ["PPOConfig", "PPOLearner"]


_LOGGED = {
    "loss_policy": "loss_objective",
    "loss_value": "loss_critic",
    "entropy": "entropy",
    "kl": "kl_approx",
    "clipped": "clip_fraction",
}
SHARING = ("shared", "independent")
_CHOICES = {"network": ("voxel", "mlp"), "context": tuple(CONTEXTS), "sharing": SHARING}
_COUNTS_FROM = {"eval_interval": 0, "seed": 0}  # other counts: from 1
_NUMBERS: dict[str, dict[str, float]] = {
    "learning_rate": {"above": 0},
    "gamma": {"low": 0, "high": 1},
    "gae_lambda": {"low": 0, "high": 1},
    "clip": {"above": 0},
    "entropy_weight": {"low": 0},
    "value_weight": {"low": 0},
    "max_grad_norm": {"above": 0},
    "target_kl": {"low": 0},
    "reward_scale": {"above": 0},
    "initial_std": {"above": 0},
    "final_std": {"above": 0},
    "noise_correlation": {"low": 0, "below": 1},
}


@dataclass(frozen=True)
class PPOConfig:
    """Everything that a training run depends on besides its environment.

    Attributes:
        total_steps: env-steps of all worlds together, rounded up to whole rollouts.
        num_worlds: worlds simulated together.
        rollout_steps: env-steps per world between two updates.
        epochs: passes over a rollout per update.
        minibatch: env-steps per gradient step, of each set of weights.
        learning_rate: of Adam, at the start.
        decay_learning_rate: whether it falls linearly to zero at the end.
        gamma: discount per env-step.
        gae_lambda: of the advantage estimate.
        clip: how far the probability ratio may move from 1.
        entropy_weight: of the exploration bonus (entropy before clipping, summed over voxels and heads).
        value_weight: of the critic's squared error.
        max_grad_norm: limit of the gradient's norm, of actor and critic each.
        target_kl: an update stops after an epoch that moved the policy further than 1.5 times this; 0 for no limit.
        reward_scale: factor on rewards within the learner; scores and returns are never scaled.
        hidden: width of the networks; None for that of their kind, 32 ("voxel") or 64 ("mlp").
        network: "voxel" (shared by all voxels of any body) or "mlp" (plain, on the flat observation of one body).
        context: what a voxel knows of the rest of its body, see `VoxelActor`.
        sharing: "shared" (one set of weights for all designs) or "independent" (a set for each, trained side by side).
        initial_std: exploration at the start: standard deviation in half ranges of the action.
        final_std: the most exploration at the end; the limit falls geometrically from `initial_std`. A policy that has
            only ever acted with much noise may get stuck without it.
        schedule: which part of the schedules of learning rate and exploration the run covers: (0, 1) is all of it.
        noise_correlation: of exploration noise, from one env-step to the next. Correlated noise moves a body further
            than white noise, whose pushes cancel each other (Hollenstein et al., 2024); each step's noise by itself has
            the policy's distribution, which is all that the likelihood ratios look at.
        eval_interval: env-steps between evaluations; 0 for only the untrained and the final policy.
        eval_worlds: worlds in an evaluation; None for one of each design, or 8 where the task draws at random.
        seed: of weights, exploration and environments.
        torch_threads: threads of torch while training.

    Raises:
        ValueError: A value is of the wrong kind or out of range.
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
    hidden: int | None = None
    network: str = "voxel"
    context: str = "body"
    sharing: str = "shared"
    initial_std: float = 1.0
    final_std: float = 0.3
    schedule: tuple[float, float] = (0.0, 1.0)
    noise_correlation: float = 0.0
    eval_interval: int = 50_000
    eval_worlds: int | None = None
    seed: int = 0
    torch_threads: int = 1

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, _checked(field.name, getattr(self, field.name)))

    @property
    def frames_per_update(self) -> int:
        """Env-steps of one rollout, all worlds together."""
        return self.num_worlds * self.rollout_steps


def _checked(name: str, value: Any) -> Any:
    """Returns the value of a setting as Python has it, or raises a ValueError."""
    if name in _CHOICES:
        return check_choice(name, value, _CHOICES[name])
    if name in _NUMBERS:
        return check_number(name, value, **_NUMBERS[name])
    if name == "decay_learning_rate":
        return check_flag(name, value)
    if name == "schedule":
        begin, end = (check_number(name, share, low=0, high=1) for share in check_pair(name, value))
        if not begin < end:
            raise ValueError(f"schedule: got {value}, expected two rising shares from 0 to 1")
        return begin, end
    if value is None and name in ("hidden", "eval_worlds"):
        return None
    return check_count(name, value, _COUNTS_FROM.get(name, 1))


class PPOLearner:
    """Improves an actor and a critic from rollouts; never sees an environment.

    Stacked networks (with `copies`) learn side by side, each from its own designs' worlds: advantages are normalised
    and gradients clipped for each by itself. Only the KL guard looks at all of them together.

    Args:
        actor: the policy, changed in place.
        critic: the state value, changed in place.
        config: settings of the run.
        generator: of the order of samples; torch's global one by default.
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
        self.gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None)
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
            shuffled = samples[..., torch.randperm(samples.shape[-1], generator=self.generator)]
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
        advantage = self._rows(outcome["advantage"])
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
