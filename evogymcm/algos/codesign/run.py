"""Co-design of body, material and control: the outer loops of EvoGymCM, with their ablations.

Four arms: "reactive" (bodies evolve, policies set stiffness), "fixed" (the same with stiffness 1), "invariant" (bodies
and stiffness fields evolve, with material local search and fine-tuning of survivors) and "prescribed" (the same with
one given stiffness, without search).
"""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from evogymcm.algos.codesign.body_ppo import BodyPPOConfig
from evogymcm.algos.codesign.config import ARMS, CodesignConfig, SearchConfig
from evogymcm.algos.codesign.design import Design, Individual
from evogymcm.algos.codesign.genetic import GeneticAlgorithm
from evogymcm.algos.codesign.inner_loop import Policy, Trained, exploring, train_designs
from evogymcm.algos.codesign.ledger import Ledger
from evogymcm.algos.codesign.material_search import MaterialSearch
from evogymcm.algos.codesign.scoring import score_alone, score_mutants, score_proposals
from evogymcm.algos.learning.seeding import derived_seed
from evogymcm.algos.runs.folder import RunFolder, stop_on_interrupt
from evogymcm.algos.runs.origin import find_origin
from evogymcm.algos.runs.record import RunRecord, best_curve

__all__ = ["ARMS", "Codesign", "CodesignConfig", "CodesignProgress", "CodesignResult", "SearchConfig", "codesign"]

_STATE = "codesign"
_TRAIN, _SEARCH, _FINETUNE = 0, 1, 2  # stages of a generation with draws of their own
_SCREENED = 8  # mutants of a child that are played at a time, between looks whether to stop


@dataclass(frozen=True)
class CodesignProgress:
    """State of a run, told after every update of a policy and every round of a search.

    Attributes:
        generation: counted from 0.
        phase: "screen", "train", "search" or "finetune".
        env_steps: simulated so far, of all kinds.
        n_designs: bodies proposed so far.
        best: the best fitness so far, None before there is one.
    """

    generation: int
    phase: str
    env_steps: int
    n_designs: int
    best: float | None


@dataclass(frozen=True)
class CodesignResult:
    """Outcome of a run.

    Attributes:
        best: the best individual; None where the run was stopped before there was one.
        policy: its controller.
        rows: the table, see `Codesign`.
        env_steps: simulated in all.
        finished: False if it was stopped.
    """

    best: Individual | None
    policy: Policy | None
    rows: list[dict[str, Any]]
    env_steps: int
    finished: bool


