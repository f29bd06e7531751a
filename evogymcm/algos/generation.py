"""What co-design asks of the inner loop: training a generation's designs together, and scoring each by itself.

A policy is a mapping as `train` saves it, of one design: its form, and the weights of actor and critic.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from evogymcm.algos.actor import Actor, load_actor
from evogymcm.algos.body_ppo import BodyPPOConfig, check_body_ppo
from evogymcm.algos.design_search import Design, Individual
from evogymcm.algos.evaluate import evaluate, starts_of
from evogymcm.algos.material_search import MaterialSearch
from evogymcm.algos.runs import RunFolder
from evogymcm.algos.settings import check_choice, check_count
from evogymcm.algos.sharing import PerDesign, stack_states, take_state
from evogymcm.algos.threads import limited_threads
from evogymcm.algos.training import Progress, TrainResult, train
from evogymcm.envs import SoftRobotEnv
from evogymcm.envs.designs import MATERIALS
from evogymcm.envs.tasks import as_task
from evogymcm.sim.scene import EDGE_RULES

__all__ = [
    "Arena",
    "Policy",
    "Trained",
    "exploring",
    "score_alone",
    "score_mutants",
    "score_proposals",
    "score_together",
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

    def score(
        self, designs: Sequence[Design], make_policy: Callable[[SoftRobotEnv], TensorDictModuleBase], seed: int
    ) -> "Scores":
        """Plays an episode of each design, or several where resets are random, in which all designs draw the same."""
        starts = starts_of(as_task(self.task))
        env = self.make(designs, starts)
        try:
            env.engine.set_seed([seed + world // len(designs) for world in range(env.engine.num_worlds)])
            with limited_threads(1):
                result = evaluate(make_policy(env), env)
        finally:
            env.close(raise_if_closed=False)
        parts = (result.score, result.returns, result.ceiling)
        score, returns, ceiling = (_mean(part.reshape(starts, -1)) for part in parts)
        return Scores(score, returns, ceiling, result.env_steps)


@dataclass(frozen=True)
class Scores:
    """What designs are worth under their policies, as means over episodes where resets are random.

    Attributes:
        score: (D,) as the EvoGymCM paper counts, see `Evaluation`.
        returns: (D,) sums of all rewards.
        ceiling: (D,) largest possible scores where the task has one, NaN where it has none.
        env_steps: simulated in all.
    """

    score: np.ndarray
    returns: np.ndarray
    ceiling: np.ndarray
    env_steps: int


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


def _mean(rows: np.ndarray) -> np.ndarray:
    """Returns the mean row, summed row by row: NumPy's order of summation depends on how many columns there are."""
    total = rows[0].copy()
    for row in rows[1:]:
        total += row
    return total / len(rows)


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

    start = None if start_from is None else _together(start_from, ppo.sharing)
    result = train(make_env, config, run=run, progress=progress, should_stop=should_stop, start_from=start)
    return _apart(result, n)


def exploring(policy: Policy, std: float) -> Policy:
    """Returns a policy with the same mean actions that explores with `std`, in half ranges of the action."""
    log_std = torch.full_like(policy["actor"]["log_std"], math.log(std))
    return policy | {"actor": policy["actor"] | {"log_std": log_std}}


def _together(policies: Sequence[Policy], sharing: str) -> Policy:
    """Returns policies as one that a run can start from."""
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


