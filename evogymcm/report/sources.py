"""What a report is made from: single runs, suites of runs, or folders of them."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evogymcm.algos.runs.folder import TABLE, RunFiles
from evogymcm.algos.runs.record import Kind, Row, RunRecord

Groups = dict[tuple[str, str], list[tuple["Source", RunRecord]]]  # by arm and settings

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7f7f7f", "#000000")  # Okabe and Ito
_USUAL = {  # the same for the same arm in every report
    "control-only": "#0072b2",
    "fixed": "#0072b2",
    "prescribed": "#0072b2",
    "co-optimisation": "#d55e00",
    "reactive": "#d55e00",
    "invariant": "#009e73",
}
_PLANNED = ("tasks", "arms", "seeds")
_NO_SETTINGS = ("command", "seed", "task", "tasks", "seeds", "arm", "arms", "num_threads")


@dataclass(frozen=True)
class Source:
    """One of the folders that a report is made from.

    Attributes:
        name: how the report calls it.
        path: the folder.
        kind: "experiment A", "B" or "C", "comparison" (of variants), "training run", "co-design run" or "run folders".
        runs: in it, those that have not begun left out.
        planned: number of runs that a suite plans; None for others.
        results: what a suite's `results.json` holds, empty without.
        config: the folder's settings.
    """

    name: str
    path: Path
    kind: str
    runs: tuple[RunRecord, ...]
    planned: int | None
    results: Row
    config: Row

    @property
    def paper(self) -> dict[tuple[str, str], tuple[float, float | None]]:
        """The paper's scores, mean and standard deviation, by task and arm, as the suite recorded them."""
        rows = [row for row in self.results.get("summary") or () if row.get("paper_score") is not None]
        return {(row["task"], row["arm"]): (row["paper_score"], row.get("paper_std")) for row in rows}


@dataclass(frozen=True)
class Arm:
    """Runs that differ in task and seed alone, and are shown in one colour."""

    label: str
    colour: str
    runs: tuple[RunRecord, ...]
    paper: Mapping[str, tuple[float, float | None]]  # by task

    def of(self, task: str, kind: Kind) -> list[RunRecord]:
        """Returns the runs of a task and kind."""
        return [run for run in self.runs if run.task == task and run.kind == kind]

    def title(self, run: RunRecord) -> str:
        """Returns what one of the runs is called."""
        return f"{run.task}, {self.label}" + ("" if run.seed is None else f", seed {run.seed}")


def read_sources(paths: Sequence[Path]) -> list[Source]:
    """Returns what lies in the folders, under names that differ."""
    if not paths:
        raise ValueError("runs: got none, at least one run folder is needed")
    resolved = [path.resolve() for path in paths]
    twice = sorted({str(path) for path, real in zip(paths, resolved, strict=True) if resolved.count(real) > 1})
    if twice:
        raise ValueError(f"runs: {', '.join(twice)} is given more than once")
    return [read_source(path, name) for path, name in zip(paths, _names(resolved), strict=True)]


def _names(paths: Sequence[Path]) -> list[str]:
    """Returns the ends of the paths, as long as it takes to tell them apart."""
    for length in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-length:]) for path in paths]
        if len(set(names)) == len(names):
            break
    return names


def read_source(path: Path, name: str | None = None) -> Source:
    """Returns what lies in a folder, recognised by its content."""
    if not path.is_dir():
        raise ValueError(f"runs: {path} is not a folder")
    name = name or path.resolve().name
    files = RunFiles(path)
    config, results = files.config, files.read_json("results.json")
    if (path / TABLE).is_file():
        run = RunRecord.read(path)
        if not run.curve:
            raise ValueError(f"runs: {path} holds a run without any score yet")
        kind = "co-design run" if run.kind == "codesign" else "training run"
        return Source(name, path, kind, (run,), None, results, config)
    suite: Row = results.get("suite") or results.get("comparison") or config
    is_suite = bool(results.get("runs")) or set(_PLANNED) <= suite.keys()
    runs = _runs_inside(path, results, suite)
    if not runs:
        raise ValueError(
            f"runs: {path} holds neither a run ({TABLE}) nor a suite (results.json), nor folders of runs with scores"
        )
    kind = "run folders"
    if is_suite:
        kind = "comparison" if "variants" in suite else f"experiment {suite.get('experiment', 'A')}"
    return Source(name, path, kind, tuple(runs), _planned(suite) if is_suite else None, results, suite)


