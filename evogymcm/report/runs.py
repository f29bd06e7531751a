"""Runs as they lie in folders, recognised by what is in them; nothing is written there."""

import json
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["CodesignRun", "Row", "Run", "TrainingRun", "best_curve", "read_json", "read_run"]

Row = Mapping[str, Any]
Curve = tuple[tuple[float, float], ...]

CONFIG, TABLE, RESULT, SIGNALS = "config.json", "curve.jsonl", "result.json", "signals.json"
_STATE, _FINAL = "codesign.pt", "final.pt"
_FIRST_PHASES = ("screen", "train")  # of a generation of co-design
NOT_RECORDED = "not recorded"


@dataclass(frozen=True)
class Run:
    """One run.

    Attributes:
        name: of its folder.
        path: the folder; None where there is only the suite's record of the run.
        task: id of the task.
        arm: what it is compared by, such as "co-optimisation", or the variant in a comparison of those; the folder's
            name where the settings say nothing.
        seed: None where it is not recorded.
        config: the settings.
        finished: whether it was run to its end.
        env_steps: done by now; in co-design of all kinds.
        curve: (env-steps, score): of the evaluations in training, or the best so far in co-design.
        signals: what `signals.json` holds, None without.
    """

    name: str
    path: Path | None
    task: str
    arm: str
    seed: int | None
    config: Row
    finished: bool
    env_steps: int
    curve: Curve
    signals: Row | None


@dataclass(frozen=True)
class TrainingRun(Run):
    """Training of one policy.

    Attributes:
        final: score of the last policy, None where the run was stopped.
        final_return: its return.
        fraction: final score as a fraction of the ceiling, None where there is none.
        body: text or name of the robot, None where it is not recorded or one of several.
        seconds: spent so far, None where it is not recorded.
    """

    final: float | None
    final_return: float | None
    fraction: float | None
    body: str | None
    seconds: float | None

    @property
    def best(self) -> float | None:
        """Largest score among all evaluations, that of the untrained policy included."""
        return max((score for _, score in self.curve), default=None)

    @property
    def untrained(self) -> float | None:
        """Score before the first update."""
        return self.curve[0][1] if self.curve and self.curve[0][0] == 0 else None


@dataclass(frozen=True)
class CodesignRun(Run):
    """Co-design.

    Attributes:
        individuals: the last record of every individual, by index.
        bodies: trained in all.
    """

    individuals: Mapping[int, Row]
    bodies: int

    def ranked(self) -> list[Row]:
        """Returns the individuals, best first."""
        told = [row for row in self.individuals.values() if row.get("fitness") is not None]
        return sorted(told, key=lambda row: -row["fitness"])


def read_json(path: Path) -> Row:
    """Returns the object in a JSON file, an empty one where there is no such file.

    Raises:
        ValueError: It is no JSON, or no object.
    """
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path}: not JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path}: got {type(content).__name__}, expected a JSON object")
    return content


def _read_rows(path: Path) -> list[Row]:
    """Returns a run's table; a last row cut short by a crash is left out."""
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    try:
        return [json.loads(line) for line in lines if line.endswith("\n")]
    except ValueError as error:
        raise ValueError(f"{path}: not a table of JSON rows: {error}") from error


def best_curve(rows: list[Row]) -> Curve:
    """Returns (env-steps, best score so far) of co-design, one point for each phase that ended."""
    points = {row["env_steps"]: row["best"] for row in rows if row.get("best") is not None}
    return tuple(sorted(points.items()))


def read_run(path: Path | None, record: Row | None = None) -> TrainingRun | CodesignRun | None:
    """Returns the run in a folder, or of its record alone; None where there is nothing of it yet.

    Args:
        path: the folder of one run.
        record: what a suite's results say of the run; what the folder's own `result.json` says is newer.

    Raises:
        ValueError: A file cannot be read.
    """
    rows = _read_rows(path / TABLE) if path else []
    config = read_json(path / CONFIG) if path else {}
    record = (read_json(path / RESULT) if path else {}) or record or {}
    signals = (read_json(path / SIGNALS) if path else {}) or None
    name = path.name if path else run_name(record)
    common: dict[str, Any] = {
        "name": name,
        "path": path,
        "task": record.get("task") or config.get("task") or NOT_RECORDED,
        "arm": _arm(record) or _arm(config) or config.get("material") or name,
        "seed": record.get("seed", config.get("seed", _inner(config).get("seed"))),
        "config": config,
        "signals": signals,
    }
    is_searched = isinstance(record.get("best"), Mapping) or "experiment" in record
    if is_searched or "population" in config or any("event" in row for row in rows):
        return _codesign_run(rows, record, common)
    return _training_run(rows, record, common)