class _OneByOne(TensorDictModuleBase):
    """Policies of D designs, dealt to the worlds in turn. Each world is asked by itself, whoever stands beside it.

    A batched matrix product may round a row differently with the number of rows, and contact makes much of little.
    """

    def __init__(self, actors: Sequence[Actor]) -> None:
        super().__init__()
        self.actors = list(actors)
        self.in_keys, self.out_keys = actors[0].in_keys, actors[0].out_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the actions into `tensordict` (N,) and returns it."""
        rows = tensordict.select(*self.in_keys)
        n = len(self.actors)
        out = [self.actors[i % n](rows[i : i + 1]) for i in range(rows.shape[0])]
        for key in self.out_keys:
            tensordict.set(key, torch.cat([row.get(key) for row in out]))
        return tensordict


def _actors(policies: Sequence[Policy], columns: int) -> list[Actor]:
    actors = [load_actor(policy) for policy in policies]
    for actor in actors:
        actor.columns = columns
    return actors


def score_alone(arena: Arena, designs: Sequence[Design], policies: Sequence[Policy], seed: int = 0) -> Scores:
    """Scores each design under its policy, exactly as if it were alone: always the same to the last bit.

    Args:
        arena: where.
        designs: D designs.
        policies: D policies.
        seed: of tasks with random resets, from which the seeds of several episodes count up; the same for all designs.

    Raises:
        ValueError: There are not as many policies as designs.
    """
    if len(policies) != len(designs):
        raise ValueError(f"policies: got {len(policies)}, expected one for each of {len(designs)} designs")
    return arena.score(designs, lambda env: _OneByOne(_actors(policies, env.grid_shape[1])), seed)


def score_together(
    arena: Arena, designs: Sequence[Design], policies: Sequence[Policy], copies: int, seed: int = 0
) -> Scores:
    """Scores `copies` designs under each policy in one batch: fast, and the same as `score_alone` but for rounding.

    Args:
        arena: where.
        designs: `copies` of each policy; design i is under policy i % P.
        policies: P policies.
        copies: designs of each policy.
        seed: of tasks with random resets, from which the seeds of several episodes count up; the same for all designs.

    Raises:
        ValueError: There are not `copies` designs of each policy.
    """
    if copies * len(policies) != len(designs):
        raise ValueError(f"policies: got {len(policies)}, expected 1 for {copies} each of {len(designs)} designs")

    def make_policy(env: SoftRobotEnv) -> PerDesign:
        actor = load_actor(_together(policies, "independent"))
        actor.columns = env.grid_shape[1]
        return PerDesign(actor, len(policies))

    return arena.score(designs, make_policy, seed)


def score_mutants(
    arena: Arena, mutants: Sequence[Sequence[Design]], policies: Sequence[Policy]
) -> tuple[np.ndarray, int]:
    """Scores several mutants under each of their parents' controllers, in one batch.

    Args:
        arena: where.
        mutants: as many of each of P parents.
        policies: P controllers.

    Returns:
        Scores (P, mutants of a parent), and the env-steps simulated.
    """
    copies = len(mutants[0])
    designs = [group[copy] for copy in range(copies) for group in mutants]
    together = score_together(arena, designs, policies, copies)
    return together.score.reshape(copies, len(mutants)).T.copy(), together.env_steps


def score_proposals(
    arena: Arena, search: MaterialSearch, survivors: Sequence[Individual], policies: Sequence[Policy]
) -> tuple[np.ndarray, np.ndarray, int]:
    """Scores all proposals of a search's round in one batch, and the best of each that may be accepted also by itself.

    Args:
        arena: where.
        search: with a round to be told.
        survivors: S individuals that it searches for.
        policies: their controllers.

    Returns:
        Scores of all proposals, (S * candidates,); returns of those also scored by themselves, (S,), NaN for others;
        the env-steps simulated.
    """
    fields = search.ask()  # (S * candidates, rows, columns)
    fields = fields.reshape(len(survivors), -1, *fields.shape[1:])
    copies = fields.shape[1]
    designs = [
        Design(individual.design.body, fields[i, copy])
        for copy in range(copies)
        for i, individual in enumerate(survivors)
    ]
    together = score_together(arena, designs, policies, copies)
    scores = together.score.reshape(copies, len(survivors)).T.copy()  # (survivors, candidates)
    picks = scores.argmax(1)
    promising = [i for i in range(len(survivors)) if scores[i, picks[i]] >= search.best.scores[i]]
    returns, steps = np.full(len(survivors), np.nan), together.env_steps
    if promising:
        chosen = [Design(survivors[i].design.body, fields[i, picks[i]]) for i in promising]
        alone = score_alone(arena, chosen, [policies[i] for i in promising])
        below = np.nextafter(alone.score, -np.inf)  # none of the others, scored in a batch, may be taken for it
        scores[promising] = np.minimum(scores[promising], below[:, None])
        scores[promising, picks[promising]], returns[promising] = alone.score, alone.returns
        steps += alone.env_steps
    return scores.ravel(), returns, steps
