"""The paper's observations on bodies, stiffness fields and gaits, as tables of the best designs and policies."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from math import exp
from pathlib import Path
from typing import Any, get_args

from benchmarks.experiments import figures
from benchmarks.experiments.experiment import Record
from benchmarks.experiments.tables import table, with_interval
from evogymcm.algos.analysis import (
    anticipation,
    difference,
    improvement,
    interval_note,
    measure_shape,
    share,
    stiffness_contrast,
    summarise,
)
from evogymcm.algos.analysis.designs import Region
from evogymcm.algos.codesign.design import Design

Values = Mapping[str, Sequence[float]]
_MEASURES = {  # of `Shape` -> how tables call them
    "voxels": "voxels",
    "width": "width",
    "height": "height",
    "legs": "legs",
    "leg_width": "width of legs",
    "leg_length": "length of legs",
}
_CONTROL = "fixed"
_NOTE = (
    "Of the best design of each whole run. Differences are of pairs of equal seeds. P: how often a body of the other"
    f' arm measures more than one of arm "{_CONTROL}".'
)


def observed(runs: Sequence[Record]) -> Record:
    """Returns what the tables need of the runs of a task and arm: the best designs, and the signals of gaits."""
    designs = [{"seed": run["seed"], **run["best"]} for run in runs if run["best"]]
    return {"designs": designs, "signals": [run["signals"] for run in runs if run.get("signals")]}


def tables(rows: Sequence[Record]) -> list[str]:
    """Returns all tables of rows, one a task and arm, with their `task`, their `arm` and what `observed` returns."""
    played = [(row["task"], signals) for row in rows for signals in row["signals"]]
    return [*design_tables(rows), *([anticipation_table(played)] if played else [])]


def plot(groups: Iterable[tuple[str, str, Sequence[Record]]], path: Path) -> None:
    """Draws, as PATH-stiffness, the mean stiffness fields of task, arm and runs, where they were searched."""
    fields = {(task, arm): searched_designs(observed(runs)["designs"]) for task, arm, runs in groups}
    figures.mean_fields(fields, path.with_name(f"{path.stem}-stiffness{path.suffix}"))


def searched_designs(records: Sequence[Record]) -> list[Design]:
    """Returns the designs of those records that have a stiffness field."""
    return [Design.from_record(record) for record in records if record.get("stiffness") is not None]


def design_tables(rows: Sequence[Record]) -> list[str]:
    """Returns tables of the shape of bodies, of each arm less that of arm "fixed", and of stiffness fields.

    Args:
        rows: one a task and arm, with its `task`, its `arm`, and `designs`, the records of the best designs, each with
            its `seed`.
    """
    shapes = {(row["task"], row["arm"]): _shapes(row["designs"]) for row in rows if row["designs"]}
    if not shapes:
        return []
    lines = [["best bodies", "arm", "seeds", *_MEASURES.values()]]
    for (task, arm), found in shapes.items():
        means = [str(summarise([shape[name] for shape in found.values()])) for name in _MEASURES]
        lines.append([task, arm, str(len(found)), *means])
    parts = [table(lines)]
    for arm in dict.fromkeys(arm for _, arm in shapes if arm != _CONTROL):
        tasks = [task for task, other in shapes if other == arm and (task, _CONTROL) in shapes]
        pairs = {task: (shapes[task, _CONTROL], shapes[task, arm]) for task in tasks}
        parts += _difference_table(arm, pairs)
    searched = [(row["task"], row["arm"], searched_designs(row["designs"])) for row in rows]
    parts += _contrast_table([(task, arm, found) for task, arm, found in searched if found])
    return [*parts, f"{_NOTE} {interval_note([len(found) for found in shapes.values()])}"]


def _shapes(records: Sequence[Record]) -> dict[int, dict[str, float]]:
    """Returns the measures of each seed's body."""
    return {record["seed"]: asdict(measure_shape(Design.from_record(record).body)) for record in records}


def _difference_table(arm: str, pairs: Mapping[str, tuple[Mapping[int, Any], Mapping[int, Any]]]) -> Iterator[str]:
    """Yields the table of an arm's measures less those of arm "fixed", on the seeds that both have."""
    common = {task: sorted(control.keys() & treated.keys()) for task, (control, treated) in pairs.items()}
    common = {task: seeds for task, seeds in common.items() if seeds}
    if not common:
        return

    def values(name: str, side: int) -> Values:
        return {task: [pairs[task][side][seed][name] for seed in seeds] for task, seeds in common.items()}

    lines = [[f"{arm} minus {_CONTROL}", "pairs", *_MEASURES.values()]]
    arms = [(values(name, 0), values(name, 1)) for name in _MEASURES]
    for task, seeds in common.items():
        gains = [difference(control[task], treated[task], is_paired=True) for control, treated in arms]
        lines.append([task, str(len(seeds)), *(with_interval(*gain, "+.2f") for gain in gains)])
    total = str(sum(map(len, common.values())))
    if len(common) > 1:
        gains = [difference(*map(_joined, of_arms), is_paired=True) for of_arms in arms]
        lines.append(["all pairs", total, *(with_interval(*gain, "+.2f") for gain in gains)])
    chances = [improvement(control, treated) for control, treated in arms]
    lines.append(["P, mean over tasks", total, *(with_interval(*chance, ".2f") for chance in chances)])
    yield table(lines)


def _contrast_table(searched: Sequence[tuple[str, str, Sequence[Design]]]) -> Iterator[str]:
    """Yields the table of how many times as stiff as the rest of their designs regions are, where any were searched."""
    lines = [["searched stiffness", "arm", "designs"]]
    for region in get_args(Region):
        lines[0] += [f"{region} over rest", "of designs"]
    for task, arm, designs in searched:
        line = [task, arm, str(len(designs))]
        for region in get_args(Region):
            found = [stiffness_contrast(design, region) for design in designs]
            known = [value for value in found if value is not None]
            line += [_ratio(known), str(len(known))]
        lines.append(line)
    if searched:
        yield table(lines)


def _joined(of_tasks: Mapping[str, Sequence[Any]]) -> list[Any]:
    return [value for values in of_tasks.values() for value in values]


def _ratio(logs: Sequence[float]) -> str:
    """Returns the geometric mean of ratios, given their logarithms, with its interval."""
    if not logs:
        return "-"
    found = summarise(logs)
    ends = None if found.low is None or found.high is None else (exp(found.low), exp(found.high))
    return with_interval(exp(found.mean), ends, ".2f")


def anticipation_table(played: Sequence[tuple[str, Mapping[str, Any]]]) -> str:
    """Returns the share of policies whose stiffness rises before impacts, and falls, in each task and in all.

    Args:
        played: task and summary of the signals of each policy.
    """
    told: dict[str, list[int | None]] = {}
    for task, summary in played:
        told.setdefault(task, []).append(anticipation(summary))
    if len(told) > 1:
        told["all tasks"] = _joined(told)
    lines: list[Sequence[str]] = [("stiffness before impact", "policies", "it rises", "share", "it falls", "share")]
    for task, signs in told.items():
        known = [sign for sign in signs if sign is not None]
        line = [task, f"{len(known)} of {len(signs)}"]
        for sign in (1, -1):
            count = known.count(sign)
            line += [str(count), with_interval(*share(count, len(known)), ".0%")] if known else ["-", "-"]
        lines.append(line)
    note = (
        "Policies: those with enough impacts in their episode to tell. It rises, or falls: the interval of the change"
        " before impact is above zero, or below. In brackets: Wilson's 95 % intervals."
    )
    return f"{table(lines)}\n\n{note}"
