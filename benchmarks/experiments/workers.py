"""Runs of an experiment spread over processes, with a bar of progress; Ctrl-C stops them after the present updates."""

import multiprocessing
import os
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.experiments.experiment import Experiment, Job, Record
from evogymcm.algos.learning import keep_freed_memory
from evogymcm.algos.runs import stop_on_interrupt


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
    """Ends a worker whose main process was killed: nobody waits for it, and another may write there."""
    main_process = multiprocessing.parent_process()
    assert main_process is not None
    main_process.join()
    os._exit(1)


def _run_job(job: Job, folder: Path, resume: bool) -> Record:
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


def run_all(experiment: Experiment, folder: Path, processes: int, resume: bool) -> list[Record]:
    """Runs every job and returns their records, those of stopped runs included, of failed ones not."""
    jobs = experiment.jobs()
    pause = 0.1 if sys.stderr.isatty() else 30.0  # seconds between lines: a log file needs few
    bar = tqdm(
        total=experiment.steps_per_run * len(jobs),
        unit=" env-steps",
        unit_scale=True,
        smoothing=0.05,
        mininterval=pause,
    )
    steps: dict[str, int] = {}
    with _workers(min(processes, len(jobs))) as (pool, link), bar, stop_on_interrupt() as is_stopped:
        futures: dict[Future, Job] = {pool.submit(_run_job, job, folder, resume): job for job in jobs}
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
