"""Measures a generation of co-design over workers: seconds with one process, and how many times as fast several are.

    python benchmarks/generation_speed.py
    python benchmarks/generation_speed.py --workers 4 --piece 1 --total-steps 50000

Each number of workers does the same generation in turn, to the same bits, after its processes have started and done a
small one. The last line is of one process with all bodies in one batch, whose result is another.
"""

import statistics
import time
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Literal

import tyro

from evogymcm.algos import BodyPPOConfig, keep_freed_memory
from evogymcm.algos.codesign import CodesignConfig, CodesignResult, SearchConfig, codesign
from evogymcm.algos.codesign.workers import Workers


@dataclass(frozen=True)
class Options:
    """Command line.

    Attributes:
        task: task of the generation.
        material: "reactive", "invariant" or "searched" (invariant, with a search of stiffness and fine-tuning).
        workers: processes that are compared with one.
        population: bodies of the generation.
        piece: bodies in a piece.
        total_steps: env-steps of a body.
        rounds: measurements of each; their median counts.
    """

    task: str = "Walker-v0"
    material: Literal["reactive", "invariant", "searched"] = "reactive"
    workers: int = 2
    population: int = 8
    piece: int = 4
    total_steps: int = 20_000
    rounds: int = 3

    @property
    def config(self) -> CodesignConfig:
        """Settings of the generation."""
        return CodesignConfig(
            self.task,
            material="reactive" if self.material == "reactive" else "invariant",
            search=SearchConfig() if self.material == "searched" else None,
            population=self.population,
            budget=self.population,
            piece=self.piece,
            ppo=BodyPPOConfig(total_steps=self.total_steps),
            initial="fresh",
        )


def timed(config: CodesignConfig, executor: Executor | None) -> tuple[float, CodesignResult]:
    """Returns the seconds of a run, and its result."""
    start = time.perf_counter()
    spread = {"workers": 1} if executor is None else {"executor": executor}
    result = codesign(config, **spread)
    return time.perf_counter() - start, result


def main(options: Options) -> None:
    """Measures and prints."""
    keep_freed_memory()
    config = options.config
    small = replace(config, ppo=replace(config.ppo, total_steps=1, eval_interval=0))
    with ExitStack() as stack:
        one: tuple[CodesignConfig, Executor | None] = (config, None)
        ways = {
            "1 process": one,
            f"{options.workers} workers": (config, stack.enter_context(Workers(options.workers))),
            "1 process, one batch": (replace(config, piece=None), None),
        }
        for _, executor in ways.values():
            timed(small, executor)
        seconds: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(options.rounds):
            rows = []
            for name, way in ways.items():
                took, result = timed(*way)
                seconds[name].append(took)
                rows.append(result.rows)
            if rows[0] != rows[1]:
                raise RuntimeError(f"{options.workers} workers gave another result than one process")
    print(f"{config.task}, {options.material}, {config.population} bodies, {config.piece} in a piece")
    print(f"{result.env_steps:,} env-steps in the batch; the first two to the same bits")
    first = seconds["1 process"]
    for name, took in seconds.items():
        ratios = [before / now for before, now in zip(first, took, strict=True)]
        print(f"{name:<22} {statistics.median(took):>8.1f} s   {statistics.median(ratios):.2f} times as fast")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
