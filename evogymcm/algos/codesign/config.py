"""Settings of a co-design run: the arm, the optimiser, the budgets, and the inner loop of one body."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from evogymcm._settings import check_choice, check_count, check_flag, check_number, check_numbers, check_pair
from evogymcm.algos.codesign.body_ppo import BodyPPOConfig, check_body_ppo
from evogymcm.algos.codesign.body_search import DesignSearch
from evogymcm.algos.codesign.design import Design
from evogymcm.algos.codesign.genetic import GeneticAlgorithm
from evogymcm.algos.codesign.halving import HalvingSchedule
from evogymcm.algos.codesign.inner_loop import Arena
from evogymcm.algos.codesign.material_search import check_search
from evogymcm.algos.codesign.random_search import RandomSearch
from evogymcm.body import H_ACT, SAMPLE_WEIGHTS, STIFFNESS_HIGH, STIFFNESS_LOW, Body, check_weights
from evogymcm.sim.scene import EDGE_RULES

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

    Raises:
        ValueError: A value is of the wrong kind or out of range, or "cma" has fewer than 2 candidates.
        ImportError: The package for CMA-ES is missing.
    """

    rounds: int = 20
    candidates: int = 1
    probability: float = 0.15
    sigma: float = 0.2
    acceptance: str = "reference"
    noise: str = "multiplicative"
    proposal: str = "hill-climbing"

    def __post_init__(self) -> None:
        for name, value in check_search(asdict(self)).items():
            object.__setattr__(self, name, value)


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
        inherit: whether a child starts from its parent's controller instead of a fresh one; needs a method that has
            parents, and policies that are not shared, since one policy cannot start from several.
        inherit_std: standard deviation with which an inherited controller explores at first, in half ranges of the
            action; None for its own, which its parent's training has lowered.
        rungs: shares of the training budget at which bodies are compared (successive halving); none by default.
        keep: share of the bodies that go on after each rung.
        age_protection: generations in which new bodies are protected, see `GeneticAlgorithm`.
        prescribed: stiffness of the "prescribed" arm.
        edge_rule: how stiffness acts on shared edges.
        search: material local search of the "invariant" arm.
        finetune_steps: env-steps of each survivor's fine-tuning in the "invariant" arm; None for 1 % of the training.
        ppo: inner loop of one body. `sharing` says whether the bodies of a generation have policies of their own
            ("independent") or one; its seeds and schedules are those of the run, and not set here.
        seed: of bodies, mutations, weights and exploration.
        num_threads: of the simulator; None for all cores.

    Raises:
        ValueError: A value is of the wrong kind or out of range, or values do not go together.
        ImportError: The package of the method or of the search's proposals is missing.
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
    ppo: BodyPPOConfig = field(default_factory=BodyPPOConfig)
    seed: int = 0
    num_threads: int | None = 1

    def __post_init__(self) -> None:
        for item in fields(self):
            object.__setattr__(self, item.name, self._checked(item.name, getattr(self, item.name)))
        self._check_inheritance()
        if self.age_protection and self.method != "ga":
            raise ValueError(f"age_protection: got {self.age_protection}, method {self.method!r} has none (0)")
        self.halving()
        self.make_search()

    def _checked(self, name: str, value: Any) -> Any:
        """Returns the value of a field as Python has it, or raises a ValueError."""
        choices = {"arm": tuple(ARMS), "method": METHODS, "edge_rule": EDGE_RULES}
        if name in choices:
            return check_choice(name, value, choices[name])
        if name in ("max_env_steps", "finetune_steps", "num_threads", "inherit_std") and value is None:
            return None
        match name:
            case "task":
                if not isinstance(value, str):
                    raise ValueError(f"task: got {value!r}, expected the id of a task")
                return value
            case "shape":
                return tuple(check_count("shape", side) for side in check_pair("shape", value))
            case "weights":
                return check_weights(check_numbers(name, value))
            case "rungs" | "keep":
                return check_numbers(name, value)
            case "inherit":
                return check_flag(name, value)
            case "mutation_rate":
                return check_number(name, value, above=0.0, high=1.0)
            case "inherit_std":
                return check_number(name, value, above=0.0)
            case "prescribed":
                return check_number(name, value, low=STIFFNESS_LOW, high=STIFFNESS_HIGH)
            case "search":
                if not isinstance(value, SearchConfig):
                    raise ValueError(f"search: got {value!r}, expected a SearchConfig")
                return value
            case "ppo":
                return _checked_ppo(value)
            case _:
                return check_count(name, value, 0 if name in ("age_protection", "seed") else 1)

    def _check_inheritance(self) -> None:
        """Raises a ValueError where children cannot start from their parents' controllers."""
        if self.inherit and self.method == "random":
            raise ValueError("inherit: got True, but with method 'random' bodies have no parents")
        if self.inherit and self.ppo.sharing == "shared":
            raise ValueError(
                "inherit: got True, but with ppo.sharing 'shared' the bodies of a generation learn one policy, which "
                "cannot start from those of several parents; set sharing 'independent'"
            )
        if self.inherit_std is not None and not self.inherit:
            raise ValueError(f"inherit_std: got {self.inherit_std}, but inherit is off")
        if self.mutants > 1 and not (self.inherit and self.method == "ga"):
            raise ValueError(
                f"mutants: got {self.mutants}, more than 1 need inherit and method 'ga', "
                f"got inherit={self.inherit}, method={self.method!r}"
            )

    def check(self) -> None:
        """Makes sure that a run can start: raises what would be raised only in the first generation.

        Raises:
            ValueError: There is no such task, or a body that fills the shape does not fit into its world.
        """
        design = Design(Body(np.full(self.shape, H_ACT)))
        self.make_arena().make([design]).close(raise_if_closed=False)

    def halving(self) -> HalvingSchedule:
        """Returns the schedule of successive halving; without rungs every body trains in full."""
        return HalvingSchedule(self.rungs, self.keep)

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
            from evogymcm.algos.codesign.map_elites import MapElites

            return MapElites(self.shape, self.budget, self.population, **options)
        return GeneticAlgorithm(self.shape, self.population, self.budget, age_protection=self.age_protection, **options)

    def make_arena(self) -> Arena:
        """Returns where designs are trained and scored."""
        return Arena(self.task, ARMS[self.arm], self.edge_rule, self.num_threads)

    def finetuning(self) -> BodyPPOConfig:
        """Returns the settings of a survivor's fine-tuning."""
        return self.ppo.finetuning(self.finetune_steps)


def _checked_ppo(ppo: Any) -> BodyPPOConfig:
    """Returns settings of the inner loop that go together with co-design, or raises a ValueError."""
    check_body_ppo(ppo)
    if ppo.network != "voxel":
        raise ValueError(f"ppo.network: got {ppo.network!r}, bodies differ, so it must be 'voxel'")
    defaults = BodyPPOConfig()
    for name, instead in (("seed", "seed"), ("schedule", "rungs")):
        if getattr(ppo, name) != getattr(defaults, name):
            raise ValueError(f"ppo.{name}: got {getattr(ppo, name)}, in co-design it comes from {instead}")
    return ppo
