"""What a co-design run costs in simulated env-steps, known before it starts."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

from evogymcm.algos.codesign.config import CodesignConfig
from evogymcm.algos.codesign.genetic import survivor_count
from evogymcm.algos.learning.config import PPOConfig
from evogymcm.algos.learning.evaluation import starts_of
from evogymcm.envs.tasks import as_task

__all__ = ["Cost", "cost_of", "generations"]


@dataclass(frozen=True)
class Cost:
    """The most env-steps that a run can take, by what they are for.

    Attributes:
        training: of new bodies.
        scoring: evaluations of all kinds.
        screening: of mutants, of which few are trained.
        search: of stiffness fields.
        finetuning: of survivors.
    """

    training: int
    scoring: int
    screening: int
    search: int
    finetuning: int

    @property
    def total(self) -> int:
        """All of them."""
        return self.training + self.scoring + self.screening + self.search + self.finetuning


def generations(config: CodesignConfig) -> Iterator[tuple[int, int]]:
    """Yields the new bodies of each generation, the first one first, and the most that survive it and are worked on."""
    done = survivors = 0
    while done < config.budget:
        new = min(config.population - survivors, config.budget - done)
        done += new
        if config.method == "ga":
            survivors = survivor_count(config.population, config.budget, done)
        yield new, {"ga": survivors, "random": 0, "qd": new}[config.method]


def _training(ppo: PPOConfig, bodies: int, evaluation: int) -> tuple[int, int]:
    """Returns the env-steps of training so many bodies, and those of its evaluations."""
    frames = ppo.frames_per_update
    updates = -(-ppo.total_steps // frames)
    between = min(updates - 1, (updates - 1) * frames // ppo.eval_interval) if ppo.eval_interval else 0
    evaluations = between + 2  # those of the untrained and the final policy
    return bodies * updates * frames, bodies * evaluation * evaluations


def cost_of(config: CodesignConfig) -> Cost:
    """Returns what a run takes where no episode ends before its time limit and no max_env_steps ends the run.

    Raises:
        ValueError: There is no such task.
    """
    task = as_task(config.task)
    evaluation = task.time_limit * starts_of(task)  # of one body
    halving = config.halving()
    training = scoring = screening = search = finetuning = 0
    for generation, (new, survivors) in enumerate(generations(config)):
        going = new
        if config.mutants > 1 and generation:
            screening += new * config.mutants * evaluation
        scoring += new * evaluation
        for rung, (begin, end) in enumerate(pairwise((0.0, *halving.rungs, 1.0))):
            share = replace(config.ppo, total_steps=max(1, round(config.ppo.total_steps * (end - begin))))
            steps, evaluations = _training(share, going, evaluation)
            training, scoring = training + steps, scoring + evaluations
            if rung < len(halving.rungs):
                going = halving.count(rung, going)
        if config.arm == "invariant" and survivors:
            search += config.search.rounds * (config.search.candidates + 1) * survivors * evaluation
            steps, evaluations = _training(config.finetuning(), survivors, evaluation)
            finetuning, scoring = finetuning + steps, scoring + evaluations + survivors * evaluation
    return Cost(training, scoring, screening, search, finetuning)
