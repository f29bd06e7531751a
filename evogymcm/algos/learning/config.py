"""Settings of learning: plain data, without torch."""

from dataclasses import dataclass, fields
from typing import Any

from evogymcm._settings import check_choice, check_count, check_flag, check_number, check_pair

__all__ = ["PPOConfig"]

SHARING = ("shared", "independent")
NETWORKS = ("voxel", "mlp")
CONTEXTS = ("none", "body", "message", "attention")
_CHOICES = {"network": NETWORKS, "context": CONTEXTS, "sharing": SHARING}
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
