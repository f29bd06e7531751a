"""Settings of PPO for one body of several that train side by side."""

from dataclasses import asdict, dataclass, replace
from typing import Any

from evogymcm.algos.learning.config import PPOConfig, Sharing


@dataclass(frozen=True)
class BodyPPOConfig(PPOConfig):
    """PPO for one body: env-steps, worlds, gradient steps and evaluations apply to each body separately.

    A `PPOConfig` applies to a whole run with all its bodies. This has the same fields; the following have other
    defaults.

    Attributes:
        total_steps: env-steps of one body, in all of its worlds together, rounded up to whole rollouts.
        num_worlds: worlds of one body.
        minibatch: env-steps of one body in a gradient step.
        eval_interval: env-steps of one body between evaluations; 0 for only the untrained and the final policy.
        sharing: "independent" (each body has a policy of its own) or "shared" (bodies that train together have one).
        eval_worlds: not to be set: each body is evaluated in one world, or in 8 where the task draws at random.

    Raises:
        ValueError: A value is of the wrong kind or out of range.
    """

    total_steps: int = 100_000
    num_worlds: int = 16
    minibatch: int = 128
    eval_interval: int = 10_000
    sharing: Sharing = "independent"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.eval_worlds is not None:
            raise ValueError(f"eval_worlds: got {self.eval_worlds}, the bodies and the task say how many (None)")

    def of_bodies(self, count: int) -> PPOConfig:
        """Returns the settings of a run in which so many bodies train together."""
        per_body = ("total_steps", "num_worlds", "eval_interval")
        changes = {name: count * getattr(self, name) for name in per_body}
        if self.sharing == "shared":
            changes["minibatch"] = count * self.minibatch  # otherwise of each set of weights
        return PPOConfig(**asdict(self) | changes)

    def finetuning(self, steps: int | None = None) -> "BodyPPOConfig":
        """Returns the settings for training one body's policy further, from where its schedules ended.

        Args:
            steps: env-steps; None for 1 % of the body's training.
        """
        steps = steps or max(1, self.total_steps // 100)
        return replace(
            self,
            total_steps=steps,
            eval_interval=steps,
            learning_rate=self.learning_rate / 4,
            initial_std=self.final_std,
            sharing="independent",  # bodies of several generations hold different policies, also shared ones
        )


def check_body_ppo(ppo: Any) -> None:
    """Raises a ValueError for settings that are not those of one body."""
    if not isinstance(ppo, BodyPPOConfig):
        raise ValueError(
            f"ppo: got a {type(ppo).__name__}, expected a BodyPPOConfig: it has the settings of one body, "
            "with a policy of its own by default"
        )
