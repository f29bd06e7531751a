"""Scores of designs under their policies: each by itself to the last bit, or many in one batch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from evogymcm.algos.codesign.design import Design
from evogymcm.algos.codesign.inner_loop import MakeEnv, Policy, holding, stack_policies
from evogymcm.algos.codesign.material_search import MaterialSearch
from evogymcm.algos.learning.actor import load_actor
from evogymcm.algos.learning.evaluation import evaluate, starts_of
from evogymcm.algos.learning.stacking import PerDesign
from evogymcm.algos.learning.threads import limited_threads
from evogymcm.envs import SoftRobotEnv


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


def _score(
    make_env: MakeEnv, designs: Sequence[Design], make_policy: Callable[[SoftRobotEnv], TensorDictModuleBase], seed: int
) -> Scores:
    """Plays an episode of each design, or several where resets are random, in which all designs draw the same."""
    make = partial(holding(make_env, designs), seed=0)
    env = make(num_worlds=len(designs))
    starts = starts_of(env.task)
    if starts > 1:
        env.close(raise_if_closed=False)
        env = make(num_worlds=starts * len(designs))
    try:
        env.engine.set_seed([seed + world // len(designs) for world in range(env.engine.num_worlds)])
        with limited_threads(1):
            result = evaluate(make_policy(env), env)
    finally:
        env.close(raise_if_closed=False)
    parts = (result.score, result.returns, result.ceiling)
    score, returns, ceiling = (_mean(part.reshape(starts, -1)) for part in parts)
    return Scores(score, returns, ceiling, result.env_steps)


def _mean(rows: np.ndarray) -> np.ndarray:
    """Returns the mean row, summed row by row: NumPy's order of summation depends on how many columns there are."""
    total = rows[0].copy()
    for row in rows[1:]:
        total += row
    return total / len(rows)


class _OneByOne(TensorDictModuleBase):
    """Policies of D designs, dealt to the worlds in turn. Each world is asked by itself, whoever stands beside it.

    Worlds whose episode has ended are not asked: their actions are 1, and have no effect.

    A batched matrix product may round a row differently with the number of rows, and contact makes much of little.
    """

    def __init__(self, policies: Sequence[Policy], columns: int) -> None:
        super().__init__()
        self.actors = [load_actor(policy) for policy in policies]
        for actor in self.actors:
            actor.columns = columns
        self.in_keys, self.out_keys = self.actors[0].in_keys, self.actors[0].out_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the actions into `tensordict` (N,) and returns it."""
        rows, n = tensordict.select(*self.in_keys), len(self.actors)
        asked = torch.nonzero(~tensordict.get("done").reshape(-1)).flatten().tolist()
        out = [self.actors[i % n](rows[i : i + 1]) for i in asked]
        for key in self.out_keys:
            answers = torch.cat([row.get(key) for row in out])
            idle = torch.ones(len(rows), *answers.shape[1:], dtype=answers.dtype)
            tensordict.set(key, idle.index_copy(0, torch.tensor(asked), answers))
        return tensordict


def score_alone(make_env: MakeEnv, designs: Sequence[Design], policies: Sequence[Policy], seed: int = 0) -> Scores:
    """Scores each design under its policy, exactly as if it were alone: always the same to the last bit.

    Args:
        make_env: see `train_designs`.
        designs: D designs.
        policies: D policies.
        seed: where tasks with random resets draw from; those of several episodes count up. The same for all designs.

    Raises:
        ValueError: There are not as many policies as designs.
    """
    if len(policies) != len(designs):
        raise ValueError(f"policies: got {len(policies)}, expected one for each of {len(designs)} designs")
    return _score(make_env, designs, lambda env: _OneByOne(policies, env.grid_shape[1]), seed)


def score_together(
    make_env: MakeEnv, groups: Sequence[Sequence[Design]], policies: Sequence[Policy], seed: int = 0
) -> Scores:
    """Scores several designs under each policy in one batch: fast, and the same as `score_alone` but for rounding.

    `groups` has C designs for each of P policies; the arrays of the scores have the shape (P, C).

    Raises:
        ValueError: There are not as many policies as groups.
    """
    if len(policies) != len(groups):
        raise ValueError(f"policies: got {len(policies)}, expected one for each of {len(groups)} groups of designs")

    def make_policy(env: SoftRobotEnv) -> PerDesign:
        actor = load_actor(stack_policies(policies, "independent"))
        actor.columns = env.grid_shape[1]
        return PerDesign(actor, len(policies))

    flat = _score(make_env, [design for column in zip(*groups, strict=True) for design in column], make_policy, seed)
    score, returns, ceiling = (
        part.reshape(-1, len(policies)).T.copy() for part in (flat.score, flat.returns, flat.ceiling)
    )
    return Scores(score, returns, ceiling, flat.env_steps)


def score_proposals(
    make_env: MakeEnv, search: MaterialSearch, policies: Sequence[Policy]
) -> tuple[np.ndarray, np.ndarray, int]:
    """Scores all proposals of a search's round in one batch, and the best of each that may be accepted also by itself.

    Returns:
        Scores of all proposals of S individuals, (S * candidates,); returns of those also scored by themselves, (S,),
        NaN for others; the env-steps simulated.
    """
    fields = search.ask()  # (S * candidates, rows, columns)
    fields = fields.reshape(len(policies), -1, *fields.shape[1:])
    groups = [
        [Design(individual.design.body, field) for field in own]
        for individual, own in zip(search.individuals, fields, strict=True)
    ]
    together = score_together(make_env, groups, policies)
    scores, picks = together.score, together.score.argmax(1)
    promising = [i for i, pick in enumerate(picks) if scores[i, pick] >= search.best.scores[i]]
    returns, steps = np.full(len(policies), np.nan), together.env_steps
    if promising:
        chosen = [groups[i][picks[i]] for i in promising]
        alone = score_alone(make_env, chosen, [policies[i] for i in promising])
        below = np.nextafter(alone.score, -np.inf)  # none of the others, scored in a batch, may be taken for it
        scores[promising] = np.minimum(scores[promising], below[:, None])
        scores[promising, picks[promising]], returns[promising] = alone.score, alone.returns
        steps += alone.env_steps
    return scores.ravel(), returns, steps
