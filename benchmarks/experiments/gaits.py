"""Open-loop gaits: waves fitted to the paper's robots, and to random bodies, in few env-steps."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from math import inf
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.experiments import figures
from benchmarks.experiments.experiment import Comparison, Record, Tell
from benchmarks.experiments.paper import FIXED_ARMS, PAPER
from benchmarks.experiments.tables import table
from evogymcm import robots
from evogymcm._extras import load_cma
from evogymcm.algos.analysis import summarise
from evogymcm.algos.gaits import GaitConfig, Waves, search_gaits
from evogymcm.algos.learning import evaluate, play
from evogymcm.algos.learning.bodies import N_HELD_OUT, held_out_bodies
from evogymcm.algos.learning.config import Material
from evogymcm.algos.runs import RunFolder, find_origin
from evogymcm.envs import TaskEngine, sine_gait

SHAPE, HELD_OUT_TASK = (5, 5), "Walker-v0"
_RESULT = "result.json"
_BODIES_A_JOB = 4
_STARTS = 8  # of a robust score


@dataclass(frozen=True)
class Gaits(Comparison):
    """Searches of open-loop gaits for the paper's robots, and for random bodies that are the same in every run.

    Each robot has a short and a long search with every seed, each random body a short one with the first seed, in the
    first arm.

    Attributes:
        short_steps: env-steps of short searches; those of long ones are `gait.env_steps`.
        held_out: random bodies of Walker-v0, up to 64; 0 for none.
        gait: settings of each search; its seed comes from `seeds`.
    """

    tasks: tuple[str, ...] = tuple(PAPER)
    arms: tuple[str, ...] = tuple(FIXED_ARMS)
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    short_steps: int = 50_000
    held_out: int = N_HELD_OUT
    gait: GaitConfig = field(default_factory=lambda: GaitConfig(env_steps=250_000))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gait.seed:
            raise ValueError(f"gait.seed: got {self.gait.seed}, here it comes from seeds")
        if not 0 < self.short_steps < self.gait.env_steps:
            raise ValueError(
                f"short_steps: got {self.short_steps}, must be above 0 and below gait.env_steps, {self.gait.env_steps}"
            )
        if not 0 <= self.held_out <= N_HELD_OUT:
            raise ValueError(f"held_out: got {self.held_out}, must be 0 to {N_HELD_OUT}")

    @property
    def allowed_arms(self) -> tuple[str, ...]:
        """All arms that there are."""
        return tuple(FIXED_ARMS)

    @property
    def steps_per_run(self) -> int:
        """The most env-steps of a run."""
        return max(self.short_steps + self.gait.env_steps, self.short_steps * min(self.held_out, _BODIES_A_JOB))

    def _config(self, seed: int, steps: int) -> GaitConfig:
        return replace(self.gait, seed=seed, env_steps=steps)

    def job(self, task: str, arm: str, seed: int) -> "GaitJob":
        """Returns the searches for the paper's robot."""
        searches = tuple(self._config(seed, steps) for steps in (self.short_steps, self.gait.env_steps))
        return GaitJob(f"{task}-{arm}-seed{seed}", task, arm, (robots[PAPER[task].robot].text,), searches)

    def jobs(self) -> list["GaitJob"]:
        """Returns all runs, seed by seed, those of random bodies last."""
        texts = [body.text for body in held_out_bodies(SHAPE)[: self.held_out]]
        search, arm = self._config(self.seeds[0], self.short_steps), self.arms[0]
        return super().jobs() + [
            GaitJob(f"held-out-{first}", HELD_OUT_TASK, arm, tuple(texts[first : first + _BODIES_A_JOB]), (search,))
            for first in range(0, len(texts), _BODIES_A_JOB)
        ]

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns one row a task and arm over its finished runs, and one of the random bodies."""
        finished = [run for run in runs if run["finished"]]
        rows = []
        for task, arm, group in self.groups([run for run in finished if not _is_held_out(run)]):
            paper, paper_std = PAPER[task].scores[arm]
            reached = [_reached(run, paper) for run in group]
            known = [found for found in reached if found is not None]
            missing = [(inf, inf)] * (len(reached) - len(known))
            steps, seconds = (median(column) for column in zip(*known, *missing, strict=True))
            rows.append(
                {
                    "task": task,
                    "arm": arm,
                    "env_steps": [search["budget"] for search in group[0]["searches"]],
                    "scores": [_of_searches(group, i, "scores") for i in range(2)],
                    "robust": [_of_searches(group, i, "robust") for i in range(2)],
                    "paper_score": paper,
                    "paper_std": paper_std,
                    "reached": len(known),
                    "steps_to_paper": None if steps == inf else steps,
                    "seconds_to_paper": None if seconds == inf else seconds,
                }
            )
        if group := [run for run in finished if _is_held_out(run)]:
            row: Record = {"held_out": sum(len(run["bodies"]) for run in group), "task": HELD_OUT_TASK}
            row |= {"arm": group[0]["label"], "env_steps": group[0]["searches"][0]["budget"]}
            for kind in ("scores", "robust"):
                row[kind] = _of_searches(group, 0, kind)
            rows.append(row)
        return rows

    def table(self, rows: Sequence[Record]) -> str:
        """Returns how the numbers are to be read, the scores beside the paper's, and those of the random bodies."""
        parts = []
        if of_robots := [row for row in rows if "held_out" not in row]:
            parts += [self._note(), table(_robot_lines(of_robots))]
        if of_bodies := [row for row in rows if "held_out" in row]:
            parts.append(table(_body_lines(of_bodies)))
        return "\n\n".join(parts)

    def _note(self) -> str:
        """How the scores of robots are to be read."""
        sizes = [Waves.size(FIXED_ARMS[arm]) for arm in self.arms]
        return (
            f"A gait is {' or '.join(map(str, sizes))} numbers, and a trial of the search is the very episode that is"
            " scored here, deterministic and from the exact start: a score is the best of many trials of one start."
            f" The robust score, the mean over {_STARTS} starts a hair apart, is the fairer number. Mean (standard"
            " deviation) over seeds; a search of each budget is a run of its own. To the paper's score: how many seeds"
            " have a whole trial at or above it; median env-steps and CPU seconds of a search until then, of the"
            " short search where that gets there, else of the long one; - where half of the seeds or more do not."
        )

    def plot(self, runs: Sequence[Record], path: Path) -> None:
        """Draws the best trials of the long searches, those before half of the env-steps short ones."""
        curves = [
            {**run, "curve": [[steps, score] for steps, _, _, score in run["searches"][-1]["curve"]]}
            for run in runs
            if run["finished"] and not _is_held_out(run)
        ]
        figures.best_curves(curves, self.tasks, self.arms, path)


