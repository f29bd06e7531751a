"""What a run of co-design does, phase by phase, and what that costs in simulated env-steps, known before it starts."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from evogymcm.algos.codesign.body_ppo import BodyPPOConfig
from evogymcm.algos.codesign.config import CodesignConfig, HalvingSchedule
from evogymcm.algos.codesign.genetic import survivor_count
from evogymcm.algos.learning.evaluation import draws_of
from evogymcm.envs.tasks import as_task

_TRAIN, _SEARCH, _FINETUNE = 0, 1, 2  # stages of a generation with draws of their own


@dataclass(frozen=True)
class Training:
    """A training of several bodies side by side."""

    name: str  # of its folder, within that of the generation
    bodies: int
    ppo: BodyPPOConfig  # of one of them
    kept: int | None = None  # go on to the next training of the generation; None after the last one


def pieces(count: int, size: int | None) -> list[slice]:
    """Returns which of `count` designs are worked on together: `size` in a piece, all for None."""
    return [slice(begin, begin + (size or count)) for begin in range(0, count, size or count)]


def generations(config: CodesignConfig) -> Iterator[tuple[int, int]]:
    """Yields the new bodies of each generation, the first one first, and the most that survive it and are worked on."""
    done = survivors = 0
    while done < config.budget:
        new = min(config.population - survivors, config.budget - done)
        done += new
        survivors = survivor_count(config.population, config.budget, done) if config.method == "ga" else 0
        yield new, new if config.method == "qd" else survivors


def phases(config: CodesignConfig, generation: int, survivors: int = 0) -> list[str]:
    """Returns the phases of a generation in order; the first one has no parents whose mutants could be screened."""
    screen = ["screen"] if config.mutants > 1 and generation else []
    return [*screen, "train", *(["search", "finetune"] if config.search and survivors else [])]


def trainings(config: CodesignConfig, generation: int, bodies: int) -> Iterator[Training]:
    """Yields the trainings of a generation's new bodies: one, or one up to each rung of successive halving."""
    halving = HalvingSchedule(config.rungs, config.keep)
    for rung, part in enumerate(pairwise((0.0, *halving.rungs, 1.0))):
        steps = max(1, round(config.ppo.total_steps * (part[1] - part[0])))
        seed = derived_seed(config.seed, generation, _TRAIN, rung)
        kept = halving.count(rung, bodies) if rung < len(halving.rungs) else None
        yield Training(f"train-{rung}", bodies, replace(config.ppo, total_steps=steps, schedule=part, seed=seed), kept)
        bodies = kept or bodies


def finetuning(config: CodesignConfig, generation: int, survivors: int) -> Training:
    """Returns the fine-tuning of a generation's survivors."""
    ppo = config.ppo.finetuning(config.finetune_steps)
    return Training("finetune", survivors, replace(ppo, seed=derived_seed(config.seed, generation, _FINETUNE, 0)))


def derived_seed(seed: int, *place: int) -> int:
    """Returns the seed of a place in a run, such as (generation, stage), which no other place or run shares.

    numpy's `SeedSequence` mixes the run's seed with the place. Of sums such as seed + generation, in contrast, one run
    has the same as another.
    """
    return int(np.random.SeedSequence(seed, spawn_key=place).generate_state(1, np.uint64)[0] >> 1)  # fits an int64


def search_seed(config: CodesignConfig, generation: int) -> int:
    """Returns the seed of a generation's material search."""
    return derived_seed(config.seed, generation, _SEARCH, 0)


@dataclass(frozen=True)
class Cost:
    """The most env-steps that a run can take, by what they are for.

    Attributes:
        training: env-steps in which new bodies learn.
        scoring: env-steps of evaluations of all kinds.
        screening: env-steps of mutants, of which few are trained.
        search: env-steps under stiffness fields that are tried.
        finetuning: env-steps in which survivors are trained further.
    """

    training: int = 0
    scoring: int = 0
    screening: int = 0
    search: int = 0
    finetuning: int = 0

    @property
    def total(self) -> int:
        """All of them."""
        return self.training + self.scoring + self.screening + self.search + self.finetuning


def cost_of(config: CodesignConfig) -> Cost:
    """Returns the cost of a run whose episodes all last to the time limit and which `max_env_steps` does not end.

    Raises:
        ValueError: There is no such task.
    """
    task = as_task(config.task)
    evaluation = task.time_limit * draws_of(task)  # of one body, from one start
    scoring = config.eval_starts * evaluation
    trying = scoring if config.selection == "robust" else evaluation  # a stiffness field
    spent: Counter[str] = Counter()

    def learn(kind: str, training: Training) -> None:
        frames = training.ppo.frames_per_update
        updates = -(-training.ppo.total_steps // frames)
        interval = training.ppo.eval_interval
        between = min(updates - 1, (updates - 1) * frames // interval) if interval else 0
        spent[kind] += training.bodies * updates * frames
        played = training.ppo.eval_starts * (between + 2)  # with the untrained and the final policy
        spent["scoring"] += training.bodies * evaluation * played

    for generation, (new, survivors) in enumerate(generations(config)):
        for phase in phases(config, generation, survivors):
            if phase == "screen":
                spent["screening"] += new * config.mutants * evaluation
            elif phase == "train":
                spent["scoring"] += new * scoring
                for training in trainings(config, generation, new):
                    learn("training", training)
            elif phase == "finetune":
                spent["scoring"] += survivors * scoring
                learn("finetuning", finetuning(config, generation, survivors))
            elif config.search:
                spent["search"] += config.search.rounds * survivors * (config.search.candidates * trying + scoring)
    return Cost(**spent)
