"""One run of co-design, phase by phase: the outer loops of EvoGymCM, with their ablations."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from evogymcm.algos.codesign.config import CodesignConfig
from evogymcm.algos.codesign.crew import Crew, Piece
from evogymcm.algos.codesign.design import Design, Individual
from evogymcm.algos.codesign.genetic import GeneticAlgorithm
from evogymcm.algos.codesign.inner_loop import Policy, Trained
from evogymcm.algos.codesign.ledger import Ledger
from evogymcm.algos.codesign.pieces import Place, score_piece, screen_piece, search_piece, train_piece
from evogymcm.algos.codesign.plan import Training, derived_seed, finetuning, phases, pieces, search_seed, trainings
from evogymcm.algos.codesign.scoring import Scores
from evogymcm.algos.codesign.start import check_start, env_maker, first_policy, make_body_search
from evogymcm.algos.learning.initial import exploring, following
from evogymcm.algos.runs.folder import RunFolder

_STATE = "codesign"


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
        executor: whose workers do the pieces of a generation, see `codesign`; None does them here, one after another.

    Attributes:
        config: settings, with networks of the form that policies begin with.
        began: what policies begin with, see `RunRecord.initial`.

    Raises:
        ValueError: A run of these settings cannot start, see `check_start`.
        ImportError: A package that they need is missing.
    """

    def __init__(
        self, config: CodesignConfig, run: RunFolder | None = None, *, executor: Executor | None = None
    ) -> None:
        check_start(config)
        self.began, self._first = first_policy(config)
        if self._first is not None:
            config = replace(config, ppo=following(config.ppo, self._first))
        if executor is not None and config.num_threads is None:
            config = replace(config, num_threads=1)  # workers share the cores
        self.config, self.run = config, run
        self.make_env, self.body_search = env_maker(config), make_body_search(config)
        self._crew = Crew(executor, run.path if run else None)
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

    def _do(self, pieces: Sequence[Piece], spent: int = 0) -> list[Any] | None:
        """Does pieces of a phase, None where that was stopped; `spent` env-steps of the phase have gone before."""
        return self._crew.do(pieces, lambda steps: self._report(spent + steps), self._is_stopped)

    def _learn(
        self, training: Training, designs: list[Design], initial: list[Policy] | None, spent: int = 0
    ) -> Trained | None:
        """Trains designs, None where that was stopped; `spent` env-steps of the phase have gone before."""
        size = self.config.piece if training.ppo.sharing == "independent" else None
        works = []
        for number, part in enumerate(pieces(len(designs), size)):
            ppo, place = training.ppo, None
            if size is not None:
                ppo = replace(ppo, seed=derived_seed(ppo.seed, number))
            if self.run:
                name = f"generation-{self.generation:03}/{training.name}"
                name += "" if size is None else f"/piece-{number:03}"
                settings = {"generation": self.generation, "phase": training.name, "seed": ppo.seed}
                place = Place(self.run.path.resolve(), name, settings)
            start = None if initial is None else initial[part]
            works.append(partial(train_piece, self.make_env, designs[part], ppo, start, place))
        parts = self._do(works, spent)
        return None if parts is None else Trained.joined(parts)

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
        places = pieces(len(designs), self.config.piece)
        parts = self._do([partial(screen_piece, self.make_env, designs[part], policies[part]) for part in places])
        if parts is None:
            return False
        self.body_search.choose(np.concatenate([part.scores for part in parts]))
        self.env_steps += sum(part.env_steps for part in parts)
        return True

    def _train(self) -> bool:
        """Trains the generation's new bodies, with successive halving where there are rungs."""
        new, generation = self.body_search.ask(), self.generation
        designs, going, start, steps = self._designs(new), list(range(len(new))), self._initial(new), 0
        scores, policies = [-np.inf] * len(new), dict[int, Policy]()
        for training in trainings(self.config, generation, len(new)):
            trained = self._learn(training, [designs[i] for i in going], start, steps)
            if trained is None:
                return False
            steps += trained.env_steps
            for i, policy, score in zip(going, trained.best, trained.scores.tolist(), strict=True):
                if score > scores[i]:
                    scores[i], policies[i] = score, policy
            last = dict(zip(going, trained.last, strict=True))
            going = sorted(sorted(going, key=lambda i: -scores[i])[: training.kept])
            start = [last[i] for i in going]
        alone = self._score_alone(designs, [policies[i] for i in range(len(new))], steps)
        if alone is None:
            return False
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
        config, survivors = self.config, self.body_search.survivors
        assert config.search is not None
        policies = [self.ledger.policy(individual.index) for individual in survivors]
        search = partial(
            search_piece,
            self.make_env,
            config=config.search,
            seed=search_seed(config, self.generation),
            starts=config.eval_starts,
            selection=config.selection,
        )
        places = pieces(len(survivors), config.piece)
        parts = self._do([partial(search, survivors[part], policies[part]) for part in places])
        if parts is None:
            return False
        told = dict[int, dict[str, float]]()
        for part in parts:
            told |= part.told
            self.env_steps += part.env_steps
        fields, scores = (np.concatenate([getattr(part, name) for part in parts]) for name in ("fields", "scores"))
        for individual, stiffness, score in zip(survivors, fields, scores, strict=True):
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
        if trained is None:
            return False
        alone = self._score_alone(designs, trained.best, trained.env_steps)
        if alone is None:
            return False
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

    def _score_alone(self, designs: list[Design], policies: list[Policy], spent: int) -> Scores | None:
        """Scores designs as if each were alone, None where that was stopped."""
        works = [
            partial(score_piece, self.make_env, designs[part], policies[part], self.config.eval_starts)
            for part in pieces(len(designs), self.config.piece)
        ]
        parts = self._do(works, spent)
        return None if parts is None else Scores.joined(parts)

    def _record_survivors(self, told: Mapping[int, Mapping[str, float]]) -> None:
        """Adds rows of the present phase; `told` is what is new of individuals, by their index."""
        for individual in self.body_search.survivors:
            new = told.get(individual.index)
            self.ledger.add(self.phase, individual, self.generation, self.env_steps, new)
