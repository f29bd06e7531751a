"""Measures env-steps per second, alone or in turn with EvoGym.

    python benchmarks/throughput.py --against-evogym PATH/TO/PYTHON
    python benchmarks/throughput.py --cases doors --json

An env-step is 30 substeps of one world; the worlds' steps are summed. Two programs are compared in turn, A B A B, so
that both meet the same moments of a busy machine, and a comparison's ratio is the median over its pairs.
"""

import json
import statistics
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from _runners import DOORS, EvoGym, Runner, Subprocesses, Workload, make_runner

from evogymcm.algos.runs import find_origin
from evogymcm.body import as_body, sample_body

STANDARD_BODY = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"
TASKS = ("Walker-v0", "DownStepper-v0", "AreaMaximizer-v0", "CaveCrawler-v0", "BridgeWalker-v0")
_WARM_UP = 0.5  # of a measurement's length


@dataclass(frozen=True)
class Options:
    """Command line.

    Attributes:
        tasks: tasks to measure, one after another.
        body: rows of cells, or a robot's name.
        bodies: number of different random bodies instead of `body`, dealt to the worlds in turn.
        body_size: rows and columns of random bodies; without `bodies`, one random body of that size.
        worlds: worlds simulated together.
        threads: threads of the simulator.
        material: "reactive" gives every voxel a new stiffness in every step.
        through: the task engine (core), physics alone (simulator), or an adapter.
        cases: "chosen" (what the other options say), or a table of cases, for which only the options below count:
            "speed" (against EvoGym and between threads) or "doors" (every adapter against the bare simulator).
        against_evogym: a Python interpreter that has evogym 2.0.0, to compare with.
        against_subproc: compare with Stable-Baselines3's `SubprocVecEnv`, a process for each world.
        pairs: measurements of each program; their median counts.
        seconds: length of one measurement.
        json: print one JSON object a row instead of a table.
        seed: of bodies and actions.
    """

    tasks: tuple[str, ...] = TASKS
    body: str = STANDARD_BODY
    bodies: int = 0
    body_size: int | None = None
    worlds: int = 64
    threads: int = 1
    material: Literal["invariant", "reactive"] = "invariant"
    through: Literal["core", "simulator", "gymnasium", "torchrl", "collector", "pettingzoo", "sb3"] = "core"
    cases: Literal["chosen", "speed", "doors"] = "chosen"
    against_evogym: Path | None = None
    against_subproc: bool = False
    pairs: int = 5
    seconds: float = 2.0
    json: bool = False
    seed: int = 0


@dataclass(frozen=True)
class Case:
    """A row: a workload through a door, and what it is compared with."""

    workload: Workload
    through: str = "core"
    with_evogym: bool = False
    with_subproc: bool = False
    with_one_thread: bool = False
    with_simulator: bool = False


def workloads(options: Options) -> Iterator[Workload]:
    """Yields the workload of every chosen task."""
    if options.bodies or options.body_size:
        rng = np.random.default_rng(options.seed)
        side = options.body_size or 5
        bodies = tuple(sample_body((side, side), rng) for _ in range(options.bodies or 1))
    else:
        bodies = (as_body(options.body),)
    for task in options.tasks:
        yield Workload(task, bodies, options.worlds, options.threads, options.material, options.seed)


def cases(options: Options) -> list[Case]:
    """Returns the rows to measure."""
    if options.cases == "chosen":
        against = {"with_evogym": True, "with_subproc": options.against_subproc}
        return [Case(w, options.through, **against) for w in workloads(options)]
    plain = replace(Options(), seed=options.seed)
    walker = replace(plain, tasks=("Walker-v0",))
    if options.cases == "doors":
        counts = ((64, 1), (256, 1), (256, 2))
        many = [w for n, threads in counts for w in workloads(replace(walker, worlds=n, threads=threads))]
        return [Case(w, door, with_simulator=True) for w in many for door in DOORS if door != "simulator"]
    population = replace(plain, tasks=("Walker-v0", "CaveCrawler-v0", "BridgeWalker-v0"), bodies=64)
    compared = (
        (plain, "core"),
        (population, "core"),
        (replace(walker, body_size=10), "core"),
        (replace(walker, bodies=64, worlds=256, material="reactive"), "core"),  # EvoGym itself has no stiffness
        (replace(walker, worlds=1), "gymnasium"),
    )
    rows = [Case(w, door, with_evogym=True) for chosen, door in compared for w in workloads(chosen)]
    two_threads = replace(walker, bodies=256, worlds=256, threads=2)
    return rows + [Case(w, with_one_thread=True) for w in workloads(two_threads)]


