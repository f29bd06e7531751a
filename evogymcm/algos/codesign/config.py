"""Settings of a co-design run: plain data, without torch."""

import warnings
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from functools import wraps
from itertools import pairwise
from math import ceil
from typing import Any, Literal

from evogymcm._settings import (
    EdgeRule,
    Material,
    WorkWeight,
    check_count,
    check_fields,
    check_numbers,
    check_pair,
    check_work_weight,
)
from evogymcm.algos.codesign.body_ppo import BodyPPOConfig, check_body_ppo
from evogymcm.algos.codesign.body_search import check_budget
from evogymcm.algos.codesign.genetic import check_population
from evogymcm.algos.learning.config import INITIAL, Selection, check_initial, check_selection
from evogymcm.algos.runs.older import of_arm
from evogymcm.body import SAMPLE_WEIGHTS, STIFFNESS_HIGH, STIFFNESS_LOW, check_weights

Method = Literal["ga", "random", "qd"]
Acceptance = Literal["reference", "paper"]
Noise = Literal["multiplicative", "additive"]
Proposal = Literal["hill-climbing", "cma"]

_BOUNDS: dict[str, dict[str, float]] = {  # counts without any: from 1
    "stiffness": {"low": STIFFNESS_LOW, "high": STIFFNESS_HIGH},
    "mutation_rate": {"above": 0, "high": 1},
    "inherit_std": {"above": 0},
    "age_protection": {"low": 0},
    "seed": {"low": 0},
    "probability": {"low": 0, "high": 1},
    "sigma": {"above": 0},
}


@dataclass(frozen=True)
class SearchConfig:
    """Material search, see `MaterialSearch`; the defaults are those of EvoGymCM's reference code.

    Attributes:
        rounds: rounds of proposals, one after another.
        candidates: proposals for each survivor in a round, evaluated together.
        probability: how likely a voxel is to be changed in a proposal.
        sigma: standard deviation of its noise; with CMA-ES, the initial step in the logarithm of stiffness.
        acceptance: "reference" (gains of 2 % or more) or "paper" (any gain).
        noise: "multiplicative" (reference code) or "additive" (paper).
        proposal: "hill-climbing" or "cma" (extra).

    Raises:
        ValueError: A value is of the wrong kind or out of range, or "cma" has fewer than 2 candidates.
    """

    rounds: int = 20
    candidates: int = 1
    probability: float = 0.15
    sigma: float = 0.2
    acceptance: Acceptance = "reference"
    noise: Noise = "multiplicative"
    proposal: Proposal = "hill-climbing"

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)
        if self.proposal == "cma" and self.candidates < 2:
            raise ValueError(f"candidates: got {self.candidates}, proposal 'cma' needs at least 2")


@dataclass(frozen=True)
class HalvingSchedule:
    """Successive halving (Jamieson and Talwalkar, 2016): all bodies train a little, the better ones continue.

    Attributes:
        rungs: shares of the full budget of training after which bodies are compared, rising, each between 0 and 1.
        keep: share of the bodies that continue after each rung, each above 0 and at most 1.

    Raises:
        ValueError: The rungs do not rise within 0 to 1, or there is not one share in (0, 1] for each.
    """

    rungs: tuple[float, ...] = (0.25, 0.5)
    keep: tuple[float, ...] = (0.5, 0.5)

    def __post_init__(self) -> None:
        for name in ("rungs", "keep"):
            object.__setattr__(self, name, check_numbers(name, getattr(self, name)))
        bounds = (0.0, *self.rungs, 1.0)
        if not all(low < high for low, high in pairwise(bounds)):
            raise ValueError(f"rungs: got {self.rungs}, expected rising shares of the budget, above 0 and below 1")
        if len(self.keep) != len(self.rungs) or not all(0.0 < share <= 1.0 for share in self.keep):
            raise ValueError(f"keep: got {self.keep}, expected {len(self.rungs)} shares, above 0 and at most 1")

    def count(self, rung: int, n_bodies: int) -> int:
        """Returns how many of `n_bodies` continue after a rung: the share kept, rounded up."""
        return ceil(round(self.keep[rung] * n_bodies, 9))  # rounded before: 0.07 * 100 is above 7 in floats

    def cost(self, n_bodies: int) -> float:
        """Returns the training of `n_bodies` in full budgets: `n_bodies` without halving."""
        total, reached = 0.0, 0.0
        for rung, share in enumerate(self.rungs):
            total += n_bodies * (share - reached)
            n_bodies, reached = self.count(rung, n_bodies), share
        return total + n_bodies * (1.0 - reached)


