"""The inner loop of co-design: training a generation's designs together.

A policy is a mapping as `train` saves it, of one design: its form, and the weights of actor and critic.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from evogymcm.algos.codesign.body_ppo import BodyPPOConfig, check_body_ppo
from evogymcm.algos.codesign.design import Design
from evogymcm.algos.learning.loop import Progress, TrainResult
from evogymcm.algos.learning.stacking import stack_states, take_state
from evogymcm.algos.learning.trainer import Trainer
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.envs import SoftRobotEnv

Policy = dict[str, Any]
MakeEnv = Callable[..., SoftRobotEnv]  # all but bodies, their number and stiffness, and the seed is said already


def holding(make_env: Callable[..., Any], designs: Sequence[Design]) -> partial[Any]:
    """Returns what makes environments of designs, for `num_worlds` and `seed`; world w holds design w % D."""
    fields = None if all(design.stiffness is None for design in designs) else [design.field for design in designs]
    return partial(make_env, bodies=[design.body for design in designs], stiffness=fields)


@dataclass(frozen=True)
class Trained:
    """The outcome of training designs together.

    Attributes:
        best: each design's best policy.
        last: each design's last policy.
        scores: (D,) scores of the best policies during training; robust ones where that was the selection.
        env_steps: env-steps simulated, including evaluations.
        finished: False if it was stopped.
    """

    best: list[Policy]
    last: list[Policy]
    scores: np.ndarray
    env_steps: int
    finished: bool

    @classmethod
    def joined(cls, parts: Sequence["Trained"]) -> "Trained":
        """Returns the outcome of designs that were trained in several parts, each to its end."""
        best, last = ([policy for part in parts for policy in getattr(part, name)] for name in ("best", "last"))
        scores = np.concatenate([part.scores for part in parts])
        return cls(best, last, scores, sum(part.env_steps for part in parts), True)


def train_designs(
    make_env: MakeEnv,
    designs: Sequence[Design],
    ppo: BodyPPOConfig,
    *,
    run: RunFolder | None = None,
    initial: Sequence[Policy] | None = None,
    progress: Callable[[Progress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Trained:
    """Trains all designs at once in one population.

    Args:
        make_env: makes environments of given bodies, such as `partial(SoftRobotEnv, "Walker-v0", material="reactive")`.
        designs: D designs.
        ppo: settings for one design. With `sharing="independent"` each has its own policy, with "shared" all have one.
        run: folder from which a stopped training can be resumed.
        initial: a policy for each design to start from, the same for all where they share one; None for fresh ones.
        progress: see `train`.
        should_stop: see `train`.

    Raises:
        ValueError: `ppo` is a `PPOConfig`, whose env-steps and worlds are not those of one design; or there is not one
            policy for each design, or a shared one is to start from different ones; or designs have stiffness where
            policies set it.
    """
    check_body_ppo(ppo)
    n = len(designs)
    if initial is not None and len(initial) != n:
        raise ValueError(f"initial: got {len(initial)} policies, expected one for each of {n} designs")
    start = None if initial is None else stack_policies(initial, ppo.sharing)
    trainer = Trainer(holding(make_env, designs), ppo.of_bodies(n))
    result = trainer.train(run=run, progress=progress, should_stop=should_stop, initial=start)
    return apart(result, n, ppo.selection)


def stack_policies(policies: Sequence[Policy], sharing: str) -> Policy:
    """Returns the policies of several designs as one, which a run can start from; ValueError where that cannot be."""
    first = policies[0]
    if sharing == "shared":
        if not all(_is_same(first, policy) for policy in policies[1:]):
            raise ValueError("initial: got different policies, but a shared policy can start from one only")
        return first
    stacked = {name: stack_states([policy[name] for policy in policies]) for name in ("actor", "critic")}
    return {"form": first["form"] | {"copies": len(policies)}, **stacked}


def _is_same(one: Policy, other: Policy) -> bool:
    """Whether two policies have the same weights."""
    if one is other:
        return True
    parts = ("actor", "critic")
    return all(torch.equal(value, other[name][key]) for name in parts for key, value in one[name].items())


def apart(result: TrainResult, n: int, selection: str) -> Trained:
    """Returns a run's policies design by design."""

    def split(policy: Mapping[str, Any]) -> list[Policy]:
        if policy["form"]["copies"] is None:
            return [{name: policy[name] for name in ("form", "actor", "critic")}] * n
        form = policy["form"] | {"copies": None}
        parts = ("actor", "critic")
        return [{"form": form} | {name: take_state(policy[name], i) for name in parts} for i in range(n)]

    scores = result.best[selection].numpy().astype(np.float64).reshape(-1, n).mean(0)
    env_steps = result.env_steps + result.eval_steps
    return Trained(split(result.best), split(result.policy), scores, env_steps, result.finished)
