"""Analyses how stiffness, actuation and contact go together in finished runs of experiment A.

    python benchmarks/analyse_signals.py runs/suite-quick/*co-optimisation*

Each run's folder gets signals.json and signals.png. The table holds medians over the actuators whose actuation and
stiffness both vary, and the rise of stiffness before impact with its 95 % interval. A rise's rank is the share of all
shifts of the stiffness in time that would give a smaller one: 0.5 is chance.
"""

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro
from _signals import analyse_run
from _suite import ARMS, PAPER
from _text import aligned

from evogymcm import robots

_HEAD = ("run", "score", "same frequency", "lag, degrees", "coherence", "impacts", "rise before impact", "rank")


def analyse(folder: Path) -> dict[str, Any]:
    """Analyses a run of the suite and returns its summary.

    Raises:
        ValueError: It is no run of experiment A with stiffness control, or it is not finished.
    """
    config = folder / "config.json"
    if not config.is_file():
        raise ValueError(f"{folder}: it has no config.json, so that it is no run")
    settings = json.loads(config.read_text(encoding="utf-8"))
    task, arm = settings.get("task"), settings.get("arm")
    if task not in PAPER or ARMS.get(arm) != "reactive":
        raise ValueError(f"{folder}: got task {task!r} and arm {arm!r}, expected a co-optimisation run of the suite")
    return analyse_run(folder, task, robots[PAPER[task].robot]).summary()


def table(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Returns the summaries of runs, by name, as text."""
    lines = [_HEAD]
    for name, row in summaries.items():
        interval = row["rise_interval"]
        lines.append(
            (
                name,
                f"{row['score']:.2f}",
                f"{_number(row['same_frequency'], '.0%')} of {row['varying']}",
                _number(row["phase_lag"], "+.0f", 180 / math.pi),
                _number(row["coherence"], ".2f"),
                str(row["n_impacts"]),
                _number(row["rise_before_impact"], "+.3f")
                + ("" if interval is None else f" [{interval[0]:+.3f}, {interval[1]:+.3f}]"),
                _number(row["rise_rank"], ".2f"),
            )
        )
    return aligned(lines)


def _number(value: float | None, form: str, factor: float = 1.0) -> str:
    return "-" if value is None else format(factor * value, form)


def main(folders: Annotated[tuple[Path, ...], tyro.conf.Positional]) -> int:
    """Analyses run folders.

    Args:
        folders: of finished runs with stiffness control.
    """
    summaries, failed = {}, False
    for folder in folders:
        try:
            summaries[folder.name] = analyse(folder)
        except ValueError as error:
            print(error, file=sys.stderr)
            failed = True
    if summaries:
        print(table(summaries))
    return 1 if failed or not folders else 0


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
