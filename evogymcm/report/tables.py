"""Tables: what a report is made from, and scores."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from evogymcm.algos.analysis import Summary, resample, summarise
from evogymcm.algos.runs.record import NOT_RECORDED, Kind, Row, RunRecord
from evogymcm.report.parts import Table
from evogymcm.report.sources import Arm, Source


def tasks_of(arms: Iterable[Arm], kind: Kind) -> list[str]:
    """Returns the tasks of all runs of a kind, in the order of their first run."""
    return list(dict.fromkeys(run.task for arm in arms for run in arm.runs if run.kind == kind))


def source_table(sources: Sequence[Source]) -> Table:
    """Returns what the report is made from, one column for each source."""
    columns = [_source_facts(source) for source in sources]
    known = [label for label in columns[0] if any(column[label] for column in columns)]
    rows = [[label, *(column[label] or NOT_RECORDED for column in columns)] for label in known]
    missing = [label for label in columns[0] if label not in known]
    caption = f"Not recorded with these runs: {', '.join(missing)}." if missing else ""
    return Table("", ["", *(source.name for source in sources)], rows, caption)


def _source_facts(source: Source) -> dict[str, str]:
    results, runs = source.results, source.runs
    origin = results if "machine" in results else next((run.origin for run in runs if run.origin), {})
    machine, versions = origin.get("machine") or {}, origin.get("versions") or {}
    n_finished = sum(run.finished for run in runs)
    planned = source.planned or len(runs)
    return {
        "what": source.kind,
        "tasks": _listed(run.task for run in runs),
        "arms": _listed(run.label for run in runs),
        "seeds": _listed(sorted({run.seed for run in runs if run.seed is not None})),
        "runs": f"{planned} planned, {n_finished} finished" if source.planned else f"{planned}, {n_finished} finished",
        "budget of a run": _budget(source),
        "env-steps done": f"{sum(run.env_steps for run in runs):,} in all",
        "hardware": _hardware(machine),
        "processes": str(results.get("processes") or ""),
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items() if version),
        "commit": str(origin.get("commit") or ""),
        "wall time": _wall_time(source),
    }


def _listed(items: Iterable[Any]) -> str:
    return ", ".join(dict.fromkeys(str(item) for item in items))


def _hardware(machine: Any) -> str:
    cores, memory = machine.get("cores"), machine.get("memory_gib")
    parts = (machine.get("cpu"), cores and f"{cores} cores", memory and f"{memory:g} GiB", machine.get("system"))
    return ", ".join(str(part) for part in parts if part)


def _budget(source: Source) -> str:
    """Returns the env-steps that a run may use, from the settings."""
    config = source.config.get("base") or source.config
    if not config.keys() & {"ppo", "total_steps"}:
        config = next((run.config for run in source.runs if run.config), {})
    inner = config.get("ppo") or config
    total = inner.get("total_steps")
    if "population" not in config:
        return f"{total:,} env-steps" if total else ""
    parts = [f"{total:,} env-steps for each body"] if total else []
    if config.get("max_env_steps"):
        parts.insert(0, f"{config['max_env_steps']:,} env-steps of all kinds")
    if config.get("budget"):
        parts.append(f"at most {config['budget']:,} bodies in generations of {config['population']}")
    return ", ".join(parts)


def _wall_time(source: Source) -> str:
    """Returns the suite's time, and the sum over its runs, which may have been done side by side."""
    parts = []
    if source.results.get("wall_seconds") is not None:
        parts.append(f"{_duration(source.results['wall_seconds'])} (last sitting)")
    seconds = [run.seconds for run in source.runs if run.seconds is not None]
    if seconds and len(seconds) == len(source.runs):
        parts.append(f"{_duration(sum(seconds))} in the runs, added up" if len(seconds) > 1 else _duration(seconds[0]))
    return "; ".join(parts)


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"