@dataclass(frozen=True)
class CodesignConfig:
    """Everything that a co-design run depends on.

    Attributes:
        task: id of the task.
        material: "reactive" (policies set stiffness) or "invariant" (stiffness belongs to the design).
        stiffness: factor of all voxels in the invariant setting; a search starts from 1.
        search: search of the survivors' stiffness fields, followed by fine-tuning, in the invariant setting; None for
            no search.
        edge_rule: how stiffness acts on shared edges.
        work_weight: what a unit of supplied work costs in the reward that policies learn from, see `TrainConfig`;
            fitness is the score of the task all the same.
        shape: rows and columns of the bodies.
        method: "ga" (EvoGym's genetic algorithm), "random" search, or "qd" (a quality-diversity archive, extra).
        population: P, bodies in a generation.
        budget: M, bodies trained in all.
        max_env_steps: simulated env-steps of all kinds after which the run ends (with the generation that it is in);
            None for no limit but the budget.
        mutation_rate: probability that a cell of a child is drawn anew.
        attempts: attempts at a valid mutant before another parent is drawn.
        weights: relative frequencies of empty, rigid, soft, horizontal and vertical cells in random bodies and in cells
            drawn anew (EvoGym's by default).
        mutants: mutants of one parent for each child, each played once from the exact start under the policy of that
            parent; the best is trained. 1 takes the first, as EvoGym does; more need `inherit` and the genetic
            algorithm.
        initial: what the weights of policies are at first, see `TrainConfig`; those of children too, unless they
            inherit.
        inherit: whether a child starts from its parent's policy instead of `initial`; needs a method that has
            parents, and policies that are not shared, since one policy cannot start from several.
        inherit_std: standard deviation with which an inherited policy explores at first, in half ranges of the action;
            None for that of its parent, which training has lowered.
        rungs: shares of the training budget at which bodies are compared (successive halving); none by default.
        keep: share of the bodies that continue after each rung.
        age_protection: generations in which new bodies are protected, see `GeneticAlgorithm`.
        finetune_steps: env-steps of fine-tuning for each survivor after a search; None for 1 % of its training.
        eval_starts: number of starts, 1e-6 metres apart, from which a design is scored, see `evaluate`.
        selection: what fitness is: the score from the exact start, or the "robust" one, the mean over several starts.
            `ppo` says which policy of a training is the best one.
        ppo: settings of the inner loop for one body. `sharing` says whether the bodies of a generation have policies of
            their own ("independent") or share one; seeds and schedules come from the run and are not set here.
        piece: designs of a generation that are worked on in one batch, independently of all others: what a worker takes
            at a time, see `codesign`. More take less time together, and leave less to spread; None takes all at once.
        seed: seed of all random draws: bodies, mutations, weights and exploration.
        num_threads: threads of the simulator; None for all cores.

    Raises:
        ValueError: A value is of the wrong kind or out of range, or values contradict each other.
    """

    task: str = "Walker-v0"
    _: KW_ONLY
    material: Material = "reactive"
    stiffness: float = 1.0
    search: SearchConfig | None = None
    edge_rule: EdgeRule = "mean_factor"
    work_weight: WorkWeight = None
    shape: tuple[int, int] = (5, 5)
    method: Method = "ga"
    population: int = 8
    budget: int = 32
    max_env_steps: int | None = None
    mutation_rate: float = 0.1
    attempts: int = 50
    weights: tuple[float, ...] = SAMPLE_WEIGHTS
    mutants: int = 1
    initial: str = INITIAL
    inherit: bool = False
    inherit_std: float | None = None
    rungs: tuple[float, ...] = ()
    keep: tuple[float, ...] = ()
    age_protection: int = 0
    finetune_steps: int | None = None
    eval_starts: int = 1
    selection: Selection = "score"
    ppo: BodyPPOConfig = field(default_factory=BodyPPOConfig)
    piece: int | None = 4
    seed: int = 0
    num_threads: int | None = 1

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)
        halving = HalvingSchedule(self.rungs, self.keep)
        rows, cols = (check_count("shape", side) for side in check_pair("shape", self.shape))
        weights = check_weights(check_numbers("weights", self.weights))
        given: dict[str, Any] = {"shape": (rows, cols), "weights": weights, "initial": check_initial(self.initial)}
        given["work_weight"] = check_work_weight(self.work_weight)
        for name, value in (given | vars(halving)).items():
            object.__setattr__(self, name, value)
        if not isinstance(self.task, str):
            raise ValueError(f"task: got {self.task!r}, expected the id of a task")
        if not isinstance(self.search, SearchConfig | None):
            raise ValueError(f"search: got {self.search!r}, expected a SearchConfig or None")
        self._check_ppo()
        self._check_material()
        self._check_inheritance()
        check_selection(self.selection, self.eval_starts)
        check_budget(self.shape, self.budget, self.weights)
        if self.method == "ga":
            check_population(self.population, self.budget)
        elif self.age_protection:
            raise ValueError(f"age_protection: got {self.age_protection}, method {self.method!r} has none (0)")

    def _check_ppo(self) -> None:
        """Raises a ValueError where the inner loop does not go together with co-design."""
        check_body_ppo(self.ppo)
        if self.ppo.network != "voxel":
            raise ValueError(f"ppo.network: got {self.ppo.network!r}, bodies differ, so it must be 'voxel'")
        defaults = BodyPPOConfig()
        for name, instead in (("seed", "seed"), ("schedule", "rungs")):
            if getattr(self.ppo, name) != getattr(defaults, name):
                raise ValueError(f"ppo.{name}: got {getattr(self.ppo, name)}, in co-design it comes from {instead}")

    def _check_material(self) -> None:
        """Raises a ValueError where stiffness is asked for that the run does not have."""
        if self.material == "reactive" and (self.stiffness != 1.0 or self.search):
            name = "search" if self.search else "stiffness"
            raise ValueError(f"{name}: got {getattr(self, name)}, policies set stiffness; needs material 'invariant'")
        if self.search and self.stiffness != 1.0:
            raise ValueError(f"stiffness: got {self.stiffness}, a search begins at 1")

    def _check_inheritance(self) -> None:
        """Raises a ValueError where children cannot start from their parents' policies."""
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


def _with_old_words(init: Callable[..., None]) -> Callable[..., None]:
    """Returns a constructor that takes `arm` and `prescribed` too, for one version."""

    @wraps(init)
    def take(self: CodesignConfig, *args: Any, **settings: Any) -> None:
        if {"arm", "prescribed"} & settings.keys():
            arm, value = settings.pop("arm", "reactive"), settings.pop("prescribed", settings.get("stiffness", 1.0))
            now = of_arm(arm, value, settings.get("search") or SearchConfig())
            said = ", ".join(f"{name}={value!r}" for name, value in now.items())
            warnings.warn(f"arm={arm!r} is of before and will go; write {said}", DeprecationWarning, stacklevel=2)
            settings |= now
        init(self, *args, **settings)

    return take


CodesignConfig.__init__ = _with_old_words(CodesignConfig.__init__)  # type: ignore[method-assign]
