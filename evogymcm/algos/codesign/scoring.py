"""Scores of designs under their policies: each by itself to the last bit, or many in one batch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from tensordict.nn import TensorDictModuleBase

from evogymcm.algos.codesign.design import Design
from evogymcm.algos.codesign.inner_loop import MakeEnv, Policy, holding, stack_policies
from evogymcm.algos.codesign.material_search import MaterialSearch
from evogymcm.algos.learning.actor import Actor, load_actor
from evogymcm.algos.learning.config import Selection
from evogymcm.algos.learning.evaluation import draws_of, evaluate, mean_of_rows, mean_work
from evogymcm.algos.learning.grouping import InGroups
from evogymcm.algos.learning.playing import Gait
from evogymcm.algos.learning.stacking import PerDesign
from evogymcm.algos.learning.threads import limited_threads
from evogymcm.envs import SoftRobotEnv
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.engines import engine_of


@dataclass(frozen=True)
class Scores:
    """Scores of designs under their policies, as means over several episodes if resets are random.

    Scores, returns and ceilings are those from the exact start, whatever others there are.

    Attributes:
        score: (D,) as the EvoGymCM paper counts, see `Evaluation`.
        returns: (D,) sums of all rewards.
        ceiling: (D,) largest possible scores where the task has one, NaN where it has none.
        env_steps: simulated in all.
        robust: (D,) mean scores over starts that differ by 1e-6 metres, see `evaluate`.
        spread: (D,) standard deviations over them; NaN where there is only the exact one.
        work: (D, 4) work of an episode, see `Evaluation`; NaN where it is not measured.
    """

    score: np.ndarray
    returns: np.ndarray
    ceiling: np.ndarray
    env_steps: int
    robust: np.ndarray
    spread: np.ndarray
    work: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence["Scores"]) -> "Scores":
        """Returns the scores of designs that were scored in several parts."""
        told = {item.name: [getattr(part, item.name) for part in parts] for item in fields(cls)}
        env_steps = sum(told.pop("env_steps"))
        return cls(**{name: np.concatenate(values) for name, values in told.items()}, env_steps=env_steps)

    def by(self, selection: Selection) -> np.ndarray:
        """Returns what designs are selected by, (D,)."""
        return self.robust if selection == "robust" else self.score

    def row(self, index: int) -> dict[str, float]:
        """Returns what the table says of a design besides its fitness."""
        told = {"return": self.returns}
        if np.isfinite(self.spread[index]):
            told |= {"score": self.score, "robust_score": self.robust, "spread": self.spread}
        return {name: float(values[index]) for name, values in told.items()} | mean_work(self.work[index : index + 1])


def _score(
    make_env: Callable[..., Any],
    designs: Sequence[Design],
    make_policy: Callable[[Any], TensorDictModuleBase | Gait],
    seed: int,
    starts: int,
) -> Scores:
    """Plays an episode of each design, or several where resets are random, in which all designs draw the same."""
    make, n = partial(holding(make_env, designs), seed=0), len(designs)
    env = make(num_worlds=n)
    draws = draws_of(env.task)
    if draws * starts > 1:
        engine_of(env).close()
        env = make(num_worlds=starts * draws * n)
    engine = engine_of(env)
    try:
        engine.set_seed([seed + world // n % draws for world in range(engine.num_worlds)])
        with limited_threads(1):
            result = evaluate(make_policy(env), env, starts, start_seed=seed)
    finally:
        engine.close()
    parts = (result.score, result.returns, result.ceiling, result.robust, result.spread)
    score, returns, ceiling, robust, spread = (mean_of_rows(part.reshape(draws, n)) for part in parts)
    work = mean_of_rows(result.work.reshape(draws, n, -1))
    return Scores(score, returns, ceiling, result.env_steps, robust, spread, work)


def _actors(policies: Sequence[Policy], columns: int) -> list[Actor]:
    actors = [load_actor(policy) for policy in policies]
    for actor in actors:
        actor.columns = columns
    return actors


def score_alone(
    make_env: MakeEnv, designs: Sequence[Design], policies: Sequence[Policy], seed: int = 0, starts: int = 1
) -> Scores:
    """Scores each design under its policy, exactly as if it were alone: always the same to the last bit.

    Args:
        make_env: see `train_designs`.
        designs: D designs.
        policies: D policies.
        seed: seed of random resets, counted up over several episodes; the same for all designs.
        starts: number of starts, 1e-6 metres apart, from which each episode is played, see `evaluate`.

    Raises:
        ValueError: There are not as many policies as designs.
    """
    if len(policies) != len(designs):
        raise ValueError(f"policies: got {len(policies)}, expected one for each of {len(designs)} designs")
    return _score(make_env, designs, lambda env: InGroups(_actors(policies, env.grid_shape[1])), seed, starts)


def score_gaits(
    make_engine: Callable[..., TaskEngine], designs: Sequence[Design], gaits: Gait, seed: int = 0, starts: int = 1
) -> Scores:
    """Scores each design under its gait, as `score_alone` does under a policy.

    Args:
        make_engine: makes worlds of given bodies, such as `partial(TaskEngine, "Walker-v0", with_voxels=False)`.
        designs: D designs.
        gaits: gaits of all of them, world w being driven by gait w % D.
        seed: see `score_alone`.
        starts: see `score_alone`.
    """
    return _score(make_engine, designs, lambda engine: gaits, seed, starts)


def score_together(
    make_env: MakeEnv, groups: Sequence[Sequence[Design]], policies: Sequence[Policy], seed: int = 0, starts: int = 1
) -> Scores:
    """Scores several designs under each policy in one batch: fast, and the same as `score_alone` but for rounding.

    `groups` has C designs for each of P policies; the arrays of the scores have the shape (P, C). Each episode is
    played from `starts` that differ by 1e-6 metres, see `evaluate`.

    Raises:
        ValueError: There are not as many policies as groups.
    """
    if len(policies) != len(groups):
        raise ValueError(f"policies: got {len(policies)}, expected one for each of {len(groups)} groups of designs")

    def make_policy(env: SoftRobotEnv) -> PerDesign:
        actor = load_actor(stack_policies(policies, "independent"))
        actor.columns = env.grid_shape[1]
        return PerDesign(actor, len(policies))

    designs = [design for column in zip(*groups, strict=True) for design in column]
    flat = _score(make_env, designs, make_policy, seed, starts)
    parts = (flat.score, flat.returns, flat.ceiling, flat.robust, flat.spread)
    score, returns, ceiling, robust, spread = (part.reshape(-1, len(policies)).T.copy() for part in parts)
    work = flat.work.reshape(-1, len(policies), flat.work.shape[1]).transpose(1, 0, 2).copy()
    return Scores(score, returns, ceiling, flat.env_steps, robust, spread, work)


def score_proposals(
    make_env: MakeEnv,
    search: MaterialSearch,
    policies: Sequence[Policy],
    starts: int = 1,
    selection: Selection = "score",
) -> tuple[np.ndarray, dict[int, dict[str, float]], int]:
    """Scores all proposals of a search's round in one batch, and the best of each that may be accepted also by itself.

    What proposals are compared by is the `selection`; the "robust" score needs as many `starts` of all of them, others
    only of the best.

    Returns:
        What all proposals of S individuals are worth, (S * candidates,); what the table says of the best of individual
        i, by i, for those scored by themselves; the env-steps simulated.
    """
    fields = search.ask()  # (S * candidates, rows, columns)
    fields = fields.reshape(len(policies), -1, *fields.shape[1:])
    groups = [
        [Design(individual.design.body, field) for field in own]
        for individual, own in zip(search.individuals, fields, strict=True)
    ]
    together = score_together(make_env, groups, policies, starts=starts if selection == "robust" else 1)
    scores = together.by(selection)
    picks = scores.argmax(1)
    promising = [i for i, pick in enumerate(picks) if scores[i, pick] >= search.best.scores[i]]
    told, steps = dict[int, dict[str, float]](), together.env_steps
    if promising:
        chosen = [groups[i][picks[i]] for i in promising]
        alone = score_alone(make_env, chosen, [policies[i] for i in promising], starts=starts)
        worth = alone.by(selection)
        below = np.nextafter(worth, -np.inf)  # none of the others, scored in a batch, may be taken for it
        scores[promising] = np.minimum(scores[promising], below[:, None])
        scores[promising, picks[promising]] = worth
        told = {i: alone.row(place) for place, i in enumerate(promising)}
        steps += alone.env_steps
    return scores.ravel(), told, steps