def _arm(settings: Row) -> str | None:
    """Returns what a run is compared by: the variant, where variants within an arm are compared."""
    return settings.get("variant") or settings.get("arm")


def _inner(config: Row) -> Row:
    """Settings of the training in those of a run, which may be nothing else."""
    return config.get("ppo") or config


def _training_run(rows: list[Row], record: Row, common: dict[str, Any]) -> TrainingRun | None:
    scored = [row for row in rows if row.get("score") is not None]
    if scored:
        curve: Curve = tuple((row["env_steps"], row["score"]) for row in scored)
    else:
        curve = tuple((point[0], point[-1]) for point in record.get("curve") or ())
    if not curve:
        return None
    env_steps = max(int(record.get("env_steps") or 0), int(rows[-1]["env_steps"]) if rows else 0)
    path = common["path"]  # its files are newer than a record of an earlier sitting
    finished = bool(record.get("finished")) or bool(path and (path / _FINAL).is_file())
    last: Row = record.get("final") or (scored[-1] if finished and scored else {})
    return TrainingRun(
        **common,
        finished=finished,
        env_steps=env_steps,
        curve=curve,
        final=last.get("score"),
        final_return=last.get("return"),
        fraction=last.get("fraction_of_ceiling"),
        body=_body(common["config"], record),
        seconds=next((row["seconds"] for row in rows[::-1] if "seconds" in row), record.get("train_seconds")),
    )


def _body(config: Row, record: Row) -> str | None:
    """Returns the robot's name or text, where the run says it and trained no other."""
    bodies = config.get("bodies")
    if isinstance(bodies, list):
        return bodies[0] if len(bodies) == 1 and isinstance(bodies[0], str) else None
    for value in (config.get("body"), record.get("robot")):
        if isinstance(value, str):
            return value
    return None


def _codesign_run(rows: list[Row], record: Row, common: dict[str, Any]) -> CodesignRun | None:
    curve = best_curve(rows) or tuple((steps, best) for steps, best in record.get("curve") or ())
    if not curve:
        return None
    individuals = {row["index"]: row for row in rows if "index" in row}
    if not individuals and record.get("best"):
        individuals = {record["best"].get("index", 0): record["best"]}
    bodies = max(len(individuals), int(record.get("bodies") or 0))
    env_steps = max(int(record.get("env_steps") or 0), int(curve[-1][0]))
    path = common["path"]
    finished = bool(record.get("finished")) or bool(path and _is_finished(path, common["config"]))
    return CodesignRun(
        **common,
        finished=finished,
        env_steps=env_steps,
        curve=curve,
        individuals=individuals,
        bodies=bodies,
    )


def _is_finished(path: Path, config: Row) -> bool:
    """Whether co-design has used a budget and done all phases of its last generation, by the state that it saved.

    Raises:
        ValueError: The state cannot be read.
    """
    file = path / _STATE
    if not file.is_file():
        return False  # killed in its first phase
    import torch

    try:
        state = torch.load(file, weights_only=True)
        if state["phase"] not in _FIRST_PHASES:
            return False
        limit, budget = config.get("max_env_steps"), config.get("budget")
        spent, proposed = state["env_steps"], state["search"]["n_designs"]
    except (KeyError, RuntimeError, TypeError, EOFError, pickle.UnpicklingError) as error:
        raise ValueError(f"{file}: not the state of a co-design run: {error}") from error
    return (limit is not None and spent >= limit) or (budget is not None and proposed >= budget)


def run_name(record: Row) -> str:
    """Returns the name that a suite gives a run's folder."""
    return f"{record.get('task')}-{_arm(record)}-seed{record.get('seed')}"


def run_folders(path: Path) -> Iterator[Path]:
    """Yields the folders right inside `path` that hold a run's table, by name."""
    for folder in sorted(path.iterdir()):
        if folder.is_dir() and (folder / TABLE).is_file():
            yield folder