def in_turn(runners: Sequence[Runner], pairs: int, seconds: float) -> list[list[float]]:
    """Returns for each runner its rates, measured in turn after a warm-up of each."""
    for runner in runners:
        runner.run(_WARM_UP * seconds)
    rates: list[list[float]] = [[] for _ in runners]
    for _ in range(pairs):
        for runner, found in zip(runners, rates, strict=True):
            found.append(runner.run(seconds))
        progress("  " + "  ".join(f"{found[-1]:10.0f}" for found in rates) + _ratio_text(rates))
    return rates


def _ratio_text(rates: list[list[float]]) -> str:
    return "".join(f"   x{rates[0][-1] / other[-1]:.2f}" for other in rates[1:])


def measure(case: Case, options: Options) -> dict[str, Any]:
    """Returns one row."""
    workload = case.workload
    with ExitStack() as stack:

        def add(runner: Runner) -> Runner:
            stack.callback(runner.close)
            return runner

        runners, keys = [add(make_runner(case.through, workload))], ["env_steps_per_s"]
        if case.with_evogym and options.against_evogym:
            runners.append(add(EvoGym(options.against_evogym, workload)))
            keys.append("evogym_env_steps_per_s")
        if case.with_subproc:
            runners.append(add(Subprocesses(workload)))
            keys.append("subproc_env_steps_per_s")
        if case.with_one_thread:
            runners.append(add(make_runner(case.through, replace(workload, threads=1))))
            keys.append("one_thread_env_steps_per_s")
        if case.with_simulator:
            runners.append(add(make_runner("simulator", workload)))
            keys.append("simulator_env_steps_per_s")
        rates = in_turn(runners, options.pairs, options.seconds)
    row: dict[str, Any] = {
        "task": workload.task,
        "through": case.through,
        "material": workload.material,
        "worlds": workload.worlds,
        "threads": workload.threads,
        "bodies": len(workload.bodies),
        "body": workload.bodies[0].text,
    }
    row |= {key: round(statistics.median(found), 1) for key, found in zip(keys, rates, strict=True)}
    for key, found in zip(keys[1:], rates[1:], strict=True):
        ratios = [ours / other for ours, other in zip(rates[0], found, strict=True)]
        name = "ratio" if key.startswith("evogym") else f"over_{key.removesuffix('_env_steps_per_s')}"
        row |= {name: round(statistics.median(ratios), 2), "pairs": [round(r, 2) for r in ratios]}
    return row


def table_line(row: dict[str, Any]) -> str:
    """Returns a row as text; the comparison stands at its end."""
    body = row["body"] if row["bodies"] == 1 else f"{row['bodies']} bodies"
    body = body if len(body) <= 30 else f"{len(body.split('/'))}x{len(body.split('/')[0])} body"
    text = f"{row['task']:<18} {row['through']:<10} {row['material']:<10} {body:<30} {row['worlds']:>4} worlds "
    text += f"{row['threads']} threads {row['env_steps_per_s']:>9.0f}/s"
    if "ratio" in row:
        text += f"   EvoGym {row['evogym_env_steps_per_s']:>6.0f}/s   x{row['ratio']:.1f}"
    if "over_one_thread" in row:
        text += f"   x{row['over_one_thread']:.2f} of one thread"
    if "over_subproc" in row:
        text += f"   x{row['over_subproc']:.1f} of SubprocVecEnv"
    if "over_simulator" in row:
        text += f"   x{row['over_simulator']:.2f} of the simulator"
    return text


def progress(text: str) -> None:
    """Shows what is going on, apart from the results."""
    print(text, file=sys.stderr, flush=True)


def main(options: Options) -> None:
    """Measures the cases, and prints a row for each."""
    origin = find_origin()
    progress(f"{origin['machine']['cpu']}, {origin['machine']['cores']} cores")
    for case in cases(options):
        workload = case.workload
        progress(f"{workload.task} through {case.through}, {workload.material}, {workload.worlds} worlds")
        row = measure(case, options)
        print(json.dumps(row | origin) if options.json else table_line(row), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