class Codesign:
    """One co-design run, advanced phase by phase.

    Fitness is the score of the stored policy in a world by itself (`score_alone`), so that it can be had again to the
    last bit. The table gets a row whenever an individual is trained, searched or fine-tuned: the individual's record,
    the event, its score and return, the env-steps of all kinds so far, and the best fitness so far.

    Args:
        config: settings.
        run: where everything is kept; None keeps it in memory.

    Raises:
        ValueError: A run of these settings cannot start, see `CodesignConfig.check`.
    """

    def __init__(self, config: CodesignConfig, run: RunFolder | None = None) -> None:
        config.check()
        self.config, self.run = config, run
        self.arena, self.search = config.make_arena(), config.make_search()
        self.env_steps, self.phase = 0, "train"
        self.ledger = Ledger(run)
        self._tell: Callable[[CodesignProgress], None] = lambda progress: None
        self._is_stopped: Callable[[], bool] = lambda: False
        if run and (saved := run.load(_STATE)):
            self._load(saved)
        elif run:
            run.keep_rows(0)  # of a run that was killed before its first state was saved

    @property
    def is_finished(self) -> bool:
        """Whether a budget is used and all phases of the last generation are done."""
        if self.phase != self._first_phase:
            return False
        limit = self.config.max_env_steps
        return self.search.is_finished or (limit is not None and self.env_steps >= limit)

    def advance(
        self,
        progress: Callable[[CodesignProgress], None] | None = None,
        should_stop: Callable[[], bool] | None = None,
    ) -> bool:
        """Does the next phase; returns False where it was stopped on the way, to be gone on with later."""
        self._tell, self._is_stopped = progress or self._tell, should_stop or self._is_stopped
        phases = {
            "screen": self._screen,
            "train": self._train,
            "search": self._search_materials,
            "finetune": self._finetune,
        }
        done = phases[self.phase]()
        if done:
            needed = self.search.survivors if self.run else self.search.parents  # a folder has those of all
            self.ledger.keep({individual.index for individual in needed})
            if self.run:
                self.run.save(_STATE, self._state())
                for checkpoint in self.run.path.glob("generation-*/**/*.pt"):
                    checkpoint.unlink()  # their policies are kept; the learning curves stay
        return done

    @property
    def generation(self) -> int:
        """The generation that the present phase works on, counted from 0."""
        # The search counts on when fitness is told; its survivors are then searched and fine-tuned.
        return self.search.generation - (self.phase in ("search", "finetune"))

    @property
    def _first_phase(self) -> str:
        """Of the next generation; the first one has no parents whose mutants could be screened."""
        return "screen" if self.config.mutants > 1 and self.search.generation else "train"

    def _report(self, steps: int = 0) -> None:
        place = (self.generation, self.phase, self.env_steps + steps, self.search.n_designs)
        self._tell(CodesignProgress(*place, self.ledger.best))

    def _design(self, individual: Individual) -> Design:
        """Returns the design as it is simulated in this arm."""
        return individual.design.in_arm(self.config.arm, self.config.prescribed)

    def _folder(self, name: str, seed: int) -> RunFolder | None:
        """Returns the folder of a training, gone on with where there is one."""
        if self.run is None:
            return None
        path = self.run.path / f"generation-{self.generation:03}" / name
        return RunFolder(path, {"generation": self.generation, "phase": name, "seed": seed}, resume=path.exists())

    def _seed(self, stage: int, part: int = 0) -> int:
        """Returns the seed of a stage of the present generation."""
        return derived_seed(self.config.seed, self.generation, stage, part)

    def _learn(
        self, name: str, designs: list[Design], ppo: BodyPPOConfig, start_from: list[Policy] | None, spent: int
    ) -> Trained:
        """Trains designs together; `spent` env-steps of the phase have gone before."""
        return train_designs(
            self.arena,
            designs,
            ppo,
            run=self._folder(name, ppo.seed),
            start_from=start_from,
            progress=lambda state: self._report(spent + state.env_steps),
            should_stop=self._is_stopped,
        )

    def _inherited(self, new: list[Individual]) -> list[Policy] | None:
        """Returns the policies that new individuals start from, None for fresh ones."""
        parents = [individual.parent for individual in new if individual.parent is not None]
        if not self.config.inherit or len(parents) < len(new):  # a generation is all random, or all mutants
            return None
        policies = [self.ledger.policy(parent) for parent in parents]
        std = self.config.inherit_std
        return policies if std is None else [exploring(policy, std) for policy in policies]

    def _screen(self) -> bool:
        """Plays mutants under their parents' controllers, and takes the best of each child."""
        assert isinstance(self.search, GeneticAlgorithm)
        mutants = self.search.mutants(self.config.mutants)
        policies = [self.ledger.policy(index) for group in mutants if (index := group[0].parent) is not None]
        designs = [[self._design(individual) for individual in group] for group in mutants]
        scores, steps = [], 0
        for begin in range(0, self.config.mutants, _SCREENED):
            if self._is_stopped():
                return False  # no more than a screening is lost
            some, spent = score_mutants(self.arena, [group[begin : begin + _SCREENED] for group in designs], policies)
            scores.append(some)
            steps += spent
            self._report(steps)
        self.search.choose(np.concatenate(scores, axis=1))
        self.env_steps += steps
        self.phase = "train"
        return True

    def _train(self) -> bool:
        """Trains the generation's new bodies, with successive halving where there are rungs."""
        new = self.search.ask()
        going, schedule = list(range(len(new))), self.config.halving()
        designs = [self._design(individual) for individual in new]
        policies: dict[int, Policy] = {}
        scores = np.full(len(new), -np.inf)
        start = self._inherited(new)
        bounds, steps = (0.0, *schedule.rungs, 1.0), 0
        for rung, (begin, end) in enumerate(pairwise(bounds)):
            total = max(1, round(self.config.ppo.total_steps * (end - begin)))
            seed = self._seed(_TRAIN, rung)
            ppo = replace(self.config.ppo, total_steps=total, schedule=(begin, end), seed=seed)
            trained = self._learn(f"train-{rung}", [designs[i] for i in going], ppo, start, steps)
            if not trained.finished:
                return False
            steps += trained.env_steps
            for i, policy, score in zip(going, trained.best, trained.scores, strict=True):
                if score > scores[i]:
                    scores[i], policies[i] = score, policy
            if rung < len(schedule.rungs):
                ranked = schedule.promote({i: float(scores[i]) for i in going}, rung)
                last = dict(zip(going, trained.last, strict=True))
                going, start = sorted(ranked), [last[i] for i in sorted(ranked)]
        alone = score_alone(self.arena, designs, [policies[i] for i in range(len(new))])
        self.env_steps += steps + alone.env_steps
        generation = self.generation
        self.search.tell({individual.index: float(alone.score[i]) for i, individual in enumerate(new)})
        for i, individual in enumerate(new):
            self.ledger.policies[individual.index] = policies[i]
            self.ledger.returns[individual.index] = float(alone.returns[i])
            self._record("train", replace(individual, fitness=float(alone.score[i])), generation)
        self.phase = "search" if self.config.arm == "invariant" and self.search.survivors else self._first_phase
        return True

    def _search_materials(self) -> bool:
        """Searches the survivors' stiffness fields under their present controllers."""
        config = self.config.search
        survivors = self.search.survivors
        policies = [self.ledger.policies[individual.index] for individual in survivors]
        search = MaterialSearch(survivors, seed=self._seed(_SEARCH), **asdict(config))
        steps = 0
        while not search.is_finished:
            if self._is_stopped():
                return False  # no more than a search is lost
            scores, returns, spent = score_proposals(self.arena, search, survivors, policies)
            for i in np.flatnonzero(search.tell(scores)):
                self.ledger.returns[survivors[i].index] = float(returns[i])
            steps += spent
            self._report(steps)
        self.env_steps += steps
        for individual, stiffness, score in zip(survivors, *search.best, strict=True):
            if score > (individual.fitness or 0.0) or not np.array_equal(stiffness, individual.design.field):
                self.search.update(individual.index, stiffness=stiffness, fitness=float(score))
        self._record_survivors("search")
        self.phase = "finetune"
        return True

    def _finetune(self) -> bool:
        """Trains the survivors on, each on its present material; a policy is replaced only by a better one."""
        survivors = self.search.survivors
        designs = [individual.design for individual in survivors]
        start = [self.ledger.policies[individual.index] for individual in survivors]
        ppo = replace(self.config.finetuning(), seed=self._seed(_FINETUNE))
        trained = self._learn("finetune", designs, ppo, start, 0)
        if not trained.finished:
            return False
        alone = score_alone(self.arena, designs, trained.best)
        self.env_steps += trained.env_steps + alone.env_steps
        for individual, policy, score, total in zip(survivors, trained.best, alone.score, alone.returns, strict=True):
            if score > (individual.fitness or 0.0):
                self.ledger.policies[individual.index], self.ledger.returns[individual.index] = policy, float(total)
                self.search.update(individual.index, fitness=float(score))
        self._record_survivors("finetune")
        self.phase = self._first_phase
        return True

    def _record_survivors(self, event: str) -> None:
        for individual in self.search.survivors:
            self._record(event, individual, self.generation)

    def _record(self, event: str, individual: Individual, generation: int) -> None:
        self.ledger.add(event, individual, generation, self.env_steps)

    def _state(self) -> dict[str, Any]:
        """Returns what a killed run goes on from."""
        state = {"search": self.search.state_dict(), "env_steps": self.env_steps, "phase": self.phase}
        return state | self.ledger.state_dict()

    def _load(self, state: Mapping[str, Any]) -> None:
        self.search.load_state_dict(state["search"])
        self.env_steps, self.phase = state["env_steps"], state["phase"]
        self.ledger.load_state_dict(state)


