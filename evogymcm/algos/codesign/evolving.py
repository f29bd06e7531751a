"""Evolution of bodies together with their gaits, from settings alone."""

import os
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from typing import Any

from evogymcm.algos.codesign.codesigning import first_record
from evogymcm.algos.codesign.design import Individual
from evogymcm.algos.codesign.evolution import Evolution, check_evolution, waves_of
from evogymcm.algos.codesign.evolve_config import EvolveConfig
from evogymcm.algos.codesign.run import CodesignProgress
from evogymcm.algos.gaits.wave import Waves
from evogymcm.algos.runs.folder import RunFolder, stop_on_interrupt
from evogymcm.algos.runs.record import best_curve


@dataclass(frozen=True, eq=False)
class EvolveResult:
    """Outcome of an evolution.

    Attributes:
        best: the best design: where it is finished, of the last survivors the one with the highest robust score and
            last reward.
        waves: its gait, to be used with `play` and `evaluate`.
        rows: the table, see `Evolution`.
        env_steps: env-steps simulated in all.
        played: candidates that were played in all.
        finished: False if it was stopped.
    """

    best: Individual | None
    waves: Waves | None
    rows: list[dict[str, Any]]
    env_steps: int
    played: int
    finished: bool


def evolve(
    config: EvolveConfig,
    *,
    run: RunFolder | str | os.PathLike[str] | None = None,
    progress: Callable[[CodesignProgress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> EvolveResult:
    """Evolves bodies together with their gaits, and returns the best design.

    The same settings and seed give the same result, whether or not the run was stopped and resumed in between.

    Args:
        config: settings of the run.
        run: folder for the run's record, its table, the best gait (`gait.json`) and the state. A run that exists at a
            path is resumed, and so is a `RunFolder` that was opened with `resume`. None keeps everything in memory.
        progress: called after every generation.
        should_stop: called as often; the run stops if it returns True. By default Ctrl-C stops it.

    Raises:
        ValueError: A run with these settings cannot start: there is no such task, or a body that fills the shape does
            not fit into its world. Nothing has been simulated then.
    """
    if run is None:
        return _to_the_end(Evolution(config), progress, should_stop)
    settings = asdict(config)
    if not isinstance(run, RunFolder):
        check_evolution(config)  # before there is a folder
        run = RunFolder(run, settings, resume=True)
    run.check_settings(settings)
    with run.lock():
        state = Evolution(config, run)
        record = first_record(config, config.evolves_stiffness)
        record.write(run)
        result = _to_the_end(state, progress, should_stop)
        state.store_best()
        best = next((row for row in reversed(result.rows) if result.best and row["index"] == result.best.index), None)
        replace(
            record,
            finished=result.finished,
            env_steps=result.env_steps,
            curve=best_curve(result.rows),
            best=best,
            n_designs=state.n_designs,
        ).write(run)
    return result


def _to_the_end(
    state: Evolution,
    progress: Callable[[CodesignProgress], None] | None,
    should_stop: Callable[[], bool] | None,
) -> EvolveResult:
    """Plays all generations that are left, unless it is stopped."""
    with stop_on_interrupt() if should_stop is None else nullcontext(should_stop) as is_stopped:
        while not state.is_finished and not is_stopped():
            told = state.advance()
            if progress:
                progress(told)
    best = state.best
    waves = None if best is None else waves_of([best])
    individual = None if best is None else best.individual
    return EvolveResult(individual, waves, state.rows, state.env_steps, state.played, state.is_finished)
