"""Settings of a co-design run: the arm, the optimiser, the budgets, and the inner loop of one body."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from evogymcm.algos.design_search import DesignSearch
from evogymcm.algos.evolution import GeneticAlgorithm, HalvingSchedule, RandomSearch
from evogymcm.algos.generation import Arena
from evogymcm.algos.ppo import PPOConfig
from evogymcm.body import SAMPLE_WEIGHTS, STIFFNESS_HIGH, STIFFNESS_LOW

__all__ = ["ARMS", "METHODS", "CodesignConfig", "SearchConfig"]

ARMS: Mapping[str, str] = {  # -> material setting
    "reactive": "reactive",
    "fixed": "invariant",
    "invariant": "invariant",
    "prescribed": "invariant",
}
METHODS = ("ga", "random", "qd")


@dataclass(frozen=True)
class SearchConfig:
    """Material local search, see `MaterialSearch`; the defaults are those of EvoGymCM's reference code.

    Attributes:
        rounds: proposals of each survivor, one after another.
        candidates: proposals of each survivor in a round, evaluated together.
        probability: of a voxel to be changed in a proposal.
        sigma: standard deviation of its noise; with CMA-ES, the initial step in the logarithm of stiffness.
        acceptance: "reference" (gains of 2 % or more) or "paper" (any gain).
        noise: "multiplicative" (reference code) or "additive" (paper).
        proposal: "hill-climbing" or "cma" (extra).
    """

    rounds: int = 20
    candidates: int = 1
    probability: float = 0.15
    sigma: float = 0.2
    acceptance: str = "reference"
    noise: str = "multiplicative"
    proposal: str = "hill-climbing"


@dataclass(frozen=True)
class CodesignConfig:
    """Everything that a co-design run depends on.

    Attributes:
        task: id of the task.
        arm: "reactive", "fixed", "invariant" or "prescribed".
        shape: rows and columns of the bodies.
        method: "ga" (EvoGym's genetic algorithm), "random" search, or "qd" (a quality-diversity archive, extra).
        population: P, bodies in a generation.
        budget: M, bodies trained in all.
        max_env_steps: simulated env-steps of all kinds after which the run ends (with the generation that it is in);
            None for no limit but the budget.
        mutation_rate: probability that a cell of a child is drawn anew.
        attempts: at a valid mutant, before another parent is drawn.
        weights: relative frequencies of empty, rigid, soft, horizontal and vertical cells in random bodies and in cells
            drawn anew (EvoGym's by default).
        mutants: of a parent for each child, played once under the parent's controller; the best of them is trained. 1
            takes the first, as EvoGym does; more need `inherit`, and the genetic algorithm.
        inherit: whether a child starts from its parent's controller instead of a fresh one.
        inherit_std: standard deviation with which an inherited controller explores at first, in half ranges of the
            action; None for its own, which its parent's training has lowered.
        rungs: shares of the training budget at which bodies are compared (successive halving); none by default.
        keep: share of the bodies that go on after each rung.
        age_protection: generations in which new bodies are protected, see `GeneticAlgorithm`.
        prescribed: stiffness of the "prescribed" arm.
        edge_rule: how stiffness acts on shared edges.
        search: material local search of the "invariant" arm.
        finetune_steps: env-steps of each survivor's fine-tuning in the "invariant" arm; None for 1 % of the training.
        ppo: inner loop of one body: its env-steps, its worlds, its share of a gradient step. `sharing` says whether the
            bodies of a generation have policies of their own ("independent") or one.
        seed: of bodies, mutations, weights and exploration.
        num_threads: of the simulator.
    """

    task: str = "Walker-v0"
    arm: str = "reactive"
    shape: tuple[int, int] = (5, 5)
    method: str = "ga"
    population: int = 8
    budget: int = 32
    max_env_steps: int | None = None
    mutation_rate: float = 0.1
    attempts: int = 50
    weights: tuple[float, ...] = SAMPLE_WEIGHTS
    mutants: int = 1
    inherit: bool = False
    inherit_std: float | None = None
    rungs: tuple[float, ...] = ()
    keep: tuple[float, ...] = ()
    age_protection: int = 0
    prescribed: float = 1.0
    edge_rule: str = "mean_factor"
    search: SearchConfig = field(default_factory=SearchConfig)
    finetune_steps: int | None = None
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(
            total_steps=100_000,
            num_worlds=16,
            minibatch=128,
            eval_interval=10_000,
            sharing="independent",
        )
    )
    seed: int = 0
    num_threads: int | None = 1

    def __post_init__(self) -> None:
        for name, allowed in (("arm", tuple(ARMS)), ("method", METHODS)):
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name}: got {getattr(self, name)!r}, allowed are {allowed}")
        if not STIFFNESS_LOW <= self.prescribed <= STIFFNESS_HIGH:
            raise ValueError(f"prescribed: got {self.prescribed}, allowed is {STIFFNESS_LOW} to {STIFFNESS_HIGH}")
        if self.max_env_steps is not None and self.max_env_steps < 1:
            raise ValueError(f"max_env_steps: got {self.max_env_steps}, must be positive")
        if self.finetune_steps is not None and self.finetune_steps < 1:
            raise ValueError(f"finetune_steps: got {self.finetune_steps}, must be positive")
        if self.inherit_std is not None and not (self.inherit and 0.0 < self.inherit_std < np.inf):
            raise ValueError(f"inherit_std: got {self.inherit_std}, must be positive, and inherit must be on")
        if self.mutants < 1 or (self.mutants > 1 and not (self.inherit and self.method == "ga")):
            raise ValueError(
                f"mutants: got {self.mutants}, must be at least 1; more need inherit and method 'ga', "
                f"got inherit={self.inherit}, method={self.method!r}"
            )
        if self.ppo.network != "voxel":
            raise ValueError(f"ppo.network: got {self.ppo.network!r}, bodies differ, so it must be 'voxel'")
        self.halving()
        self.make_search()

    def halving(self) -> HalvingSchedule:
        """Returns the schedule of successive halving; without rungs every body trains in full."""
        return HalvingSchedule(tuple(self.rungs), tuple(self.keep))

    def make_search(self) -> DesignSearch:
        """Returns the optimiser over designs, before its first generation."""
        if self.method == "random":
            return RandomSearch(self.shape, self.budget, self.population, self.seed, self.weights)
        options: dict[str, Any] = {
            "seed": self.seed,
            "mutation_rate": self.mutation_rate,
            "attempts": self.attempts,
            "carries_stiffness": self.arm == "invariant",
            "weights": self.weights,
        }
        if self.method == "qd":
            from evogymcm.algos.archive import MapElites

            return MapElites(self.shape, self.budget, self.population, **options)
        return GeneticAlgorithm(self.shape, self.population, self.budget, age_protection=self.age_protection, **options)

    def make_arena(self) -> Arena:
        """Returns where designs are trained and scored."""
        return Arena(self.task, ARMS[self.arm], self.edge_rule, self.num_threads)

    def finetuning(self) -> PPOConfig:
        """Returns the settings of a survivor's fine-tuning: on from where its schedules ended."""
        steps = self.finetune_steps or max(1, self.ppo.total_steps // 100)
        rate, std = self.ppo.learning_rate / 4, self.ppo.final_std
        return replace(self.ppo, total_steps=steps, learning_rate=rate, initial_std=std, eval_interval=steps)
