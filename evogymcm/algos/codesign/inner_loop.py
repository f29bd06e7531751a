"""What co-design asks of the inner loop: training a generation's designs together.

A policy is a mapping as `train` saves it, of one design: its form, and the weights of actor and critic.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torchrl.envs import EnvBase

from evogymcm._settings import check_choice, check_count
from evogymcm.algos.codesign.body_ppo import BodyPPOConfig, check_body_ppo
from evogymcm.algos.codesign.design import Design
from evogymcm.algos.learning.outcome import Progress, TrainResult
from evogymcm.algos.learning.stacking import stack_states, take_state
from evogymcm.algos.learning.trainer import Trainer
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.envs import SoftRobotEnv
from evogymcm.envs.dealing import MATERIALS
from evogymcm.sim.scene import EDGE_RULES

__all__ = [
    "Arena",
    "Policy",
    "Trained",
    "exploring",
    "stack_policies",
    "train_designs",
]

Policy = dict[str, Any]


@dataclass(frozen=True)
class Arena:
    """Where designs are trained and scored.

    Attributes:
        task: id of the task.
        material: "reactive" or "invariant".
        edge_rule: how stiffness acts on shared edges.
        num_threads: of the simulator; None for all cores.

    Raises:
        ValueError: There is no such material or rule, or no thread.
    """

    task: str
    material: str
    edge_rule: str = "mean_factor"
    num_threads: int | None = 1

    def __post_init__(self) -> None:
        check_choice("material", self.material, MATERIALS)
        check_choice("edge_rule", self.edge_rule, EDGE_RULES)
        if self.num_threads is not None:
            check_count("num_threads", self.num_threads)

    def make(self, designs: Sequence[Design], copies: int = 1, seed: int = 0) -> SoftRobotEnv:
        """Returns the worlds of a population: `copies` of each design, world w holding design w % D.

        Raises:
            ValueError: There is no such task, or a body does not fit into the task's world.
        """
        fields = None if self.material == "reactive" else [design.field for design in designs]
        return SoftRobotEnv(
            self.task,
            [design.body for design in designs],
            copies * len(designs),
            material=self.material,
            stiffness=fields,
            edge_rule=self.edge_rule,
            seed=seed,
            num_threads=self.num_threads,
        )


@dataclass(frozen=True)
class Trained:
    """What came of training designs together.

    Attributes:
        best: each design's best policy.
        last: each design's last policy.
        scores: (D,) of the best policies, as they were in training.
        env_steps: simulated, evaluations included.
        finished: False if it was stopped.
    """

    best: list[Policy]
    last: list[Policy]
    scores: np.ndarray
    env_steps: int
    finished: bool


def train_designs(
    arena: Arena,
    designs: Sequence[Design],
    ppo: BodyPPOConfig,
    *,
    run: RunFolder | None = None,
    start_from: Sequence[Policy] | None = None,
    progress: Callable[[Progress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Trained:
    """Trains all designs at once in one population.

    Args:
        arena: where.
        designs: D designs.
        ppo: settings for one design. With `sharing="independent"` each has its own policy, with "shared" all have one.
        run: where to keep what a stopped training goes on from.
        start_from: a policy for each design to start from, the same for all where they share one; None for fresh ones.
        progress: see `train`.
        should_stop: see `train`.

    Raises:
        ValueError: `ppo` is a `PPOConfig`, whose env-steps and worlds are not those of one design; or there is not one
            policy for each design, or a shared one is to start from different ones.
    """
    check_body_ppo(ppo)
    n = len(designs)
    if start_from is not None and len(start_from) != n:
        raise ValueError(f"start_from: got {len(start_from)} policies, expected one for each of {n} designs")
    config = ppo.of_bodies(n)

    def make_env(*, num_worlds: int, seed: int) -> EnvBase:
        return arena.make(designs, num_worlds // n, seed)

    start = None if start_from is None else stack_policies(start_from, ppo.sharing)
    trainer = Trainer(make_env, config)
    result = trainer.train(run=run, progress=progress, should_stop=should_stop, initial=start)
    return _apart(result, n)


def exploring(policy: Policy, std: float) -> Policy:
    """Returns a policy with the same mean actions that explores with `std`, in half ranges of the action."""
    log_std = torch.full_like(policy["actor"]["log_std"], math.log(std))
    return policy | {"actor": policy["actor"] | {"log_std": log_std}}


def stack_policies(policies: Sequence[Policy], sharing: str) -> Policy:
    """Returns the policies of several designs as one, which a run can start from; ValueError where that cannot be."""
    first = policies[0]
    if sharing == "shared":
        if not all(_is_same(first, policy) for policy in policies[1:]):
            raise ValueError("start_from: got different policies, but a shared policy can start from one only")
        return first
    stacked = {name: stack_states([policy[name] for policy in policies]) for name in ("actor", "critic")}
    return {"form": first["form"] | {"copies": len(policies)}, **stacked}


def _is_same(one: Policy, other: Policy) -> bool:
    """Whether two policies have the same weights."""
    if one is other:
        return True
    parts = ("actor", "critic")
    return all(torch.equal(value, other[name][key]) for name in parts for key, value in one[name].items())


def _apart(result: TrainResult, n: int) -> Trained:
    """Returns a run's policies design by design."""

    def split(policy: Mapping[str, Any]) -> list[Policy]:
        if policy["form"]["copies"] is None:
            return [{name: policy[name] for name in ("form", "actor", "critic")}] * n
        form = policy["form"] | {"copies": None}
        parts = ("actor", "critic")
        return [{"form": form} | {name: take_state(policy[name], i) for name in parts} for i in range(n)]

    scores = result.best["score"].numpy().astype(np.float64)
    env_steps = result.env_steps + result.eval_steps
    return Trained(split(result.best), split(result.policy), scores, env_steps, result.finished)
