"""Compares ratios of speed with those stored in `speed.json`, so that a change that makes something slow shows.

    python benchmarks/speed_baseline.py                    # exit status 1 where something is slower than it was
    python benchmarks/speed_baseline.py --write --runs 5   # stores what is measured here instead

Rates mean nothing on another machine, ratios mostly do: each entry is measured in turn, A B A B, with something else of
the same run, on one thread, in processor time, which other programs hardly change. (So waiting is not seen, nor what
several threads gain.) What seems slow is measured again, and is reported only where it is slow every time.
"""

import json
import resource
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numba
import numpy as np
import torch
import tyro
from _runners import Runner, Workload, make_runner
from throughput import STANDARD_BODY, progress
from torchrl.envs import ExplorationType, set_exploration_type

from evogymcm.algos import PPOConfig
from evogymcm.algos.learning import Trainer
from evogymcm.algos.runs import find_origin
from evogymcm.body import Body, sample_body
from evogymcm.envs import SoftRobotEnv, TaskEngine

BASELINE = Path(__file__).with_name("speed.json")
_LEAST_TOLERANCE = 1.25
_TRIES = 3  # of an entry that seems slow
_ROWS = 64  # worlds of an engine, and chains of the reference


@dataclass(frozen=True)
class Options:
    """Command line.

    Attributes:
        write: store what is measured, with its spread over the runs, in place of comparing.
        runs: how often everything is measured; medians count.
        only: names of entries, or the beginnings of names; none: all.
        pairs: measurements of each side of an entry in a run; their median counts.
        seconds: processor time of one measurement.
    """

    write: bool = False
    runs: int = 1
    only: tuple[str, ...] = ()
    pairs: int = 5
    seconds: float = 0.2

    def __post_init__(self) -> None:
        for name in ("runs", "pairs", "seconds"):
            if (value := getattr(self, name)) <= 0:
                raise ValueError(f"{name}: got {value}, must be positive")
        if unknown := [name for name in self.only if not any(entry.startswith(name) for entry in ENTRIES)]:
            raise ValueError(f"only: got {unknown}, allowed are beginnings of {list(ENTRIES)}")
        if self.write and self.only:
            raise ValueError("only: got some entries, but write stores all of them")


class _Repeat(Runner):
    """Calls a function over and over."""

    def __init__(self, call: Callable[[], object], close: Callable[[], object] = lambda: None, steps: int = 1) -> None:
        self.advance, self.close, self.steps_at_once = call, close, steps  # type: ignore[method-assign]


@numba.njit
def _swing(place: np.ndarray, speed: np.ndarray) -> None:
    """Chains of masses and springs, 30 substeps: arithmetic like the simulator's, and no part of the library."""
    for _ in range(30):
        for row in range(place.shape[0]):
            for i in range(place.shape[1] - 1):
                x, y = place[row, i + 1, 0] - place[row, i, 0], place[row, i + 1, 1] - place[row, i, 1]
                length = np.sqrt(x * x + y * y) + 1e-9
                force = 0.01 * (length - 1.0) / length
                for axis, part in ((0, x), (1, y)):
                    speed[row, i, axis] += force * part
                    speed[row, i + 1, axis] -= force * part
            for i in range(place.shape[1]):
                for axis in range(2):
                    speed[row, i, axis] *= 0.999
                    place[row, i, axis] += speed[row, i, axis]


def _reference() -> Runner:
    place = np.random.default_rng(0).uniform(0.0, 5.0, (_ROWS, 36, 2))
    return _Repeat(partial(_swing, place, np.zeros_like(place)))


def _workload(task: str = "Walker-v0", worlds: int = _ROWS, differ: bool = False) -> Workload:
    rng = np.random.default_rng(0)
    bodies = [sample_body((5, 5), rng) for _ in range(worlds)] if differ else [Body.from_text(STANDARD_BODY)]
    return Workload(task, tuple(bodies), worlds, 1, "invariant")


def _door(name: str, **workload: object) -> Runner:
    return make_runner(name, _workload(**workload))  # type: ignore[arg-type]


def _reading(name: str) -> Runner:
    """What a policy sees, read from an engine in motion."""
    engine = _workload().make(TaskEngine)
    engine.step(np.ones(engine.occupancy.shape))
    return _Repeat((lambda: engine.flat) if name == "flat" else engine.observations, engine.close, _ROWS)


def _stream() -> Runner:
    """New bodies for all worlds of an engine."""
    engine = TaskEngine("Walker-v0", partial(sample_body, (5, 5)), _ROWS, grid_shape=(5, 5), num_threads=1, seed=0)
    return _Repeat(engine.reset, engine.close, _ROWS)


def _ppo(part: str) -> Runner:
    """A rollout of PPO, or what is learned from one."""
    make_env = partial(SoftRobotEnv, "Walker-v0", bodies=STANDARD_BODY, material="reactive", num_threads=1)
    trainer = Trainer(make_env, PPOConfig(num_worlds=16, rollout_steps=32, target_kl=0.0))
    rollout = trainer.collector.rollout()
    call = trainer.collector.rollout if part == "rollout" else partial(trainer.learner.update, rollout.clone(), 1.0)

    def explore() -> None:
        with set_exploration_type(ExplorationType.RANDOM):
            call()

    return _Repeat(explore, trainer.close)


