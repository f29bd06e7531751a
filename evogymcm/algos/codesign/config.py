"""Settings of a co-design run: plain data, without torch."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, fields
from functools import partial, wraps
from typing import Any, Literal, get_args

from evogymcm._settings import check_choice, check_count, check_flag, check_number, check_numbers, check_pair
from evogymcm.algos.codesign.body_ppo import BodyPPOConfig, check_body_ppo
from evogymcm.algos.codesign.body_search import check_budget
from evogymcm.algos.codesign.genetic import check_population
from evogymcm.algos.codesign.halving import HalvingSchedule
from evogymcm.algos.runs.older import of_arm
from evogymcm.body import SAMPLE_WEIGHTS, STIFFNESS_HIGH, STIFFNESS_LOW, check_weights

__all__ = ["CodesignConfig", "SearchConfig"]

Material = Literal["invariant", "reactive"]
EdgeRule = Literal["mean_factor", "mean_stiffness"]
Method = Literal["ga", "random", "qd"]
Acceptance = Literal["reference", "paper"]
Noise = Literal["multiplicative", "additive"]
Proposal = Literal["hill-climbing", "cma"]

Check = Callable[[str, Any], Any]  # of a field's name and value; returns the value as Python has it


def _one_of(choices: Any) -> Check:
    return partial(check_choice, allowed=get_args(choices))


def _check_shape(name: str, value: Any) -> tuple[int, int]:
    rows, cols = check_pair(name, value)
    return check_count(name, rows), check_count(name, cols)


def _check_task(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{name}: got {value!r}, expected the id of a task")
    return value


def _check_search(name: str, value: Any) -> "SearchConfig":
    if not isinstance(value, SearchConfig):
        raise ValueError(f"{name}: got {value!r}, expected a SearchConfig or None")
    return value


def _check_ppo(name: str, value: Any) -> BodyPPOConfig:
    check_body_ppo(value)
    if value.network != "voxel":
        raise ValueError(f"ppo.network: got {value.network!r}, bodies differ, so it must be 'voxel'")
    defaults = BodyPPOConfig()
    for own, instead in (("seed", "seed"), ("schedule", "rungs")):
        if getattr(value, own) != getattr(defaults, own):
            raise ValueError(f"ppo.{own}: got {getattr(value, own)}, in co-design it comes from {instead}")
    return value


_CHECKS: Mapping[str, Check] = {  # of all other fields: check_count
    "task": _check_task,
    "material": _one_of(Material),
    "stiffness": partial(check_number, low=STIFFNESS_LOW, high=STIFFNESS_HIGH),
    "search": _check_search,
    "edge_rule": _one_of(EdgeRule),
    "shape": _check_shape,
    "method": _one_of(Method),
    "mutation_rate": partial(check_number, above=0.0, high=1.0),
    "weights": lambda name, value: check_weights(check_numbers(name, value)),
    "inherit": check_flag,
    "inherit_std": partial(check_number, above=0.0),
    "rungs": check_numbers,
    "keep": check_numbers,
    "age_protection": partial(check_count, low=0),
    "ppo": _check_ppo,
    "seed": partial(check_count, low=0),
    "acceptance": _one_of(Acceptance),
    "noise": _one_of(Noise),
    "proposal": _one_of(Proposal),
    "probability": partial(check_number, low=0.0, high=1.0),
    "sigma": partial(check_number, above=0.0),
}


_OPTIONAL = ("search", "max_env_steps", "inherit_std", "finetune_steps", "num_threads")


def _check_fields(config: Any) -> None:
    """Checks every field by itself, and puts its value as Python has it in its place."""
    for item in fields(config):
        value = getattr(config, item.name)
        if value is not None or item.name not in _OPTIONAL:
            object.__setattr__(config, item.name, _CHECKS.get(item.name, check_count)(item.name, value))


@dataclass(frozen=True)
class SearchConfig:
    """Material search, see `MaterialSearch`; the defaults are those of EvoGymCM's reference code.

    Attributes:
        rounds: proposals of each survivor, one after another.
        candidates: proposals of each survivor in a round, evaluated together.
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
        _check_fields(self)
        if self.proposal == "cma" and self.candidates < 2:
            raise ValueError(f"candidates: got {self.candidates}, proposal 'cma' needs at least 2")


@dataclass(frozen=True)
class CodesignConfig:
    """Everything that a co-design run depends on.

    Attributes:
        task: id of the task.
        material: "reactive" (policies set stiffness) or "invariant" (stiffness belongs to the design).
        stiffness: factor of all voxels in the invariant setting; a search begins at 1.
        search: search of the survivors' stiffness fields, with fine-tuning after it, in the invariant setting; None for
            none.
        edge_rule: how stiffness acts on shared edges.
        shape: rows and columns of the bodies.
        method: "ga" (EvoGym's genetic algorithm), "random" search, or "qd" (a quality-diversity archive, extra).
        population: P, bodies in a generation.
        budget: M, bodies trained in all.
        max_env_steps: simulated env-steps of all kinds after which the run ends (with the generation that it is in);
            None for no limit but the budget.
        mutation_rate: probability that a cell of a child is drawn anew.
        attempts: how often a valid mutant is tried for, before another parent is drawn.
        weights: relative frequencies of empty, rigid, soft, horizontal and vertical cells in random bodies and in cells
            drawn anew (EvoGym's by default).
        mutants: how many of a parent there are for each child, played once under the parent's policy; the best of them
            is trained. 1 takes the first, as EvoGym does; more need `inherit`, and the genetic algorithm.
        inherit: whether a child starts from its parent's policy instead of a fresh one; needs a method that has
            parents, and policies that are not shared, since one policy cannot start from several.
        inherit_std: standard deviation with which an inherited policy explores at first, in half ranges of the action;
            None for its own, which its parent's training has lowered.
        rungs: shares of the training budget at which bodies are compared (successive halving); none by default.
        keep: share of the bodies that go on after each rung.
        age_protection: generations in which new bodies are protected, see `GeneticAlgorithm`.
        finetune_steps: env-steps of each survivor's fine-tuning after a search; None for 1 % of the training.
        ppo: inner loop of one body. `sharing` says whether the bodies of a generation have policies of their own
            ("independent") or one; its seeds and schedules are those of the run, and not set here.
        seed: where all draws come from: bodies, mutations, weights and exploration.
        num_threads: threads of the simulator; None for all cores.

    Raises:
        ValueError: A value is of the wrong kind or out of range, or values do not go together.
    """

    task: str = "Walker-v0"
    _: KW_ONLY
    material: Material = "reactive"
    stiffness: float = 1.0
    search: SearchConfig | None = None
    edge_rule: EdgeRule = "mean_factor"
    shape: tuple[int, int] = (5, 5)
    method: Method = "ga"
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
    finetune_steps: int | None = None
    ppo: BodyPPOConfig = field(default_factory=BodyPPOConfig)
    seed: int = 0
    num_threads: int | None = 1

    def __post_init__(self) -> None:
        _check_fields(self)
        self._check_material()
        self._check_inheritance()
        if self.age_protection and self.method != "ga":
            raise ValueError(f"age_protection: got {self.age_protection}, method {self.method!r} has none (0)")
        check_budget(self.shape, self.budget, self.weights)
        if self.method == "ga":
            check_population(self.population, self.budget)
        HalvingSchedule(self.rungs, self.keep)

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
