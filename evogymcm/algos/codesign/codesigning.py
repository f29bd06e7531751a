"""Co-design of body, material and control, from settings alone.

In the reactive setting bodies evolve, and policies set stiffness; in the invariant one bodies evolve with one given
stiffness, or with stiffness fields of their own, by material search and fine-tuning of survivors.
"""

import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from typing import Any

from evogymcm._settings import WORK, check_count
from evogymcm.algos.codesign.config import CodesignConfig
from evogymcm.algos.codesign.crew import check_executor
from evogymcm.algos.codesign.design import Individual
from evogymcm.algos.codesign.evolve_config import EvolveConfig
from evogymcm.algos.codesign.inner_loop import Policy
from evogymcm.algos.codesign.plan import cost_of, pieces
from evogymcm.algos.codesign.run import Codesign, CodesignProgress
from evogymcm.algos.codesign.start import check_start
from evogymcm.algos.codesign.workers import Workers
from evogymcm.algos.runs.folder import RunFolder, stop_on_interrupt
from evogymcm.algos.runs.origin import find_origin, usable_cores
from evogymcm.algos.runs.record import RunRecord, best_curve

_WORTH_WORKERS = 200_000  # env-steps; processes take some seconds to start


@dataclass(frozen=True)
class CodesignResult:
    """Outcome of a run.

    Attributes:
        best: the best individual; None if the run was stopped before there was one.
        policy: its policy.
        rows: the table, see `Codesign`.
        env_steps: env-steps simulated in all.
        finished: False if it was stopped.
    """

    best: Individual | None
    policy: Policy | None
    rows: list[dict[str, Any]]
    env_steps: int
    finished: bool


def codesign(
    config: CodesignConfig,
    *,
    run: RunFolder | str | os.PathLike[str] | None = None,
    progress: Callable[[CodesignProgress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
) -> CodesignResult:
    """Runs co-design to the end of its budget, and returns the best design with its policy.

    The same settings and seed give the same result, to the last bit, with any workers, and whether or not the run was
    stopped and resumed in between. A worker that dies costs the pieces that it was at, which others go on with.

    Args:
        config: settings of the run.
        run: folder for the run's record, its table, policies and checkpoints. A run that exists at a path is resumed,
            and so is a `RunFolder` that was opened with `resume`. None keeps everything in memory.
        progress: called after every update of a policy and every round of a search.
        should_stop: called as often; the run stops if it returns True. By default Ctrl-C stops it after the current
            update.
        workers: processes of this machine over which the pieces of a generation spread, see `CodesignConfig.piece`; 1
            does them in this process. By default as many as it has cores, and 1 for a run of seconds.
        executor: any `concurrent.futures.Executor`, of Dask's or Ray's cluster too, over which they spread instead. Its
            workers should see the run's folder: otherwise pieces begin anew where they were stopped.

    Raises:
        ValueError: A run with these settings cannot start: there is no such task, or a body that fills the shape does
            not fit into its world; or both workers and an executor are given. Nothing has been simulated then.
        RuntimeError: Several workers died at the same piece.
        ImportError: The package of the method or of the search's proposals is missing.
    """
    with _spreading(config, workers, executor) as spread:
        return _codesign(config, run, progress, should_stop, spread)


def _codesign(
    config: CodesignConfig,
    run: RunFolder | str | os.PathLike[str] | None,
    progress: Callable[[CodesignProgress], None] | None,
    should_stop: Callable[[], bool] | None,
    executor: Executor | None,
) -> CodesignResult:
    """Runs co-design on an executor, or in this process alone."""
    if run is None:
        return _to_the_end(Codesign(config, executor=executor), progress, should_stop)
    settings = asdict(config)
    if not isinstance(run, RunFolder):
        check_start(config)  # before there is a folder
        run = RunFolder(run, settings, resume=True)
    run.check_settings(settings)
    with run.lock():
        state = Codesign(config, run, executor=executor)
        record = replace(first_record(config, config.search is not None), initial=state.began)
        record.write(run)
        result = _to_the_end(state, progress, should_stop)
        replace(
            record,
            finished=result.finished,
            env_steps=result.env_steps,
            curve=best_curve(result.rows),
            best=_best(result),
            n_designs=len({row["index"] for row in result.rows}),
        ).write(run)
    return result


def first_record(config: CodesignConfig | EvolveConfig, has_fields: bool) -> RunRecord:
    """Returns the record of a run that begins; `has_fields` says whether designs have stiffness fields of their own."""
    stiffness = None if config.material == "reactive" or has_fields else config.stiffness
    return RunRecord(
        "codesign",
        config.task,
        label=config.material if stiffness is None else f"stiffness {stiffness:g}",
        material=config.material,
        stiffness=stiffness,
        edge_rule=config.edge_rule,
        seed=config.seed,
        origin=find_origin(),
    )


def count_workers(config: CodesignConfig, workers: int | None) -> int:
    """Returns over how many processes a run spreads: as many as are wanted, but no more than have something to do.

    Raises:
        ValueError: The number is none, or there is no such task.
    """
    if workers is not None:
        wanted = check_count("workers", workers)
    else:
        steps = min(cost_of(config).total, config.max_env_steps or math.inf)
        wanted = usable_cores() if steps >= _WORTH_WORKERS else 1
    return min(wanted, len(pieces(config.population, config.piece)))


@contextmanager
def _spreading(config: CodesignConfig, workers: int | None, executor: Executor | None) -> Iterator[Executor | None]:
    """Yields what pieces spread over, None for this process alone."""
    if executor is not None:
        if workers is not None:
            raise ValueError(f"workers: got {workers} beside an executor, which has its own; only one can be given")
        check_executor(executor)
        yield executor
    elif (count := count_workers(config, workers)) == 1:
        yield None
    else:
        with Workers(count) as own:
            yield own


def _to_the_end(
    state: Codesign,
    progress: Callable[[CodesignProgress], None] | None,
    should_stop: Callable[[], bool] | None,
) -> CodesignResult:
    """Does all phases that are left, unless it is stopped."""
    with stop_on_interrupt() if should_stop is None else nullcontext(should_stop) as is_stopped:
        while not state.is_finished and not is_stopped():
            if not state.advance(progress, is_stopped):
                break
    best = state.ledger.champion
    policy = None if best is None else state.ledger.policy(best.index)
    return CodesignResult(best, policy, state.ledger.rows, state.env_steps, state.is_finished)


def _best(result: CodesignResult) -> dict[str, Any] | None:
    """Returns the best individual's record, with its scores from several starts and its work where there are such."""
    if result.best is None:
        return None
    row = next(row for row in reversed(result.rows) if row["index"] == result.best.index)
    told = ("score", "robust_score", "spread", *WORK)
    return result.best.record() | {name: row[name] for name in told if name in row}
