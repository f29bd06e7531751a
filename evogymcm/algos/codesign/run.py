"""One run of co-design, phase by phase: the outer loops of EvoGymCM, with their ablations."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from evogymcm.algos.codesign.config import CodesignConfig
from evogymcm.algos.codesign.design import Design, Individual
from evogymcm.algos.codesign.genetic import GeneticAlgorithm
from evogymcm.algos.codesign.inner_loop import Policy, Trained, train_designs
from evogymcm.algos.codesign.ledger import Ledger
from evogymcm.algos.codesign.material_search import MaterialSearch
from evogymcm.algos.codesign.plan import Training, finetuning, phases, search_seed, trainings
from evogymcm.algos.codesign.scoring import Scores, score_alone, score_proposals, score_together
from evogymcm.algos.codesign.start import check_start, env_maker, make_body_search
from evogymcm.algos.learning.initial import exploring, following, initial_policy
from evogymcm.algos.runs.folder import RunFolder

_STATE = "codesign"
_SCREENED = 8  # mutants of a child that are played at a time, between looks whether to stop


@dataclass(frozen=True)
class CodesignProgress:
    """State of a run, reported after every update of a policy and every round of a search.

    Attributes:
        generation: counted from 0.
        phase: "screen", "train", "search" or "finetune".
        env_steps: env-steps simulated so far, of all kinds.
        n_designs: bodies proposed so far.
        best: the best fitness so far, None before there is one.
    """

    generation: int
    phase: str
    env_steps: int
    n_designs: int
    best: float | None


class Codesign:
    """One co-design run, advanced phase by phase.

    Fitness is the score of the stored policy in a world by itself (`score_alone`), or its robust score, so it is
    reproducible to the last bit. The table gets a row whenever an individual is trained, searched or fine-tuned: the
    individual's record, the event, its fitness and return (and with several starts its score, robust score and spread),
    the env-steps of all kinds so far, and the best fitness so far.

    Args:
        config: settings.
        run: where everything is kept; None keeps it in memory.

    Attributes:
        config: settings, with networks of the form that policies begin with.
        began: what policies begin with, see `RunRecord.initial`.

    Raises:
        ValueError: A run of these settings cannot start, see `check_start`.
        ImportError: A package that they need is missing.
    """

    def __init__(self, config: CodesignConfig, run: RunFolder | None = None) -> None:
        check_start(config)
        self.began, self._first = initial_policy(config.initial, config.task, config.material, config.ppo)
        if self._first is not None:
            config = replace(config, ppo=following(config.ppo, self._first))
        self.config, self.run = config, run
        self.make_env, self.body_search = env_maker(config), make_body_search(config)
        self.env_steps, self.phase = 0, "train"
        self.ledger = Ledger(run)
        self._tell: Callable[[CodesignProgress], None] = lambda progress: None
        self._is_stopped: Callable[[], bool] = lambda: False
        if run and (saved := run.load(_STATE)):
            self.body_search.load_state_dict(saved["search"])
            self.env_steps, self.phase = saved["env_steps"], saved["phase"]
            self.ledger.load_state_dict(saved)
        elif run:
            run.keep_rows(0)  # of a run that was killed before its first state was saved

    @property
    def is_finished(self) -> bool:
        """Whether a budget is used and all phases of the last generation are done."""
        if self.phase != phases(self.config, self.generation)[0]:
            return False
        limit = self.config.max_env_steps
        return self.body_search.is_finished or (limit is not None and self.env_steps >= limit)

    def advance(
        self,
        progress: Callable[[CodesignProgress], None] | None = None,
        should_stop: Callable[[], bool] | None = None,
    ) -> bool:
        """Runs the next phase; returns False if it was stopped on the way, to be resumed later."""
        self._tell, self._is_stopped = progress or self._tell, should_stop or self._is_stopped
        work = {
            "screen": self._screen,
            "train": self._train,
            "search": self._search_materials,
            "finetune": self._finetune,
        }
        generation = self.generation  # the search over bodies counts on when fitness is told
        if not work[self.phase]():
            return False
        order = phases(self.config, generation, len(self.body_search.survivors))
        later = order[order.index(self.phase) + 1 :]
        self.phase = (later or phases(self.config, generation + 1))[0]
        self.ledger.keep({individual.index for individual in self.body_search.parents})
        if self.run:
            state = {"search": self.body_search.state_dict(), "env_steps": self.env_steps, "phase": self.phase}
            self.run.save(_STATE, state | self.ledger.state_dict())
            for checkpoint in self.run.path.glob("generation-*/**/*.pt"):
                checkpoint.unlink()  # their policies are kept; the learning curves stay
        return True

    @property
    def generation(self) -> int:
        """The generation that the present phase works on, counted from 0."""
        return self.body_search.generation - (self.phase in ("search", "finetune"))

    def _report(self, steps: int = 0) -> None:
        place = (self.generation, self.phase, self.env_steps + steps, self.body_search.n_designs)
        self._tell(CodesignProgress(*place, self.ledger.best))

    def _designs(self, individuals: Sequence[Individual]) -> list[Design]:
        """Returns their designs as they are simulated."""
        return [individual.design.at(self.config.stiffness) for individual in individuals]

    def _learn(
        self, training: Training, designs: list[Design], initial: list[Policy] | None, spent: int = 0
    ) -> Trained:
        """Trains designs together; `spent` env-steps of the phase have gone before."""
        folder = None
        if self.run:
            path = self.run.path / f"generation-{self.generation:03}" / training.name
            settings = {"generation": self.generation, "phase": training.name, "seed": training.ppo.seed}
            folder = RunFolder(path, settings, resume=path.exists())
        return train_designs(
            self.make_env,
            designs,
            training.ppo,
            run=folder,
            initial=initial,
            progress=lambda state: self._report(spent + state.env_steps),
            should_stop=self._is_stopped,
        )

    def _initial(self, new: list[Individual]) -> list[Policy] | None:
        """Returns the policies that new individuals start from, None for fresh ones."""
        parents = [individual.parent for individual in new if individual.parent is not None]
        if not self.config.inherit or len(parents) < len(new):  # a generation is all random, or all mutants
            return None if self._first is None else [self._first] * len(new)
        policies = [self.ledger.policy(parent) for parent in parents]
        std = self.config.inherit_std
        return policies if std is None else [exploring(policy, std) for policy in policies]

    def _screen(self) -> bool:
        """Plays mutants under their parents' policies, and takes the best of each child."""
        assert isinstance(self.body_search, GeneticAlgorithm)
        mutants = self.body_search.mutants(self.config.mutants)
        policies = [self.ledger.policy(index) for group in mutants if (index := group[0].parent) is not None]
        designs = [self._designs(group) for group in mutants]
        scores, steps = [], 0
        for begin in range(0, self.config.mutants, _SCREENED):
            if self._is_stopped():
                return False  # no more than a screening is lost
            some = score_together(self.make_env, [group[begin : begin + _SCREENED] for group in designs], policies)
            scores.append(some.score)
            steps += some.env_steps
            self._report(steps)
        self.body_search.choose(np.concatenate(scores, axis=1))
        self.env_steps += steps
        return True

    def _train(self) -> bool:
        """Trains the generation's new bodies, with successive halving where there are rungs."""
        new, generation = self.body_search.ask(), self.generation
        designs, going, start, steps = self._designs(new), list(range(len(new))), self._initial(new), 0
        scores, policies = [-np.inf] * len(new), dict[int, Policy]()
        for training in trainings(self.config, generation, len(new)):
            trained = self._learn(training, [designs[i] for i in going], start, steps)
            if not trained.finished:
                return False
            steps += trained.env_steps
            for i, policy, score in zip(going, trained.best, trained.scores.tolist(), strict=True):
                if score > scores[i]:
                    scores[i], policies[i] = score, policy
            last = dict(zip(going, trained.last, strict=True))
            going = sorted(sorted(going, key=lambda i: -scores[i])[: training.kept])
            start = [last[i] for i in going]
        alone = self._score_alone(designs, [policies[i] for i in range(len(new))])
        self.env_steps += steps + alone.env_steps
        fitness = alone.by(self.config.selection).tolist()
        self.body_search.tell({individual.index: fitness[i] for i, individual in enumerate(new)})
        for i, individual in enumerate(new):
            self.ledger.store(individual.index, policies[i])
            ended = replace(individual, fitness=fitness[i])
            self.ledger.add("train", ended, generation, self.env_steps, alone.row(i))
        return True

    def _search_materials(self) -> bool:
        """Searches the survivors' stiffness fields under their present policies."""
        assert self.config.search is not None
        survivors = self.body_search.survivors
        policies = [self.ledger.policy(individual.index) for individual in survivors]
        seed = search_seed(self.config, self.generation)
        search = MaterialSearch(survivors, seed=seed, **asdict(self.config.search))
        told, steps, chosen = dict[int, dict[str, float]](), 0, (self.config.eval_starts, self.config.selection)
        while not search.is_finished:
            if self._is_stopped():
                return False  # no more than a search is lost
            scores, rows, spent = score_proposals(self.make_env, search, policies, *chosen)
            told |= {survivors[i].index: rows[i] for i in np.flatnonzero(search.tell(scores)).tolist()}
            steps += spent
            self._report(steps)
        self.env_steps += steps
        for individual, stiffness, score in zip(survivors, *search.best, strict=True):
            assert individual.fitness is not None
            if score > individual.fitness or not np.array_equal(stiffness, individual.design.field):
                self.body_search.update(individual.index, stiffness=stiffness, fitness=float(score))
        self._record_survivors(told)
        return True

    def _finetune(self) -> bool:
        """Trains the survivors on, each on its present material; a policy is replaced only by a better one."""
        survivors = self.body_search.survivors
        designs = self._designs(survivors)
        start = [self.ledger.policy(individual.index) for individual in survivors]
        trained = self._learn(finetuning(self.config, self.generation, len(survivors)), designs, start)
        if not trained.finished:
            return False
        alone = self._score_alone(designs, trained.best)
        self.env_steps += trained.env_steps + alone.env_steps
        told = dict[int, dict[str, float]]()
        fitness = alone.by(self.config.selection).tolist()
        for i, individual in enumerate(survivors):
            assert individual.fitness is not None
            if fitness[i] > individual.fitness:
                self.ledger.store(individual.index, trained.best[i])
                told[individual.index] = alone.row(i)
                self.body_search.update(individual.index, fitness=fitness[i])
        self._record_survivors(told)
        return True

    def _score_alone(self, designs: list[Design], policies: list[Policy]) -> Scores:
        return score_alone(self.make_env, designs, policies, starts=self.config.eval_starts)

    def _record_survivors(self, told: Mapping[int, Mapping[str, float]]) -> None:
        """Adds rows of the present phase; `told` is what is new of individuals, by their index."""
        for individual in self.body_search.survivors:
            new = told.get(individual.index)
            self.ledger.add(self.phase, individual, self.generation, self.env_steps, new)