def training_scores(arms: Sequence[Arm], caption: str) -> Table:
    """Returns the scores of trained policies: the last policy's, and apart from it the best evaluation of training."""
    head = ["task", "arm", "seeds", "env-steps", "untrained", "final score", "95 % interval", "of ceiling"]
    head += ["best of training", "95 % interval", "final return"]
    is_robust = any((run.final or {}).get("robust_score") is not None for arm in arms for run in arm.runs)
    is_compared = any(arm.paper for arm in arms)
    rows = []
    for task in tasks_of(arms, "train"):
        for arm in arms:
            runs = arm.of(task, "train")
            if runs:
                row = _training_row(task, arm, runs)
                row += [_robust([run.final for run in runs if run.finished])] if is_robust else []
                rows.append([*row, _paper(arm, task)] if is_compared else row)
    head += ["robust score"] if is_robust else []
    head += ["paper"] if is_compared else []
    return Table("Scores", head, rows, caption, numeric=frozenset(range(2, len(head))))


def _training_row(task: str, arm: Arm, runs: Sequence[RunRecord]) -> list[str]:
    ended = [run for run in runs if run.finished]
    final, best = _summary(run.final_of("score") for run in ended), _summary(run.best_score for run in ended or runs)
    fraction = _summary(run.final_of("fraction_of_ceiling") for run in ended)
    counted = f"{len(ended)}" if len(ended) == len(runs) else f"{len(ended)} of {len(runs)} finished"
    return [
        task,
        arm.label,
        counted,
        _range([run.env_steps for run in ended or runs]),
        _text(_summary(run.untrained for run in ended or runs)),
        _text(final),
        final.interval if final else "",
        f"{fraction.mean:.1%}" if fraction else "",
        _text(best),
        best.interval if best else "",
        _text(_summary(run.final_of("return") for run in ended)),
    ]


def _summary(values: Iterable[float | None]) -> Summary | None:
    """Returns the summary; None where a value is missing, as the others would not be comparable."""
    listed = list(values)
    known = [value for value in listed if value is not None]
    return summarise(known) if known and len(known) == len(listed) else None


def _text(summary: Summary | None) -> str:
    return str(summary) if summary else ""


def _robust(told: Sequence[Row | None]) -> str:
    """Returns the mean robust score ± the mean spread over starts, where all rows tell them."""
    parts = [_summary((row or {}).get(name) for row in told) for name in ("robust_score", "spread")]
    return " ± ".join(f"{part.mean:z.2f}" for part in parts if part)


def _range(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def _paper(arm: Arm, task: str) -> str:
    if task not in arm.paper:
        return ""
    mean, std = arm.paper[task]
    return f"{mean:z.2f}" if std is None else f"{mean:z.2f} ({std:z.2f})"


def codesign_scores(arms: Sequence[Arm], caption: str) -> Table:
    """Returns the best scores of co-design, compared where the shortest run of a task ended."""
    head = ["task", "arm", "seeds", "compared at env-steps", "bodies trained", "best score", "95 % interval"]
    head += ["of each seed", "best at the end"]
    is_robust = any((run.best or {}).get("robust_score") is not None for arm in arms for run in arm.runs)
    rows = []
    for task in tasks_of(arms, "codesign"):
        end = min(run.curve[-1][0] for arm in arms for run in arm.of(task, "codesign"))
        for arm in arms:
            runs = arm.of(task, "codesign")
            if runs:
                row = _codesign_row(task, arm, runs, end)
                rows.append([*row, _robust([run.best for run in runs])] if is_robust else row)
    head += ["robust score"] if is_robust else []
    return Table("Best scores", head, rows, caption, numeric=frozenset(range(2, len(head))))


def _codesign_row(task: str, arm: Arm, runs: Sequence[RunRecord], end: float) -> list[str]:
    at = [float(resample(run.curve, np.array([end]), is_stepwise=True)[0]) for run in runs]
    scores = _summary(value if np.isfinite(value) else None for value in at)
    n_finished = sum(run.finished for run in runs)
    return [
        task,
        arm.label,
        f"{len(runs)}" if n_finished == len(runs) else f"{len(runs)}, {n_finished} finished",
        f"{end:,.0f}",
        _range([run.n_designs for run in runs]),
        _text(scores),
        scores.interval if scores else "",
        " ".join(f"{value:z.2f}" if np.isfinite(value) else "none" for value in at),
        _text(_summary(run.curve[-1][1] for run in runs)),
    ]
