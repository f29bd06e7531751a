"""Scores of designs under their policies: each by itself to the last bit, or many in one batch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from evogymcm.algos.codesign.design import Design, Individual
from evogymcm.algos.codesign.inner_loop import Arena, Policy, stack_policies
from evogymcm.algos.codesign.material_search import MaterialSearch
from evogymcm.algos.learning.actor import Actor, load_actor
from evogymcm.algos.learning.evaluation import evaluate, starts_of
from evogymcm.algos.learning.stacking import PerDesign
from evogymcm.algos.learning.threads import limited_threads
from evogymcm.envs import SoftRobotEnv
from evogymcm.envs.tasks import as_task

__all__ = ["Scores", "score_alone", "score_mutants", "score_proposals", "score_together"]


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
    arena: Arena, designs: Sequence[Design], make_policy: Callable[[SoftRobotEnv], TensorDictModuleBase], seed: int
) -> Scores:
    """Plays an episode of each design, or several where resets are random, in which all designs draw the same."""
    starts = starts_of(as_task(arena.task))
    env = arena.make(designs, starts)
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

    def __init__(self, actors: Sequence[Actor]) -> None:
        super().__init__()
        self.actors = list(actors)
        self.in_keys, self.out_keys = actors[0].in_keys, actors[0].out_keys

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
    return _score(arena, designs, lambda env: _OneByOne(_actors(policies, env.grid_shape[1])), seed)


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
        actor = load_actor(stack_policies(policies, "independent"))
        actor.columns = env.grid_shape[1]
        return PerDesign(actor, len(policies))

    return _score(arena, designs, make_policy, seed)


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
