"""Evolution of bodies together with their gaits: a candidate costs one episode, not a training.

A child has its parent's gait, slightly changed, on a mutant of its parent's body (and material). What moved the parent
mostly moves the child, so that one episode tells whether it is better; so a generation has more than a hundred
candidates where a training of a policy for each would allow a few.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evogymcm._settings import WORK, WorkWeight, check_work_weight
from evogymcm.algos.codesign.design import Design, Individual, mutate_design
from evogymcm.algos.codesign.evolve_config import EvolveConfig
from evogymcm.algos.codesign.run import CodesignProgress
from evogymcm.algos.codesign.scoring import Scores, score_gaits
from evogymcm.algos.codesign.stiffness_proposals import perturb_stiffness
from evogymcm.algos.gaits.search import FoundGaits
from evogymcm.algos.gaits.stored import save_gaits
from evogymcm.algos.gaits.wave import Waves
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.algos.runs.record import GAIT
from evogymcm.body import H_ACT, Body, sample_body
from evogymcm.envs.core import TaskEngine

_STATE = "evolution"  # as `RunRecord` knows it
_WORST = -1e9  # for scores that are no numbers
_TURN = 0.3  # standard deviation of the logarithm by which a child's step differs from its parent's
_STEPS = (0.03, 1.0)  # between which steps stay
_CHANGED = 0.5  # share of a gait's numbers that a change is about
_CELLS_CHANGED = 0.2  # the same of what single voxels have


@dataclass(frozen=True, eq=False)
class Mover:
    """A design with its gait.

    Attributes:
        individual: the design and its place in the evolution; its index is -1 while it is a candidate.
        gait: (9 or 14,) numbers of its wave, see `Waves`.
        cells: (2 or 3, rows, columns) of its voxels.
        step: how far its children's gaits are from it.
        score: of its episode, see `Evaluation`.
        returns: sum of all rewards of its episode.
    """

    individual: Individual
    gait: NDArray[np.float64]
    cells: NDArray[np.float64]
    step: float
    score: float = float("nan")
    returns: float = float("nan")

    @property
    def fitness(self) -> float:
        """What its episode was worth."""
        return -np.inf if self.individual.fitness is None else self.individual.fitness


class Evolution:
    """One evolution, advanced generation by generation.

    Fitness is the score of a whole episode from the exact start, less what its work costs where that is asked for. The
    table gets a row for each candidate that survives its generation, and at the end one for each survivor with its
    robust score and its work.

    Args:
        config: settings.
        run: where everything is kept; None keeps it in memory.

    Attributes:
        survivors: the present ones, best first.
        generation: the next one, counted from 0.

    Raises:
        ValueError: There is no such task, or a body that fills the shape does not fit into its world.
    """

    def __init__(self, config: EvolveConfig, run: RunFolder | None = None) -> None:
        check_evolution(config)
        self.config, self.run = config, run
        self.rng = np.random.default_rng(config.seed)
        self.survivors: list[Mover] = []
        self.generation = self.env_steps = self.n_designs = self.played = 0
        self.is_finished = False
        self.rows: list[dict[str, Any]] = []
        if run and (saved := run.load(_STATE)):
            self._load(saved)
        elif run:
            run.keep_rows(0)  # of a run that was killed before its first state was saved

    @property
    def best(self) -> Mover | None:
        """The best one so far, None before there is one; at the end the survivor with the highest robust score and last
        reward, less what its work costs where that is asked for.

        The fittest is often fragile: chosen by one episode, it may owe its lead to a contact that a hair would undo.
        And a score leaves out an episode's last reward: a simulation may end in instability at no cost to it.
        """  # noqa: D205
        told = {row["index"]: worth(row, self.config.work_weight) for row in self.rows if row["event"] == "evaluate"}
        if told:
            return max(self.survivors, key=lambda mover: told[mover.individual.index])
        return self.survivors[0] if self.survivors else None

    def advance(self) -> CodesignProgress:
        """Plays the next generation, or at the end the survivors from several starts."""
        phase = "evolve" if self.env_steps < self.config.max_env_steps else "evaluate"
        if phase == "evolve":
            children = self._children() if self.survivors else self._random()
            scores = self._play(children)
            self._select(self._scored(children, scores))
            self.generation += 1
        else:
            self._record("evaluate", self.survivors, self._play(self.survivors, self.config.eval_starts))
        self.is_finished = phase == "evaluate" or (
            self.config.eval_starts == 1 and self.env_steps >= self.config.max_env_steps
        )
        self._save()
        return CodesignProgress(self.generation, phase, self.env_steps, self.n_designs, self.survivors[0].fitness)

    def _random(self) -> list[Mover]:
        config, size = self.config, Waves.size(self.config.material)
        cells = np.zeros((len(Waves.cell_names(config.material)), *config.shape))
        return [
            Mover(
                Individual(-1, Design(sample_body(config.shape, self.rng, self._weights()))),
                self.rng.standard_normal(size),
                cells,
                config.sigma,
            )
            for _ in range(config.first)
        ]

    def _children(self) -> list[Mover]:
        return [
            self._child(self.survivors[self.rng.integers(len(self.survivors))]) for _ in range(self.config.candidates)
        ]

    def _child(self, parent: Mover) -> Mover:
        config, rng, design = self.config, self.rng, parent.individual.design
        gait, cells = parent.gait, parent.cells
        step = float(np.clip(parent.step * np.exp(_TURN * rng.standard_normal()), *_STEPS))
        mutant = None
        if rng.random() < config.body_rate:
            mutant = mutate_design(design, rng, config.mutation_rate, config.attempts, self._weights())
        is_mutant = mutant is not None and mutant.body != design.body
        design = mutant or design
        if config.evolves_stiffness and rng.random() < config.stiffness_rate:
            design = Design(design.body, perturb_stiffness(design, rng))
        if not is_mutant or rng.random() < config.gait_rate:
            gait = gait + step * _noise(rng, gait.shape, _CHANGED)
            cells = cells + step * _noise(rng, cells.shape, _CELLS_CHANGED)
        return Mover(Individual(-1, design, parent.individual.index, self.generation), gait, cells, step)

    def _weights(self) -> tuple[float, ...]:
        """Draws the frequencies of cells for one body."""
        empty, *others = self.config.weights
        return (empty * float(self.config.sparsest ** self.rng.random()), *others)

    def _play(self, movers: Sequence[Mover], starts: int = 1) -> Scores:
        """Plays them, and counts what that takes."""
        designs = [mover.individual.design.at(self.config.stiffness) for mover in movers]
        is_measured = starts > 1 or self.config.work_weight is not None
        make_engine = partial(_engine_maker(self.config), work_weight=0.0 if is_measured else None)
        scores = score_gaits(make_engine, designs, waves_of(movers), self.config.seed, starts)
        self.env_steps += scores.env_steps
        self.played += len(movers)
        return scores

    def _scored(self, children: Sequence[Mover], scores: Scores) -> list[Mover]:
        fitness = scores.score
        if self.config.work_weight is not None:
            fitness = fitness - scores.work[:, :2] @ np.array(self.config.work_weight)
        values = np.where(np.isfinite(fitness), fitness, _WORST).tolist()
        return [
            replace(child, individual=replace(child.individual, fitness=value), score=score, returns=returns)
            for child, value, score, returns in zip(
                children, values, scores.score.tolist(), scores.returns.tolist(), strict=True
            )
        ]

    def _select(self, children: Sequence[Mover]) -> None:
        """Keeps the best of survivors and children, at most `per_body` of each body; the older of equals."""
        counts, kept = Counter[str](), list[Mover]()
        for mover in sorted([*self.survivors, *children], key=lambda mover: -mover.fitness):
            key = mover.individual.design.key
            if counts[key] < self.config.per_body and len(kept) < self.config.survivors:
                counts[key] += 1
                kept.append(mover)
        new = []
        for place, mover in enumerate(kept):
            if mover.individual.index < 0:
                kept[place] = replace(mover, individual=replace(mover.individual, index=self.n_designs))
                new.append(kept[place])
                self.n_designs += 1
        self.survivors = kept
        self._record("evolve", new)

    def _record(self, event: str, movers: Sequence[Mover], scores: Scores | None = None) -> None:
        """Adds a row for each."""
        best = self.survivors[0].fitness
        for i, mover in enumerate(movers):
            row = mover.individual.record() | {"event": event, "generation_now": self.generation}
            row |= {"env_steps": self.env_steps, "return": mover.returns, "gait": mover.gait.tolist()}
            row |= {} if scores is None else scores.row(i)
            self.rows.append(row | {"best": best})
            if self.run:
                self.run.append(self.rows[-1])

    def _save(self) -> None:
        if not self.run:
            return
        counted = {name: getattr(self, name) for name in ("generation", "env_steps", "n_designs", "played")}
        movers = [
            {"individual": mover.individual.record(), "gait": mover.gait.tolist(), "cells": mover.cells.tolist()}
            | {name: getattr(mover, name) for name in ("step", "score", "returns")}
            for mover in self.survivors
        ]
        state = {"rng": self.rng.bit_generator.state, "survivors": movers, "is_finished": self.is_finished}
        self.run.save(_STATE, counted | state | {"rows": len(self.rows)})
        self.store_best()

    def store_best(self) -> None:
        """Writes the best gait into the run's folder."""
        if self.run and (best := self.best):
            design = best.individual.design.at(self.config.stiffness)
            save_gait(self.run.path / GAIT, self.config, design, best)

    def _load(self, saved: dict[str, Any]) -> None:
        assert self.run is not None
        for name in ("generation", "env_steps", "n_designs", "played", "is_finished"):
            setattr(self, name, saved[name])
        self.rng.bit_generator.state = saved["rng"]
        self.survivors = [
            Mover(
                Individual.from_record(told["individual"]),
                np.array(told["gait"]),
                np.array(told["cells"]),
                told["step"],
                told["score"],
                told["returns"],
            )
            for told in saved["survivors"]
        ]
        self.run.keep_rows(saved["rows"])
        self.rows = self.run.rows()


