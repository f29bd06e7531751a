"""Search of gaits: the wave that drives each of several bodies furthest."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evogymcm._extras import load_cma
from evogymcm._settings import check_fields
from evogymcm.algos.gaits.wave import Waves
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.dealing import as_bodies

_BOUNDS: dict[str, dict[str, float]] = {"sigma": {"above": 0}, "seed": {"low": 0}, "early": {"low": 0, "high": 1}}


@dataclass(frozen=True)
class GaitConfig:
    """Settings of a search of gaits.

    Attributes:
        env_steps: Env-steps for each design; the search ends before the generation that would exceed them.
        first: Gaits of the first generation, drawn at random.
        candidates: Gaits of each later generation of a design's CMA-ES.
        trial_steps: Env-steps of the early trials; None for whole episodes from the start.
        early: Share of the env-steps that goes into early trials; after it gaits are played for whole episodes, the
            last generation first.
        sigma: Step of CMA-ES at the start, from the best of the first generation.
        seed: Seed of the search and of the tasks' draws.

    Raises:
        ValueError: A value is of the wrong kind or out of range.
    """

    env_steps: int = 50_000
    first: int = 32
    candidates: int = 8
    trial_steps: int | None = 150
    early: float = 0.5
    sigma: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)
        if self.candidates < 2:
            raise ValueError(f"candidates: got {self.candidates}, at least 2 are needed")


@dataclass(frozen=True)
class FoundGaits:
    """The best gait of each design.

    Attributes:
        waves: The gaits.
        score: (D,) scores of their trials.
        env_steps: (D,) env-steps simulated for each.
        curve: Env-steps for each design so far (mean over designs) and (D,) best scores, after each generation.
        finished: False if the search was stopped.
    """

    waves: Waves
    score: NDArray[np.float64]
    env_steps: NDArray[np.int64]
    curve: list[tuple[float, NDArray[np.float64]]]
    finished: bool


class _Design:
    """The search for one design: random gaits, then CMA-ES around the best of them."""

    def __init__(self, index: int, size: int, config: GaitConfig) -> None:
        self.config = config
        self.rng = np.random.default_rng([config.seed, index])
        self.points = self.rng.standard_normal((config.first, size))
        self.optimizer: Any = None
        self.pending: NDArray[np.float64] | None = None
        self.best, self.score = self.points[0], -np.inf

    def begin_whole(self) -> None:
        """Compares gaits by whole episodes from now on: scores of early trials say no more."""
        self.score = -np.inf
        self.pending = self.best

    def ask(self) -> NDArray[np.float64]:
        if self.optimizer is not None:
            self.points = np.array(self.optimizer.ask())
            if self.pending is not None:
                self.points[0], self.pending = self.pending, None
        return self.points

    def tell(self, scores: NDArray[np.float64]) -> None:
        scores = np.where(np.isfinite(scores), scores, -1e9)
        leader = int(scores.argmax())
        if scores[leader] > self.score:
            self.best, self.score = self.points[leader].copy(), float(scores[leader])
        if self.optimizer is not None:
            self.optimizer.tell(list(self.points), (-scores).tolist())  # it minimises
            return
        options = {
            "popsize": self.config.candidates,
            "verbose": -9,
            "seed": np.nan,  # none; `randn` takes the place of numpy's global generator
            "randn": lambda *shape: self.rng.standard_normal(shape),
        }
        self.optimizer = load_cma().CMAEvolutionStrategy(self.best, self.config.sigma, options)


def search_gaits(
    task: Any,
    bodies: Any,
    config: GaitConfig | None = None,
    *,
    progress: Callable[[float, NDArray[np.float64]], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    **options: Any,
) -> FoundGaits:
    """Returns the best gait that a search finds for each body, all bodies in one batch.

    Each design has a search of its own, whose result depends neither on the others nor on the number of threads. Needs
    the extra `evogymcm[cma]`.

    Args:
        task: A task or its id.
        bodies: A body or several, as `TaskEngine` takes them.
        config: Settings.
        progress: Called after each generation with the env-steps for each design and the (D,) best scores so far.
        should_stop: Called after each generation; if it returns True, the search ends.
        **options: Of the worlds: material, stiffness, edge_rule, physics, num_threads, see `EngineOptions`.

    Raises:
        ValueError: As `TaskEngine`, or the budget is below a first generation.
    """
    load_cma()
    config = config or GaitConfig()
    designs = as_bodies(bodies)
    n, material = len(designs), options.get("material", "invariant")
    searches = [_Design(index, Waves.size(material), config) for index in range(n)]
    used = np.zeros(n, np.int64)
    curve: list[tuple[float, NDArray[np.float64]]] = []
    finished, is_early, engines = True, config.trial_steps is not None, _Stages(task, designs, options)
    try:
        while True:
            limit = config.trial_steps if used.max() < config.early * config.env_steps else None
            if limit is None and is_early:
                is_early = False
                for search in searches:
                    search.begin_whole()
            points = [search.ask() for search in searches]
            cost = len(points[0]) * engines.steps(limit)
            if used.max() + cost > config.env_steps:
                if not curve:
                    raise ValueError(
                        f"env_steps: got {config.env_steps}, a first generation of {config.first} takes {cost}"
                    )
                break
            scores, lengths = engines.play(np.array(points), limit, config.seed + len(curve))
            used += lengths
            for search, row in zip(searches, scores, strict=True):
                search.tell(row)
            best = np.array([search.score for search in searches])
            curve.append((float(used.mean()), best))
            if progress:
                progress(*curve[-1])
            if should_stop and should_stop():
                finished = False
                break
    finally:
        engines.close()
    return FoundGaits(Waves([search.best for search in searches]), best, used, curve, finished)


class _Stages:
    """Worlds of the designs: one engine for each number of candidates."""

    def __init__(self, task: Any, designs: Sequence[Any], options: dict[str, Any]) -> None:
        self.task, self.designs, self.options = task, designs, options
        self.engine: TaskEngine | None = None

    def _with(self, worlds: int) -> TaskEngine:
        if self.engine is None or self.engine.num_worlds != worlds:
            self.close()
            self.engine = TaskEngine(
                self.task, self.designs, worlds, with_voxels=False, with_flat=False, **self.options
            )
        return self.engine

    def steps(self, limit: int | None) -> int:
        """Env-steps of a trial at most."""
        most = self._with(len(self.designs) if self.engine is None else self.engine.num_worlds).task.time_limit
        return most if limit is None else min(limit, most)

    def play(self, points: NDArray[np.float64], limit: int | None, seed: int) -> tuple[NDArray, NDArray]:
        """Plays (D, C, P) gaits; returns their scores, (D, C), and the env-steps of each design, (D,)."""
        n, count, size = points.shape
        engine = self._with(n * count)
        engine.set_seed([seed] * engine.num_worlds)
        engine.reset()
        gait = Waves(points.swapaxes(0, 1).reshape(-1, size))  # candidate by candidate, each of all designs
        running = np.ones(engine.num_worlds, bool)
        for _ in range(self.steps(limit)):
            engine.step(*gait(engine), mask=None if running.all() else running)
            running &= ~(engine.terminated | engine.truncated)
            if not running.any():
                break
        scores, lengths = engine.score.reshape(count, n).T, engine.length.reshape(count, n).T
        return scores.copy(), lengths.sum(1)

    def close(self) -> None:
        """Closes the worlds."""
        if self.engine is not None:
            self.engine.close()
            self.engine = None
