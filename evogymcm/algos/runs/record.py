"""The record of a run, its settings and results: one form for training and co-design, of this and earlier versions."""

import os
import pickle
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from evogymcm._settings import WORK
from evogymcm.algos.runs.folder import RunFiles, RunFolder
from evogymcm.algos.runs.older import present_settings
from evogymcm.body import Body

Row = Mapping[str, Any]
Curve = tuple[tuple[float, float], ...]
Kind = Literal["train", "codesign"]
KINDS: tuple[Kind, ...] = get_args(Kind)

NOT_RECORDED = "not recorded"
GAIT = "gait.json"  # of the best design of an evolution
_RESULT, _SIGNALS, _STATE, _FINAL = "result.json", "signals.json", "codesign", "final.pt"
_IN_OTHER_FILES = ("config", "rows", "signals", "path")
_LABELS = ("variant", "label", "arm")  # by which experiments compare
_EVALUATION = (  # see `Evaluation.summary`
    *("score", "return", "episode_length", "goal_rate", "unstable", "steps_to_goal", "fraction_of_ceiling"),
    *("robust_score", "spread", *WORK),
)
_EVOLUTION = "evolution"
_FIRST_PHASES = ("screen", "train")  # of a generation of co-design
_MATERIALS = {  # of arms, as earlier versions called comparisons of settings
    "reactive": "reactive",
    "co-optimisation": "reactive",
    "control-only": "invariant",
    "fixed": "invariant",
    "prescribed": "invariant",
    "invariant": "invariant",
}