def _import(module: str) -> Runner:
    return _Repeat(partial(subprocess.run, [sys.executable, "-c", f"import {module}"], check=True))


ENTRIES: Mapping[str, tuple[Callable[[], Runner], Callable[[], Runner]]] = {
    # name: what is measured, and what its speed is divided by
    **{
        f"physics of {task} / reference": (partial(_door, "simulator", task=task, differ=True), _reference)
        for task in ("Walker-v0", "CaveCrawler-v0", "BridgeWalker-v0")
    },
    "engine / physics": (partial(_door, "core"), partial(_door, "simulator")),
    **{
        f"{door} / engine": (partial(_door, door), partial(_door, "core"))
        for door in ("gymnasium", "torchrl", "collector", "pettingzoo", "sb3")
    },
    "gymnasium, one world / engine": (partial(_door, "gymnasium", worlds=1), partial(_door, "core", worlds=1)),
    "flat observation / engine": (partial(_reading, "flat"), partial(_door, "core")),
    "all observations / engine": (partial(_reading, "all"), partial(_door, "core")),
    "new bodies / engine": (_stream, partial(_door, "core")),
    "PPO update / its rollout": (partial(_ppo, "update"), partial(_ppo, "rollout")),
    "import evogymcm / gymnasium": (partial(_import, "evogymcm"), partial(_import, "gymnasium")),
}


def _processor_seconds() -> float:
    """Processor time of this process and of those that it waited for."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(part.ru_utime + part.ru_stime for part in used)


def _rate(runner: Runner, seconds: float) -> float:
    count, start = 0, _processor_seconds()
    while (used := _processor_seconds() - start) < seconds:
        runner.advance()
        count += 1
    return count * runner.steps_at_once / used


def measure(name: str, options: Options) -> float:
    """Returns an entry's ratio: how fast one thing is, in multiples of the other."""
    with ExitStack() as stack:
        sides = []
        for make in ENTRIES[name]:
            sides.append(make())
            stack.callback(sides[-1].close)
            _rate(sides[-1], options.seconds / 2)  # compiles, fills caches
        ratio = statistics.median(
            _rate(sides[0], options.seconds) / _rate(sides[1], options.seconds) for _ in range(options.pairs)
        )
    progress(f"  {name:<40} {ratio:.4g}")
    return ratio


def slowed(stored: Mapping[str, Mapping[str, float]], measured: Mapping[str, float]) -> list[str]:
    """Returns the measured entries whose ratio has fallen below the stored one by more than their tolerance."""
    return [name for name, ratio in measured.items() if ratio * stored[name]["tolerance"] < stored[name]["ratio"]]


def table(stored: Mapping[str, Mapping[str, float]], measured: Mapping[str, float]) -> str:
    """Returns a line an entry: what was stored, what was measured, and whether that is slower."""
    slow, lines = slowed(stored, measured), []
    for name, ratio in measured.items():
        before = stored[name]
        text = f"{name:<40} {ratio:9.4g}   stored {before['ratio']:9.4g}   x{ratio / before['ratio']:.2f}"
        lines.append(text + (f"   SLOWER: allowed x{1 / before['tolerance']:.2f}" if name in slow else ""))
    return "\n".join(lines)


def entries_of(runs: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Returns what is stored: medians, and as tolerance the square of how much slower the slowest run was."""
    entries = {}
    for name in runs[0]:
        ratios = [run[name] for run in runs]
        middle = statistics.median(ratios)
        tolerance = max(_LEAST_TOLERANCE, (middle / min(ratios)) ** 2)
        entries[name] = {"ratio": float(f"{middle:.4g}"), "tolerance": round(tolerance, 2)}
    return entries


def main(options: Options) -> int:
    """Measures, then stores or compares; returns the exit status."""
    torch.set_num_threads(1)
    names = [name for name in ENTRIES if not options.only or name.startswith(options.only)]
    stored = {} if options.write else json.loads(BASELINE.read_text(encoding="utf-8"))["entries"]
    if not options.write and (new := [name for name in names if name not in stored]):
        raise ValueError(f"{BASELINE.name}: {new} have no stored ratio; store them with --write")
    runs: list[dict[str, float]] = []
    origin = find_origin()
    for _ in range(options.runs):
        runs.append({name: measure(name, options) for name in names})
        if options.write:  # after each, so that one may be stopped
            content = {"runs": len(runs)} | origin | {"entries": entries_of(runs)}
            BASELINE.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    if options.write:
        return 0
    measured = {name: statistics.median(run[name] for run in runs) for name in names}
    for _ in range(_TRIES - 1):
        for name in slowed(stored, measured):
            measured[name] = max(measured[name], measure(name, options))
    print(table(stored, measured))
    return 1 if slowed(stored, measured) else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
