"""What a co-design run costs in simulated env-steps, known before it starts."""

from collections import Counter
from dataclasses import dataclass

from evogymcm.algos.codesign.config import CodesignConfig
from evogymcm.algos.codesign.plan import Training, finetuning, generations, phases, trainings
from evogymcm.algos.learning.evaluation import starts_of
from evogymcm.envs.tasks import as_task


@dataclass(frozen=True)
class Cost:
    """The most env-steps that a run can take, by what they are for.

    Attributes:
        training: env-steps in which new bodies learn.
        scoring: env-steps of evaluations of all kinds.
        screening: env-steps of mutants, of which few are trained.
        search: env-steps under stiffness fields that are tried.
        finetuning: env-steps in which survivors learn on.
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
    """Returns what a run takes where no episode ends before its time limit and no max_env_steps ends the run.

    Raises:
        ValueError: There is no such task.
    """
    task = as_task(config.task)
    evaluation = task.time_limit * starts_of(task)  # of one body
    spent: Counter[str] = Counter()

    def learn(kind: str, training: Training) -> None:
        frames = training.ppo.frames_per_update
        updates = -(-training.ppo.total_steps // frames)
        interval = training.ppo.eval_interval
        between = min(updates - 1, (updates - 1) * frames // interval) if interval else 0
        spent[kind] += training.bodies * updates * frames
        spent["scoring"] += training.bodies * evaluation * (between + 2)  # with the untrained and the final policy

    for generation, (new, survivors) in enumerate(generations(config)):
        for phase in phases(config, generation, survivors):
            if phase == "screen":
                spent["screening"] += new * config.mutants * evaluation
            elif phase == "train":
                spent["scoring"] += new * evaluation
                for training in trainings(config, generation, new):
                    learn("training", training)
            elif phase == "finetune":
                spent["scoring"] += survivors * evaluation
                learn("finetuning", finetuning(config, generation, survivors))
            elif config.search:
                spent["search"] += config.search.rounds * (config.search.candidates + 1) * survivors * evaluation
    return Cost(**spent)
