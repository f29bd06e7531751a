"""The one program: runs an experiment into a folder with config.json, results.json, table.md and a figure."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.experiments.options import Options, WriteDocs, command_of, parse
from benchmarks.experiments.pages import page, write_docs
from benchmarks.experiments.workers import run_all
from evogymcm._files import write_atomic
from evogymcm.algos.runs import RunFolder, find_origin, usable_cores

_TYPICAL_RATE = 2_500  # env-steps per second of one process, updates included, on one core
_PRESETS = "--preset is gone: write A, B or C, and --size quick, small or paper; --help tells more"


def main(arguments: Sequence[str]) -> int:
    """Does what the command line asks for; returns 0 where it is finished, 1 where it is not, 2 for bad settings."""
    try:
        if any(argument.startswith("--preset") for argument in arguments):
            raise ValueError(_PRESETS)
        options = parse(arguments)
        if isinstance(options, WriteDocs):
            write_docs(options.figures)
            return 0
        n_runs, steps = len(options.experiment.jobs()), options.experiment.steps_per_run
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    settings = options.settings()
    command = command_of(options.name, options.experiment)
    folder = options.output or Path("runs") / f"{options.name}-{options.size}"
    config = {"command": command, **settings}
    try:
        run = RunFolder(folder, config, resume=options.resume, overwrite=options.overwrite)
    except (FileExistsError, ValueError) as error:
        print(f"{error} (--resume, --overwrite)", file=sys.stderr)
        return 2
    return _run(options, run, {"command": command, "suite": settings}, n_runs, steps)


def _run(options: Options[Any], run: RunFolder, results: dict[str, Any], n_runs: int, steps: int) -> int:
    """Runs the experiment, writes what it found into its folder and prints the tables."""
    experiment, processes = options.experiment, min(options.processes or usable_cores(), n_runs)
    print(
        f"{n_runs} runs of {steps:,} env-steps, {n_runs * steps:,} in all, in {processes} processes: about"
        f" {n_runs * steps / (_TYPICAL_RATE * processes) / 3600:.1f} h at {_TYPICAL_RATE:,} env-steps/s each",
        file=sys.stderr,
    )
    start = time.perf_counter()
    runs = run_all(experiment, run.path, processes, options.resume)
    is_complete = len(runs) == n_runs and all(record["finished"] for record in runs)
    results |= {
        "finished": is_complete,
        "processes": processes,
        **find_origin(),
        "wall_seconds": time.perf_counter() - start,
        "summary": experiment.summarise(runs),
        "runs": runs,
    }
    run.write_json("results.json", results)
    text = page(results)
    write_atomic(run.path / "table.md", lambda part: part.write_text(text, encoding="utf-8"))
    try:
        experiment.plot(runs, run.path / "curves.png")
    except ModuleNotFoundError:
        print("No figure: it needs matplotlib (pip install evogymcm[render]).", file=sys.stderr)
    print(text)
    print(f"Results: {run.path.resolve()}")
    if not is_complete:
        print("Not finished; go on with --resume.")
    return 0 if is_complete else 1