def _is_held_out(run: Mapping[str, Any]) -> bool:
    """Whether a run is of random bodies: they have no long search."""
    return len(run["searches"]) < 2


def _of_searches(runs: Sequence[Record], index: int, kind: str) -> list[float]:
    """Returns the scores of all bodies of the runs, in the short or the long search."""
    return [score for run in runs for score in run["searches"][index][kind]]


def _reached(run: Record, goal: float) -> tuple[float, float] | None:
    """Returns env-steps and seconds of the first search with a whole trial at or above a score, until then."""
    for search in run["searches"]:
        whole = max((length for _, _, length, _ in search["curve"]), default=0)
        for steps, seconds, length, score in search["curve"]:
            if length == whole and score >= goal:
                return steps, seconds
    return None


def _robot_lines(rows: Sequence[Record]) -> list[Sequence[str]]:
    kinds = [cell for steps in rows[0]["env_steps"] for cell in (f"score, {steps:,}", f"robust, {steps:,}")]
    lines: list[Sequence[str]] = [
        ("task", "arm", "seeds", *kinds, "paper", "reach the paper's", "env-steps to it", "seconds")
    ]
    for row in rows:
        cells = [row["task"], row["arm"], str(len(row["scores"][0]))]
        for pair in zip(row["scores"], row["robust"], strict=True):
            cells += [str(summarise(values)) for values in pair]
        cells += [f"{row['paper_score']:.2f} ({row['paper_std']:.2f})", f"{row['reached']} of {cells[2]}"]
        to_paper = (row["steps_to_paper"], row["seconds_to_paper"])
        lines.append([*cells, *("-" if value is None else f"{value:,.0f}" for value in to_paper)])
    return lines


