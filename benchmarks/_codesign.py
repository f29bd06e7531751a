"""Experiments B and C of the EvoGymCM paper: co-design with and without material, at equal simulated env-steps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from _suite import PAPER

from evogymcm.algos import BodyPPOConfig, RunFolder
from evogymcm.algos.codesign import CodesignConfig, SearchConfig, codesign, cost_of

EXPERIMENTS: Mapping[str, tuple[str, str]] = {"B": ("fixed", "reactive"), "C": ("prescribed", "invariant")}
PUBLISHED_BODIES = 100  # trained in all by published runs of EvoGym's genetic algorithm


@dataclass(frozen=True)
class CodesignSuite:
    """What to run: every task in both arms of an experiment, with every seed."""

    experiment: str
    tasks: tuple[str, ...]
    arms: tuple[str, ...]
    seeds: tuple[int, ...]
    base: CodesignConfig = field(default_factory=CodesignConfig)

    def __post_init__(self) -> None:
        if self.experiment not in EXPERIMENTS:
            raise ValueError(f"experiment: got {self.experiment!r}, allowed are {sorted(EXPERIMENTS)}")
        allowed_arms = EXPERIMENTS[self.experiment]
        for name, given, allowed in (("task", self.tasks, tuple(PAPER)), ("arm", self.arms, allowed_arms)):
            unknown = [item for item in given if item not in allowed]
            if unknown:
                raise ValueError(f"{name}: got {unknown}, allowed are {sorted(allowed)}")
        if not (self.tasks and self.arms and self.seeds):
            raise ValueError("tasks, arms and seeds must not be empty")

    @property
    def steps_per_run(self) -> int:
        """The most env-steps of all kinds that a run takes, but for what it goes beyond a limit."""
        limit = self.base.max_env_steps or np.inf
        return int(min(limit, max(cost_of(job.config).total for job in self.jobs())))

    def jobs(self) -> list["CodesignJob"]:
        """Returns all runs, seed by seed, so that an early stop leaves whole comparisons."""
        return [
            CodesignJob(self.experiment, replace(self.base, task=task, arm=arm, seed=seed))
            for seed in self.seeds
            for task in self.tasks
            for arm in self.arms
        ]


@dataclass(frozen=True)
class CodesignJob:
    """One co-design run."""

    experiment: str
    config: CodesignConfig

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return f"{self.config.task}-{self.config.arm}-seed{self.config.seed}"

    def run(
        self, folder: Path, resume: bool, tell: Callable[[int, float | None], None], should_stop: Callable[[], bool]
    ) -> dict[str, Any]:
        """Searches in `folder / name` and returns all numbers of the run."""
        run = RunFolder(folder / self.name, asdict(self.config), resume=resume)
        result = codesign(
            self.config,
            run=run,
            progress=lambda state: tell(state.env_steps, state.best),
            should_stop=should_stop,
        )
        record: dict[str, Any] = {
            "experiment": self.experiment,
            "task": self.config.task,
            "arm": self.config.arm,
            "seed": self.config.seed,
            "finished": result.finished,
            "env_steps": result.env_steps,
            "bodies": len({row["index"] for row in result.rows}),
            "best": None if result.best is None else result.best.record(),
            "best_return": max((row["return"] for row in result.rows), default=None),
            "curve": curve(result.rows),
        }
        run.write_json("result.json", record)
        return record


def curve(rows: Sequence[Mapping[str, Any]]) -> list[list[float]]:
    """Returns (env-steps, best fitness so far), one point for each phase that ended."""
    points: dict[int, float] = {}
    for row in rows:
        points[row["env_steps"]] = row["best"]
    return [[steps, best] for steps, best in sorted(points.items())]


def _suite(
    experiment: str,
    tasks: tuple[str, ...],
    seeds: tuple[int, ...],
    base: CodesignConfig,
    arms: tuple[str, ...] | None = None,
) -> CodesignSuite:
    return CodesignSuite(experiment, tasks, arms or EXPERIMENTS[experiment], seeds, base)


_SMALL = CodesignConfig(
    population=6, budget=1000, max_env_steps=600_000, finetune_steps=4_096, ppo=BodyPPOConfig(total_steps=25_000)
)
_SHORTCUTS = replace(  # policy inheritance and successive halving: lineages learn on, the worse half is dropped early
    _SMALL,
    population=8,
    budget=32,
    max_env_steps=900_000,
    inherit=True,
    rungs=(0.3,),
    keep=(0.5,),
    ppo=BodyPPOConfig(total_steps=50_000),
)
_SCREENING = replace(  # and children chosen from mutants, so that fewer need be trained
    _SHORTCUTS,
    budget=1000,
    max_env_steps=1_500_000,
    inherit_std=0.6,
    mutants=8,
    rungs=(0.25,),
    keep=(0.3,),
    ppo=BodyPPOConfig(total_steps=40_960),
)
_MEDIUM = replace(
    _SMALL,
    population=12,
    max_env_steps=10_000_000,
    finetune_steps=10_000,
    ppo=BodyPPOConfig(total_steps=200_000, num_worlds=32),
)
_PAPER = replace(
    _SMALL,
    population=25,
    budget=100,
    max_env_steps=None,
    finetune_steps=10_000,
    ppo=BodyPPOConfig(total_steps=1_000_000, num_worlds=64, minibatch=512),
)
_QUICK = replace(_SMALL, max_env_steps=150_000, ppo=BodyPPOConfig(total_steps=10_000))
_HUNDRED = replace(_SMALL, budget=PUBLISHED_BODIES, max_env_steps=None, inherit=True)
_HUNDRED_REACTIVE = replace(  # all learn for 80,000 env-steps, then the best fifth for 160,000 more
    _HUNDRED,
    population=12,
    inherit_std=0.6,
    rungs=(1 / 3,),
    keep=(0.2,),
    ppo=BodyPPOConfig(total_steps=240_000, num_worlds=32, eval_interval=20_000),
)
_HUNDRED_INVARIANT = replace(  # fewer env-steps of training; survivors are searched and trained on
    _HUNDRED,
    population=20,
    rungs=(0.125, 0.3),
    keep=(0.4, 0.3),
    finetune_steps=20_000,
    ppo=BodyPPOConfig(total_steps=160_000, num_worlds=32),
)
_HUNDRED_EXPLORING = replace(  # wide exploration at first, and more than their parent's in children
    _HUNDRED,
    population=12,
    inherit_std=1.0,
    rungs=(0.25,),
    keep=(1 / 3,),
    search=SearchConfig(rounds=4, candidates=4),
    finetune_steps=10_000,
    ppo=BodyPPOConfig(total_steps=160_000, num_worlds=32, initial_std=2.0),
)
_HUNDRED_SCREENING = replace(_HUNDRED_EXPLORING, mutants=64)  # children are chosen by their parent's policy
_HUNDRED_SPARSE = replace(  # for low ceilings: bodies of few voxels, a long horizon and exploration that lasts
    _HUNDRED_EXPLORING,
    population=16,
    weights=(1.6, 0.2, 0.2, 0.2, 0.2),
    mutants=16,
    inherit_std=1.5,
    rungs=(0.4,),
    keep=(0.5,),
    ppo=BodyPPOConfig(total_steps=160_000, num_worlds=32, gamma=0.999, initial_std=2.0, final_std=0.6),
)

PRESETS: Mapping[str, CodesignSuite] = {
    "reactive-quick": _suite("B", ("AreaMaximizer-v0",), (0,), _QUICK),
    "reactive-small": _suite("B", ("AreaMaximizer-v0", "DownStepper-v0"), (0, 1, 2), _SMALL),
    "reactive-shortcuts": _suite("B", ("AreaMaximizer-v0", "DownStepper-v0"), (0, 1, 2), _SHORTCUTS),
    "reactive-screening": _suite("B", ("AreaMaximizer-v0", "DownStepper-v0"), (0, 1, 2), _SCREENING),
    "reactive-medium": _suite("B", ("AreaMaximizer-v0", "DownStepper-v0"), (0, 1, 2), _MEDIUM),
    "reactive-paper": _suite("B", tuple(PAPER), (0, 1, 2), _PAPER),
    "hundred-bodies-reactive": _suite("B", tuple(PAPER), (0,), _HUNDRED_REACTIVE, ("reactive",)),
    "invariant-quick": _suite("C", ("BridgeWalker-v0",), (0,), _QUICK),
    "invariant-small": _suite("C", ("BridgeWalker-v0", "Walker-v0"), (0, 1, 2), _SMALL),
    "invariant-shortcuts": _suite("C", ("BridgeWalker-v0", "Walker-v0"), (0, 1, 2), _SHORTCUTS),
    "invariant-medium": _suite("C", ("BridgeWalker-v0", "Walker-v0"), (0, 1, 2), _MEDIUM),
    "invariant-paper": _suite("C", tuple(PAPER), (0, 1, 2), _PAPER),
    "hundred-bodies-invariant": _suite("C", tuple(PAPER), (0,), _HUNDRED_INVARIANT, ("invariant",)),
    "hundred-bodies-exploring-invariant": _suite("C", tuple(PAPER), (0,), _HUNDRED_EXPLORING, ("invariant",)),
    "hundred-bodies-screening-invariant": _suite("C", tuple(PAPER), (0,), _HUNDRED_SCREENING, ("invariant",)),
    "hundred-bodies-sparse-prescribed": _suite("C", tuple(PAPER), (0,), _HUNDRED_SPARSE, ("prescribed",)),
}
