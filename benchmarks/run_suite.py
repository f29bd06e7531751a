"""Runs the EvoGymCM paper's experiments.

    python benchmarks/run_suite.py --preset quick
    python benchmarks/run_suite.py --preset reactive-small

A: fixed robots with and without stiffness control (its Table I). Each run trains one policy with PPO. Scores are those
of the deterministic policy in a fresh world, summed without an episode's last step, as in the paper. The table shows
the last policy's score; the best of training stands apart.

B (presets reactive-...): co-design of body and control, with stiffness control and without. C (invariant-...): with
searched stiffness fields and without. Both arms have the same budget of simulated env-steps, evaluations included.
"""

import multiprocessing
import os
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import _codesign
import _codesign_report
import _report
import tyro
from _codesign import CodesignJob, CodesignSuite
from _machine import commit, machine, usable_cores, versions
from _suite import PRESETS, Job, Suite
from tqdm import tqdm

from evogymcm.algos import RunFolder, keep_freed_memory, stop_on_interrupt

_TYPICAL_RATE = 2_500  # env-steps per second of one process, updates included, on one core


@dataclass(frozen=True)
class Options:
    """Command line: a preset, and what to change in it.

    Attributes:
        preset: A: quick (Walker-v0, both arms, under 5 minutes on 2 cores), walker (Walker-v0 with stiffness control,
            3 seeds, about as long), standard (6 tasks, 1 seed, 500,000 env-steps each), table (6 tasks, 3 seeds,
            600,000 env-steps each), paper (the same with 1,000,000), exploring (as table, AreaMinimizer-v0 only, with
            initial_std 4). B and C: reactive-... and invariant-quick (1 task, minutes), -small (2 tasks, 3 seeds),
            -medium (the same, hours) and -paper (6 tasks, 100 bodies of 1,000,000 env-steps a run: days), -shortcuts
            (as -small, with policy inheritance and successive halving, see steps_to_reach.py). reactive-screening: the
            same, and children chosen from mutants. hundred-bodies-reactive, -invariant, -exploring-invariant,
            -screening-invariant, -sparse-prescribed: one arm with as many bodies as published genetic algorithms train,
            6 tasks, hours.
        tasks: tasks instead of the preset's.
        arms: "control-only", "co-optimisation" or both, instead of the preset's; in B "fixed", "reactive", in C
            "prescribed", "invariant".
        seeds: training seeds instead of the preset's.
        total_steps: env-steps of each run instead of the preset's.
        body_steps: B and C: env-steps of each body's training instead of the preset's.
        num_worlds: worlds simulated together instead of the preset's; in B and C, of each body.
        output: folder of the results; default runs/suite-PRESET.
        processes: runs trained side by side; default one per core.
        resume: go on with the runs in the folder.
        overwrite: delete the runs in the folder first.
    """

    preset: str = "quick"
    tasks: tuple[str, ...] = ()
    arms: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    total_steps: int | None = None
    body_steps: int | None = None
    num_worlds: int | None = None
    output: Path | None = None
    processes: int | None = None
    resume: bool = False
    overwrite: bool = False

    def suite(self) -> Suite | CodesignSuite:
        """Returns the preset with the changes asked for.

        Raises:
            ValueError: There is no such preset, task or arm.
        """
        presets: dict[str, Suite | CodesignSuite] = {**PRESETS, **_codesign.PRESETS}
        if self.preset not in presets:
            raise ValueError(f"preset: got {self.preset!r}, allowed are {', '.join(presets)}")
        suite = presets[self.preset]
        changes = {key: getattr(self, key) for key in ("tasks", "arms", "seeds") if getattr(self, key)}
        ppo: dict[str, Any] = {} if self.num_worlds is None else {"num_worlds": self.num_worlds}
        if isinstance(suite, Suite):
            ppo |= {} if self.total_steps is None else {"total_steps": self.total_steps}
            return replace(suite, ppo=replace(suite.ppo, **ppo), **changes)
        ppo |= {} if self.body_steps is None else {"total_steps": self.body_steps}
        base = replace(suite.base, ppo=replace(suite.base.ppo, **ppo))
        if self.total_steps is not None:
            base = replace(base, max_env_steps=self.total_steps)
        return replace(suite, base=base, **changes)


@dataclass(frozen=True)
class _Link:
    """What ties a worker process to the main one."""

    news: Any  # queue of (run's name, env-steps, score or None)
    stop: Any  # event


_link: _Link | None = None


def _start_worker(link: _Link) -> None:
    """Prepares a worker; Ctrl-C is the main process's to handle."""
    global _link
    _link = link
    keep_freed_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_main, daemon=True).start()


def _end_with_main() -> None:
    """Ends a worker whose main process was killed: nobody waits for it, and a resumed suite writes where it does."""
    main_process = multiprocessing.parent_process()
    assert main_process is not None
    main_process.join()
    os._exit(1)