def _body_lines(rows: Sequence[Record]) -> list[Sequence[str]]:
    lines: list[Sequence[str]] = [
        ("random bodies", "arm", "env-steps of each", "mean score", "95 % interval", "median", "mean robust score")
    ]
    for row in rows:
        scores = summarise(row["scores"])
        head = (f"{row['held_out']} of {row['task']}", row["arm"], f"{row['env_steps']:,}", f"{scores.mean:.2f}")
        lines.append((*head, scores.interval, f"{median(row['scores']):.2f}", f"{np.mean(row['robust']):.2f}"))
    return lines


@dataclass(frozen=True)
class GaitJob:
    """Searches for one body or a few, a whole one the least that is resumed."""

    name: str
    task: str
    arm: str
    bodies: tuple[str, ...]
    searches: tuple[GaitConfig, ...]

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Searches, scores what is found, and writes the record into `folder / name` once all is done."""
        run = RunFolder(folder / self.name, {"label": self.arm, **asdict(self)}, resume=resume)
        if done := run.read_json(_RESULT):
            tell(done["env_steps"], None)
            return done
        record: Record = {"task": self.task, "label": self.arm, "seed": self.searches[0].seed, "finished": False}
        record |= {"bodies": list(self.bodies), "env_steps": 0, "searches": [], "origin": find_origin()}
        for config in self.searches:
            found = self._search(config, record["env_steps"], tell, should_stop)
            if found is None:
                return record
            record["searches"].append(found)
            record["env_steps"] += found["env_steps"]
        record["finished"] = True
        run.write_json(_RESULT, record)
        return record

    def _search(self, config: GaitConfig, before: int, tell: Tell, should_stop: Callable[[], bool]) -> Record | None:
        """Returns what is to be told of one search; None where it was stopped."""
        material: Material = FIXED_ARMS[self.arm]
        options: Any = {"material": material, "num_threads": 1}
        self._warm_up(options)
        seconds: list[float] = []
        begin = time.process_time()  # with one thread: the wall time on an idle core

        def progress(steps: int, best: NDArray[np.float64]) -> None:
            seconds.append(time.process_time() - begin)
            tell(before + steps * len(self.bodies), float(best.mean()))

        hooks: Any = {"progress": progress, "should_stop": should_stop}
        found = search_gaits(self.task, list(self.bodies), config, **hooks, **options)
        if not found.finished:
            return None
        with closing(self._worlds(options)) as engine:
            played = evaluate(found.waves, engine, _STARTS)
        return {
            "budget": config.env_steps,
            "env_steps": int(found.env_steps.sum()),
            "seconds": round(seconds[-1], 2),
            "scores": played.score.tolist(),
            "robust": played.robust.tolist(),
            "curve": _changes(found.curve, seconds) if len(self.bodies) == 1 else [],
        }

    def _warm_up(self, options: Any) -> None:
        """Loads all that a search of this process would load first: it is no part of its seconds."""
        load_cma()
        with closing(self._worlds(options)) as engine:
            for _ in play(sine_gait, engine, steps=1):
                pass

    def _worlds(self, options: Any) -> TaskEngine:
        """Returns worlds in which gaits are scored from all starts."""
        bodies = list(self.bodies)
        return TaskEngine(self.task, bodies, _STARTS * len(bodies), with_voxels=False, with_flat=False, **options)


def _changes(curve: Sequence[tuple[float, int, NDArray[np.float64]]], seconds: Sequence[float]) -> list[list[float]]:
    """Returns env-steps, seconds, length of trials and score, where one of the last two changes, and at the end."""
    points = [
        [steps, round(passed, 2), length, round(float(score[0]), 4)]
        for (steps, length, score), passed in zip(curve, seconds, strict=True)
    ]
    last = len(points) - 1
    return [point for i, point in enumerate(points) if i in (0, last) or point[2:] != points[i - 1][2:]]


SIZES: Mapping[str, Gaits] = {
    "quick": Gaits(("Walker-v0",), seeds=(0,), held_out=0),
    "small": Gaits(),
    "paper": Gaits(seeds=tuple(range(10)), gait=GaitConfig(env_steps=1_000_000)),
}
