"""The section on work: what commands supplied in an episode, and which policies no other beats in score and work."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evogymcm._settings import WORK
from evogymcm.algos.analysis import pareto_front, summarise
from evogymcm.algos.runs.record import Kind, Row
from evogymcm.report.parts import Note, Part, Section, Table
from evogymcm.report.sources import Arm
from evogymcm.report.tables import tasks_of

_WORKS = ("actuation work", "stiffness work", "net actuation work", "net stiffness work")
_KINDS: tuple[Kind, ...] = ("train", "codesign")
_NOTE = (
    "Supplied work is what commands add to the energy of springs, summed over those springs and env-steps of an episode"
    " where it grows; net work subtracts what comes back. Of actuation, and of changes of stiffness, in units of the"
    " simulator: the weight of one point is 110."
)
_FRONT = (
    "Policies that no other of the task beats in both: none has at least the score with at most the supplied work of"
    " actuation and stiffness together. {} of {} are."
)


class _Point(NamedTuple):
    """A policy's evaluation."""

    arm: Arm
    name: str
    score: float
    work: tuple[float, ...]  # by WORK
    is_last: bool  # a run's result, which means over seeds are made of


def work_section(arms: Sequence[Arm]) -> Section:
    """Returns the section, without parts where no run has measured work."""
    parts: list[Part] = []
    for task in dict.fromkeys(task for kind in _KINDS for task in tasks_of(arms, kind)):
        points = [point for kind in _KINDS for arm in arms for point in _points(arm, task, kind)]
        if points:
            parts += [_means(task, points), _front(task, points)]
    return Section("Score and work", [Note(_NOTE), *parts] if parts else [])


def _points(arm: Arm, task: str, kind: Kind) -> list[_Point]:
    """Returns all policies of an arm whose work was measured."""
    points = []
    for run in arm.of(task, kind):
        seed = "" if run.seed is None else f"seed {run.seed}"
        told: list[tuple[str, Row]] = [("", run.final or {})]
        if kind == "codesign":
            told = [(f"design {row.get('index', '?')}", row) for row in run.ranked()]
        for place, (design, row) in enumerate(told):
            score = row.get("score", row.get("fitness"))
            if score is not None and all(row.get(name) is not None for name in WORK):
                name = ", ".join(part for part in (seed, design) if part)
                points.append(_Point(arm, name, score, tuple(row[name] for name in WORK), place == 0))
    return points


def _means(task: str, points: Sequence[_Point]) -> Table:
    """Returns score and work of each arm's results, as means over seeds."""
    rows = []
    for arm in dict.fromkeys(point.arm.label for point in points):
        own = [point for point in points if point.arm.label == arm and point.is_last]
        if own:
            works = [f"{np.mean([point.work[i] for point in own]):,.0f}" for i in range(len(WORK))]
            rows.append([arm, f"{len(own)}", str(summarise([point.score for point in own])), *works])
    head = ["arm", "seeds", "score", *_WORKS]
    caption = "Of the final policy, or of the best design; means over seeds."
    return Table(f"{task}, work of an episode", head, rows, caption, numeric=frozenset(range(1, len(head))))


def _front(task: str, points: Sequence[_Point]) -> Table:
    """Returns the Pareto front over score and supplied work, best score first."""
    supplied = [point.work[0] + point.work[1] for point in points]
    is_on = pareto_front([point.score for point in points], supplied)
    chosen = sorted((i for i in range(len(points)) if is_on[i]), key=lambda i: (-points[i].score, supplied[i]))
    rows = [
        [
            points[i].arm.label,
            points[i].name,
            f"{points[i].score:z.2f}",
            f"{supplied[i]:,.0f}",
            *(f"{value:,.0f}" for value in points[i].work),
        ]
        for i in chosen
    ]
    head = ["arm", "policy", "score", "supplied work", *_WORKS]
    caption = _FRONT.format(len(chosen), len(points))
    return Table(f"{task}, Pareto front over score and work", head, rows, caption, frozenset(range(2, len(head))))