@dataclass(frozen=True)
class RunRecord:
    """One run of `train` or `codesign`, which write it into their folder as `result.json`.

    Attributes:
        kind: "train" or "codesign".
        task: Id of the task.
        label: The name under which reports compare the run: the one that an experiment gave its settings (`arm` or
            `variant` in the folder's settings), else the material.
        material: "reactive" or "invariant"; None where it is not recorded.
        bodies: Texts of the bodies that a policy was trained for; empty in co-design, and where they are not recorded.
        stiffness: Training: a number, or a field for each body. Co-design: the number that all voxels of all bodies
            have. None: 1, or set by the policy, or searched for each design.
        edge_rule: How stiffness acted on shared edges.
        seed: The run's seed; None where it is not recorded.
        finished: Whether it ran to its end.
        env_steps: Env-steps simulated so far; in co-design including evaluations.
        seconds: Wall time so far; None where it is not recorded.
        curve: (env-steps, score) of the evaluations in training, or of the best so far in co-design.
        final: Training: the evaluation of the last policy, see `Evaluation.summary`, and its ceiling; None where the
            run was stopped.
        best: Co-design: the row of the best design; None before there is one.
        n_designs: Co-design: how many were trained.
        origin: What made it, see `find_origin`; empty where it is not recorded.
        config: The settings.
        rows: The whole table; empty if only the record is left.
        signals: The content of `signals.json`; None without one.
        path: The folder; None if only the record is left.
    """

    kind: Kind
    task: str
    label: str
    material: str | None
    bodies: tuple[str, ...] = ()
    stiffness: Any = None
    edge_rule: str = "mean_factor"
    seed: int | None = None
    finished: bool = False
    env_steps: int = 0
    seconds: float | None = None
    curve: Curve = ()
    final: Row | None = None
    best: Row | None = None
    n_designs: int = 0
    origin: Row = field(default_factory=dict)
    config: Row = field(default_factory=dict, repr=False)
    rows: tuple[Row, ...] = field(default=(), repr=False)
    signals: Row | None = field(default=None, repr=False)
    path: Path | None = None

    @classmethod
    def read(cls, path: str | os.PathLike[str], told: Row | None = None) -> "RunRecord":
        """Returns the run in a folder, of this version or an earlier one.

        Args:
            path: The folder.
            told: What a suite's results say about the run; its own files take precedence.

        Raises:
            ValueError: There is no run in the folder, or a file cannot be read.
        """
        files = RunFolder.open(path)
        told = files.read_json(_RESULT) or told or {}
        config, rows = files.config, files.rows()
        if not told.get("finished"):  # what an earlier sitting said
            is_searched = _kind(told, config, rows) == "codesign"
            told = {**told, "finished": _is_finished(files) if is_searched else (files.path / _FINAL).is_file()}
        return _record(files.path.name, told, config, rows, files)

    @classmethod
    def from_dict(cls, told: Row) -> "RunRecord":
        """Returns the run of a record alone, as `as_dict` or the suites of earlier versions have written it."""
        return _record(NOT_RECORDED, told, {}, [], None)

    def as_dict(self) -> dict[str, Any]:
        """Returns all but settings, rows and signals, ready for JSON; `from_dict` reads it back."""
        return {item.name: getattr(self, item.name) for item in fields(self) if item.name not in _IN_OTHER_FILES}

    def write(self, run: RunFolder) -> None:
        """Writes `as_dict` into a run's folder as `result.json`, under the label that the folder's settings give."""
        given = [run.config[key] for key in _LABELS if run.config.get(key)]
        run.write_json(_RESULT, replace(self, label=given[0] if given else self.label).as_dict())

    @property
    def name(self) -> str:
        """Name of the folder, or what a suite would call it."""
        return self.path.name if self.path else f"{self.task}-{self.label}-seed{self.seed}"

    @property
    def body(self) -> str | None:
        """The robot's name or text, where the run trained no other."""
        return self.bodies[0] if len(self.bodies) == 1 else None

    def final_of(self, name: str) -> float | None:
        """Returns a number of the last policy's evaluation, None where there is none."""
        return (self.final or {}).get(name)

    @property
    def best_score(self) -> float | None:
        """Largest score among all evaluations, that of the untrained policy included, or of all designs."""
        return max((score for _, score in self.curve), default=None)

    @property
    def untrained(self) -> float | None:
        """Score before the first update."""
        return self.curve[0][1] if self.curve and self.curve[0][0] == 0 else None

    @property
    def designs(self) -> dict[int, Row]:
        """The last row of every design of co-design, by its number."""
        designs = {row["index"]: row for row in self.rows if "index" in row}
        return designs or ({self.best.get("index", 0): self.best} if self.best else {})

    def ranked(self) -> list[Row]:
        """Returns the rows of the designs that have been scored: the best first, the others by their fitness."""
        told = [row for row in self.designs.values() if row.get("fitness") is not None]
        best = None if self.best is None else self.best.get("index")
        return sorted(told, key=lambda row: (row.get("index") != best, -row["fitness"]))

    def design(self, row: Row) -> tuple[Body, np.ndarray]:
        """Returns the body of a design's row, and the stiffness (rows, cols) with which it was simulated."""
        body = Body(row["body"], row.get("connections"))
        if row.get("stiffness") is not None:
            return body, np.array(row["stiffness"], dtype=np.float64)
        return body, np.where(body.occupancy, 1.0 if self.stiffness is None else self.stiffness, 1.0)


def best_curve(rows: Iterable[Row]) -> Curve:
    """Returns (env-steps, best score so far) of co-design, one point for each phase that ended."""
    points = {row["env_steps"]: row["best"] for row in rows if row.get("best") is not None}
    return tuple(sorted(points.items()))


