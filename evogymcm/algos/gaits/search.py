"""Search of gaits: the wave that brings each of several bodies furthest."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from evogymcm._extras import load_cma
from evogymcm.algos.gaits.config import GaitConfig
from evogymcm.algos.gaits.wave import Waves
from evogymcm.body import Body
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.dealing import as_bodies
from evogymcm.envs.options import WorldOptions
from evogymcm.envs.tasks import as_task

_WORST = -1e9  # for scores that are no numbers


@dataclass(frozen=True)
class FoundGaits:
    """The best gait of each of D designs.

    Attributes:
        waves: The gaits, to be used with `play` and `evaluate`.
        score: (D,) their scores in the search: of whole episodes, unless it was stopped before there were any.
        env_steps: (D,) env-steps simulated for each design.
        curve: After each generation: env-steps simulated so far (mean over designs), the length of its trials, and
            the (D,) best scores in trials of that length so far.
        finished: False if the search was stopped.
    """

    waves: Waves
    score: NDArray[np.float64]
    env_steps: NDArray[np.int64]
    curve: list[tuple[float, int, NDArray[np.float64]]]
    finished: bool


def search_gaits(
    task: Any,
    bodies: Any,
    config: GaitConfig | None = None,
    *,
    progress: Callable[[int, NDArray[np.float64]], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    **options: Unpack[WorldOptions],
) -> FoundGaits:
    """Returns the best gait that a search finds for each body; needs the extra `evogymcm[cma]`.

    All bodies are simulated in one batch, but each design has a search of its own, whose result depends neither on the
    others nor on the number of threads.

    Args:
        task: A task or its id.
        bodies: A body or several, as `TaskEngine` takes them; D designs.
        config: Settings of the search.
        progress: Called after each generation with the env-steps of each design so far, of `config.env_steps`, and the
            (D,) best scores.
        should_stop: Called after each generation; if it returns True, the search ends.
        **options: Of the worlds, such as material and stiffness, see `WorldOptions`.

    Raises:
        ValueError: As `TaskEngine`; or the env-steps are not enough for the first generation and a whole episode.
        ImportError: The package cma is missing.
    """
    config, task, designs = config or GaitConfig(), as_task(task), as_bodies(bodies)
    short, episode = trial_lengths(task, config)
    size = Waves.size(options.get("material", "invariant"))
    searches = [_Search(np.random.default_rng([config.seed, index]), size, config) for index in range(len(designs))]
    used, planned, limit = np.zeros(len(designs), np.int64), 0, short
    curve: list[tuple[float, int, NDArray[np.float64]]] = []
    last_early = min(config.early * config.env_steps, config.env_steps - (config.candidates + 1) * episode)
    finished = True
    with _Worlds(task, designs, options) as worlds:
        while True:
            generation = config.candidates if curve else config.first
            if curve and limit < episode and planned + generation * short > last_early:
                limit, generation = episode, generation + 1
                for search in searches:
                    search.begin_anew()
            if planned + generation * limit > config.env_steps:
                break
            points = np.array([search.ask() for search in searches])
            scores, lengths = worlds.play(points, limit, config.seed + len(curve))
            used, planned = used + lengths, planned + generation * limit
            for search, row in zip(searches, scores, strict=True):
                search.tell(row)
            curve.append((float(used.mean()), limit, np.array([search.score for search in searches])))
            if progress:
                progress(planned, curve[-1][2])
            if should_stop and should_stop():
                finished = False
                break
    return FoundGaits(Waves([search.best for search in searches]), curve[-1][2], used, curve, finished)


def trial_lengths(task: Any, config: GaitConfig) -> tuple[int, int]:
    """Returns the env-steps of early trials and of whole episodes, for a search that can begin.

    Args:
        task: A task or its id.
        config: Settings of the search.

    Raises:
        ValueError: The env-steps are not enough for the first generation and one of whole episodes.
        ImportError: The package cma is missing.
    """
    load_cma()
    episode = as_task(task).time_limit
    short = episode if config.trial_steps is None else min(config.trial_steps, episode)
    needed = config.first * short + (config.candidates + 1) * episode
    if config.env_steps < needed:
        what = f"{config.first} gaits for {short} env-steps and {config.candidates + 1} for {episode}"
        raise ValueError(f"env_steps: got {config.env_steps}, at least {needed} are needed ({what})")
    return short, episode


class _Search:
    """The search for one design: random gaits, then CMA-ES from the best of them."""

    def __init__(self, rng: np.random.Generator, size: int, config: GaitConfig) -> None:
        self.rng, self.config = rng, config
        self.points = rng.standard_normal((config.first, size))
        self.optimizer: Any = None
        self.best, self.score = self.points[0], -np.inf
        self._is_best_due = False

    def begin_anew(self) -> None:
        """Forgets scores, which are of shorter trials than those to come; the best gait will be played once more."""
        self.score, self._is_best_due = -np.inf, True

    def ask(self) -> NDArray[np.float64]:
        """Returns the gaits of the next generation, (candidates, size), with one more at the end where it is due."""
        if self.optimizer is not None:
            self.points = np.array(self.optimizer.ask())
        if self._is_best_due:
            self.points, self._is_best_due = np.vstack([self.points, self.best]), False
        return self.points

    def tell(self, scores: NDArray[np.float64]) -> None:
        """Takes the scores of those gaits."""
        scores = np.where(np.isfinite(scores), scores, _WORST)
        leader = int(scores.argmax())
        if scores[leader] > self.score:
            self.best, self.score = self.points[leader].copy(), float(scores[leader])
        if self.optimizer is not None:
            own = slice(self.config.candidates)
            self.optimizer.tell(list(self.points[own]), (-scores[own]).tolist())  # it minimises
            return
        options = {
            "popsize": self.config.candidates,
            "verbose": -9,
            "seed": np.nan,  # none; `randn` takes the place of numpy's global generator
            "randn": lambda *shape: self.rng.standard_normal(shape),
        }
        self.optimizer = load_cma().CMAEvolutionStrategy(self.best, self.config.sigma, options)


class _Worlds:
    """Worlds of D designs, as many of each as a generation has gaits."""

    def __init__(self, task: Any, designs: list[Body], options: WorldOptions) -> None:
        self._task, self._designs, self._options = task, designs, options
        self._engine: TaskEngine | None = None

    def play(self, points: NDArray[np.float64], limit: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Plays (D, C, size) gaits; returns their scores, (D, C), and the env-steps of each design, (D,)."""
        n, count, size = points.shape
        engine = self._with(n * count)
        engine.set_seed([seed] * engine.num_worlds)  # one generation's gaits meet the same
        engine.reset()
        gait = Waves(points.swapaxes(0, 1).reshape(-1, size))  # gait by gait, each of all designs
        running = np.ones(engine.num_worlds, bool)
        for _ in range(limit):
            engine.step(*gait(engine), mask=None if running.all() else running)
            running &= ~(engine.terminated | engine.truncated)
            if not running.any():
                break
        score, length = engine.score.reshape(count, n), engine.length.reshape(count, n)
        return score.T.copy(), length.sum(0)

    def _with(self, worlds: int) -> TaskEngine:
        if self._engine is None or self._engine.num_worlds != worlds:
            self._close()
            self._engine = TaskEngine(
                self._task, self._designs, worlds, with_voxels=False, with_flat=False, **self._options
            )
        return self._engine

    def _close(self) -> None:
        if self._engine is not None:
            self._engine.close()
            self._engine = None

    def __enter__(self) -> "_Worlds":
        return self

    def __exit__(self, *exception: object) -> None:
        self._close()