def codesign(
    config: CodesignConfig,
    *,
    run: RunFolder | None = None,
    progress: Callable[[CodesignProgress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> CodesignResult:
    """Runs co-design to the end of its budget, and returns the best design with its controller.

    The same settings and seed give the same result, whether or not the run was stopped and resumed in between.

    Args:
        config: settings of the run.
        run: where to keep the table, controllers and checkpoints. A folder opened to resume is gone on with.
        progress: called after every update of a policy and every round of a search.
        should_stop: asked as often; by default Ctrl-C stops the run after the present update.

    Raises:
        ValueError: A run of these settings cannot start, see `CodesignConfig.check`; nothing has been simulated then.
    """
    with run.lock() if run else nullcontext():
        state, origin = Codesign(config, run), find_origin() if run else {}
        if run:
            _record(state, origin).write(run)
        with stop_on_interrupt() if should_stop is None else nullcontext(should_stop) as is_stopped:
            while not state.is_finished and not is_stopped():
                if not state.advance(progress, is_stopped):
                    break
        if run:
            _record(state, origin).write(run)
    best, policy = state.ledger.champion or (None, None)
    return CodesignResult(best, policy, state.ledger.rows, state.env_steps, state.is_finished)


def _record(state: Codesign, origin: Mapping[str, Any]) -> RunRecord:
    """Returns what the run is, and what has come of it so far."""
    config, rows, champion = state.config, state.ledger.rows, state.ledger.champion
    return RunRecord(
        "codesign",
        config.task,
        label=config.arm,
        material=ARMS[config.arm],
        stiffness={"fixed": 1.0, "prescribed": config.prescribed}.get(config.arm),
        edge_rule=config.edge_rule,
        seed=config.seed,
        finished=state.is_finished,
        env_steps=state.env_steps,
        curve=best_curve(rows),
        best=champion and champion[0].record(),
        n_designs=len({row["index"] for row in rows}),
        origin=origin,
    )