def _run_job(job: Job | CodesignJob, folder: Path, resume: bool) -> dict[str, Any]:
    """One run, in a worker."""
    link = _link
    assert link is not None

    def tell(env_steps: int, score: float | None) -> None:
        link.news.put((job.name, env_steps, score))

    return job.run(folder, resume, tell, link.stop.is_set)


@contextmanager
def _workers(count: int) -> Iterator[tuple[ProcessPoolExecutor, _Link]]:
    """A pool of spawned processes and its link."""
    context = multiprocessing.get_context("spawn")
    link = _Link(context.Queue(), context.Event())
    with ProcessPoolExecutor(count, context, _start_worker, (link,)) as pool:
        yield pool, link


def _news(link: _Link) -> Iterator[tuple[str, int, float | None]]:
    """All that workers have told by now."""
    while True:
        try:
            yield link.news.get_nowait()
        except queue.Empty:
            return


def run_all(suite: Suite | CodesignSuite, folder: Path, processes: int, resume: bool) -> list[dict[str, Any]]:
    """Runs every job of the suite and returns their records, those of stopped runs included, of failed ones not."""
    jobs = suite.jobs()
    pause = 0.1 if sys.stderr.isatty() else 30.0  # seconds between lines: a log file needs few
    bar = tqdm(
        total=suite.steps_per_run * len(jobs), unit=" env-steps", unit_scale=True, smoothing=0.05, mininterval=pause
    )
    steps: dict[str, int] = {}
    with _workers(min(processes, len(jobs))) as (pool, link), bar, stop_on_interrupt() as is_stopped:
        futures: dict[Future, Job | CodesignJob] = {pool.submit(_run_job, job, folder, resume): job for job in jobs}
        waiting = set(futures)
        while waiting:
            ended, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
            for name, done, score in _news(link):
                if name not in steps:
                    bar.initial += done  # of an earlier sitting: no part of the rate
                bar.update(done - steps.get(name, 0))
                steps[name] = done
                if score is not None:
                    bar.set_postfix_str(f"{name}: score {score:.2f}", refresh=False)
            for future in ended:  # the other runs go on
                if not future.cancelled() and (error := future.exception()):
                    bar.write("".join(traceback.format_exception(error)), file=sys.stderr)
                    bar.write(f"{futures[future].name} failed.", file=sys.stderr)
            if is_stopped() and not link.stop.is_set():
                link.stop.set()
                bar.write("Stopping after the present updates ...", file=sys.stderr)
                for future in futures:
                    future.cancel()
    return [future.result() for future in futures if not future.cancelled() and future.exception() is None]


def _try_to_plot(draw: Callable[[list[dict[str, Any]], Path], None], runs: list[dict[str, Any]], path: Path) -> None:
    """Draws a figure where matplotlib is installed."""
    try:
        draw(runs, path)
    except ModuleNotFoundError:
        print("No figure: it needs matplotlib (pip install evogymcm[render]).", file=sys.stderr)


def main(options: Options) -> int:
    """Runs the suite, writes results.json and curves.png into the run folder and prints the table."""
    try:
        suite = options.suite()
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    folder = options.output or Path("runs") / f"suite-{options.preset}"
    try:
        run = RunFolder(folder, asdict(suite), resume=options.resume, overwrite=options.overwrite)
    except (FileExistsError, ValueError) as error:
        print(f"{error} (--resume, --overwrite)", file=sys.stderr)
        return 2
    processes = options.processes or usable_cores()
    n_runs, total = len(suite.jobs()), len(suite.jobs()) * suite.steps_per_run
    hours = total / (_TYPICAL_RATE * min(processes, n_runs)) / 3600
    print(
        f"{n_runs} runs of {suite.steps_per_run:,} env-steps, {total:,} in all, in {min(processes, n_runs)} processes:"
        f" about {hours:.1f} h at {_TYPICAL_RATE:,} env-steps/s each",
        file=sys.stderr,
    )
    start = time.perf_counter()
    runs = run_all(suite, folder, processes, options.resume)
    report = _report if isinstance(suite, Suite) else _codesign_report
    rows = report.summarise(runs)
    run.write_json(
        "results.json",
        {
            "suite": asdict(suite),
            "processes": processes,
            "machine": machine(),
            "versions": versions(),
            "commit": commit(),
            "wall_seconds": time.perf_counter() - start,
            "summary": rows,
            **({"overall": _report.overall(rows)} if isinstance(suite, Suite) else {}),
            "runs": runs,
        },
    )
    if runs:
        _try_to_plot(report.plot, runs, folder / "curves.png")
        if isinstance(suite, CodesignSuite):
            _try_to_plot(_codesign_report.draw_designs, runs, folder / "designs.png")
    print(report.table(rows))
    print(f"Results: {folder.resolve()}")
    is_complete = len(runs) == len(suite.jobs()) and all(record["finished"] for record in runs)
    if not is_complete:
        print("Not finished; go on with --resume.")
    return 0 if is_complete else 1


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