def _planned(suite: Row) -> int | None:
    counts = [len(suite.get(key) or ()) for key in (*_PLANNED, "variants")]
    return counts[0] * counts[1] * counts[2] * max(counts[3], 1) or None


def _runs_inside(path: Path, results: Row, suite: Row) -> list[RunRecord]:
    """Returns the runs of folders inside, with what the suite recorded of them, and those of records alone."""
    records: dict[str, list[Row]] = {}
    for told in results.get("runs") or ():
        records.setdefault(RunRecord.from_dict(told).name, []).append(told)
    runs = []
    for folder in sorted(path.iterdir()):
        if folder.is_dir() and (folder / TABLE).is_file():
            told_of = records.get(folder.name)
            runs.append(RunRecord.read(folder, told_of.pop(0) if told_of else None))
    runs += [RunRecord.from_dict(told) for left in records.values() for told in left]
    begun = [run for run in runs if run.curve]
    order = (suite.get("tasks"), suite.get("variants") or suite.get("arms"), suite.get("seeds"))
    return sorted(
        begun,
        key=lambda run: [_place(*pair) for pair in zip(order, (run.task, run.label, run.seed), strict=True)],
    )


def _place(items: Sequence[Any] | None, item: Any) -> int:
    """Returns where an item stands in a suite's list, so that runs keep its order."""
    return list(items).index(item) if items and item in items else 0


def make_arms(sources: Sequence[Source]) -> list[Arm]:
    """Returns the arms of all runs.

    Runs of the same arm and settings are seeds of one arm, wherever they lie. Where arms of one name differ in their
    settings, or the same seed comes twice, they stay apart and bear their source's name too.
    """
    groups: Groups = {}
    for source in sources:
        for run in source.runs:
            groups.setdefault((run.label, _settings(source, run)), []).append((source, run))
    # The same run twice is not two seeds: such groups fall apart by source, and within one source run by run.
    groups = _split(groups, lambda source, _: str(source.path))
    groups = _split(groups, lambda _, run: str(id(run)))
    names = [arm for arm, _ in groups]
    labels = {key: key[0] if names.count(key[0]) == 1 else _long_label(members) for key, members in groups.items()}
    colours = _colours([key[0] for key in groups])
    return [
        Arm(
            labels[key],
            colour,
            tuple(run for _, run in members),
            {task: score for source, run in members for (task, arm), score in source.paper.items() if arm == run.label},
        )
        for (key, members), colour in zip(groups.items(), colours, strict=True)
    ]


def _split(groups: Groups, place: Callable[[Source, RunRecord], str]) -> Groups:
    """Returns groups in which a seed of a task comes twice divided by place, and the others as they are."""
    found: Groups = {}
    for key, members in groups.items():
        seeds = [(run.kind, run.task, run.seed) for _, run in members]
        is_twice = len(set(seeds)) < len(seeds)
        for source, run in members:
            own = (key[0], f"{place(source, run)} {key[1]}") if is_twice else key
            found.setdefault(own, []).append((source, run))
    return found


def _settings(source: Source, run: RunRecord) -> str:
    """Text that is equal where runs may be seeds of one arm."""
    settings = source.config if source.planned else run.config
    if not settings:
        return str(run.path or source.path)
    return json.dumps(_without(settings), sort_keys=True)


def _without(settings: Any) -> Any:
    """Settings without those in which seeds of an arm differ."""
    if isinstance(settings, Mapping):
        return {key: _without(value) for key, value in settings.items() if key not in _NO_SETTINGS}
    return settings


def _long_label(members: Sequence[tuple[Source, RunRecord]]) -> str:
    source, run = members[0]
    place = source.name if source.planned or len(source.runs) == 1 else f"{source.name}{os.sep}{run.name}"
    return f"{run.label} ({place})"


def _colours(arms: Sequence[str]) -> list[str]:
    """Returns a colour for each arm: the usual one where it is still free, else the next free one."""
    found: list[str] = []
    for i, arm in enumerate(arms):
        wanted = (_USUAL.get(arm, ""), *(colour for colour in _COLOURS if colour not in _USUAL.values()), *_COLOURS)
        free = [colour for colour in wanted if colour and colour not in found]
        found.append(free[0] if free else _COLOURS[i % len(_COLOURS)])
    return found