def _record(name: str, told: Row, config: Row, rows: list[dict[str, Any]], files: RunFiles | None) -> RunRecord:
    """Puts together what a run's files and records say, whichever version wrote them."""
    inner = config.get("ppo") or config  # settings of the training, which may be all that there is
    kind = _kind(told, config, rows)
    said = [settings.get(key) for settings in (told, config) for key in _LABELS]
    present = present_settings(config)
    stiffness = _stiffness(told, present, kind)
    material = told.get("material") or present.get("material")
    material = material or next((_MATERIALS[text] for text in said if text in _MATERIALS), None)
    if kind == "codesign" and stiffness is not None:
        said.append(f"stiffness {stiffness:g}")
    scored = [row for row in rows if row.get("score") is not None]
    curve = best_curve(rows) if kind == "codesign" else tuple((row["env_steps"], row["score"]) for row in scored)
    curve = curve or tuple((point[0], point[-1]) for point in told.get("curve") or ())
    finished, final = bool(told.get("finished")), told.get("final")
    if not final and kind == "train" and finished and scored:
        final = {name: scored[-1][name] for name in _EVALUATION if name in scored[-1]}
    earlier = told.get("seconds", told.get("train_seconds"))
    last = int(rows[-1]["env_steps"]) if rows else int(curve[-1][0]) if curve else 0
    record = RunRecord(
        kind,
        told.get("task") or config.get("task") or NOT_RECORDED,
        next((text for text in said if text), None) or material or name,
        material,
        bodies=_bodies(told, config) if kind == "train" else (),
        stiffness=stiffness,
        edge_rule=told.get("edge_rule") or config.get("edge_rule") or "mean_factor",
        seed=told.get("seed", config.get("seed", inner.get("seed"))),
        finished=finished,
        env_steps=max(int(told.get("env_steps") or 0), last),
        seconds=next((row["seconds"] for row in rows[::-1] if "seconds" in row), earlier),
        curve=curve,
        final=final or None,
        best=told.get("best") if kind == "codesign" else None,
        origin=told.get("origin") or {},
        config=config,
        rows=tuple(rows),
        signals=(files.read_json(_SIGNALS) or None) if files else None,
        path=files.path if files else None,
    )
    count = told.get("n_designs") or (told.get("bodies") if kind == "codesign" else 0)
    if not finished or "gait" not in (record.best or {}):  # an evolution's best is not the fittest
        record = replace(record, best=None)
    best = record.ranked()[0] if kind == "codesign" and record.ranked() else told.get("best")
    return replace(record, n_designs=max(len(record.designs), int(count or 0)), best=best)


def _kind(told: Row, config: Row, rows: Sequence[Row]) -> Kind:
    is_searched = isinstance(told.get("best"), Mapping) or "experiment" in told or "population" in config
    is_searched = is_searched or any("event" in row for row in rows)
    return told.get("kind") or ("codesign" if is_searched else "train")


def _bodies(told: Row, config: Row) -> tuple[str, ...]:
    """Returns the robots' names or texts, where the run says them."""
    for bodies in (told.get("bodies"), config.get("bodies")):
        if isinstance(bodies, list | tuple) and bodies and all(isinstance(body, str) for body in bodies):
            return tuple(bodies)
    body = config.get("body") or told.get("robot")
    return (body,) if isinstance(body, str) else ()


def _stiffness(told: Row, config: Row, kind: Kind) -> Any:
    """Returns the stiffness that was given, None where it was searched or set by the policy."""
    if "kind" in told:
        return told.get("stiffness")
    is_given = kind == "train" or (config.get("material") == "invariant" and not config.get("search"))
    return config.get("stiffness") if is_given else None


def _is_finished(files: RunFiles) -> bool:
    """Whether co-design has used a budget and done all phases of its last generation, by the state that it saved."""
    try:
        if (evolved := files.load(_EVOLUTION)) is not None:
            return bool(evolved["is_finished"])
        state = files.load(_STATE)
        if state is None or state["phase"] not in _FIRST_PHASES:  # None: killed in its first phase
            return False
        if state["search"].get("pending"):  # children were chosen, and wait to be trained
            return False
        limit, budget = files.config.get("max_env_steps"), files.config.get("budget")
        spent, proposed = state["env_steps"], state["search"]["n_designs"]
    except (KeyError, RuntimeError, TypeError, EOFError, pickle.UnpicklingError) as error:
        raise ValueError(f"{files.path / _STATE}.pt: not the state of a co-design run: {error}") from error
    return (limit is not None and spent >= limit) or (budget is not None and proposed >= budget)