def worth(row: Mapping[str, Any], work_weight: WorkWeight) -> float:
    """Returns what a survivor is worth in the end: its robust score and last reward, less what its work costs."""
    weights = check_work_weight(work_weight) or (0.0, 0.0)
    cost = sum(weight * row[name] for weight, name in zip(weights, WORK[:2], strict=True) if weight)
    return float(row["robust_score"] + row["return"] - row["score"] - cost)


def save_gait(path: Path, config: EvolveConfig, design: Design, mover: Mover) -> None:
    """Writes a design with its gait as `save_gaits` does."""
    waves, score = waves_of([mover]), np.array([mover.score])
    found = FoundGaits(waves, score, np.zeros(1, np.int64), [], finished=True)
    stiffness = None if design.stiffness is None else [design.stiffness]
    save_gaits(path, found, config.task, [design.body], stiffness=stiffness, edge_rule=config.edge_rule)


def _noise(rng: np.random.Generator, shape: tuple[int, ...], share: float) -> NDArray[np.float64]:
    """Returns normal noise on a share of the numbers, 0 elsewhere."""
    return np.where(rng.random(shape) < share, rng.standard_normal(shape), 0.0)


def waves_of(movers: Sequence[Mover]) -> Waves:
    """Returns their gaits."""
    return Waves([mover.gait for mover in movers], [mover.cells for mover in movers])


def check_evolution(config: EvolveConfig) -> None:
    """Raises a ValueError where a run cannot start: no such task, or a body that fills the shape does not fit."""
    _engine_maker(config)(bodies=[Body(np.full(config.shape, H_ACT))], num_worlds=1).close()


def _engine_maker(config: EvolveConfig) -> partial[TaskEngine]:
    options: dict[str, Any] = {name: getattr(config, name) for name in ("material", "edge_rule", "num_threads")}
    return partial(TaskEngine, config.task, with_voxels=False, with_flat=False, **options)
