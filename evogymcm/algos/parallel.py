"""Independent co-design runs (seeds, tasks, arms) on any executor: processes of this machine, Dask, Ray.

    with ProcessPoolExecutor() as executor:
        for folder, result in codesign_all(configs, Path("runs"), executor): ...

With Dask, `Client(...).get_executor(pure=False)` is an executor; with Ray, `RayExecutor()`. Workers must see the same
file system.
"""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

from evogymcm.algos.codesign import CodesignConfig, CodesignResult, codesign
from evogymcm.algos.runs import RunFolder
from evogymcm.envs.tasks import Task, as_task, register_task

__all__ = ["RayExecutor", "codesign_all", "codesign_in"]


def codesign_in(folder: Path, config: CodesignConfig, task: Task | None = None) -> CodesignResult:
    """Runs co-design in a folder, or goes on with what is there; what a worker does.

    Args:
        folder: of the run.
        config: of the run.
        task: that the configuration names, for workers that have not registered it.
    """
    if task is not None and task.id == config.task:  # the file of a world has no id
        register_task(task, replace=True)
    return codesign(config, run=RunFolder(folder, asdict(config), resume=folder.exists()), should_stop=lambda: False)


def codesign_all(
    configs: Mapping[str, CodesignConfig], folder: Path, executor: Executor
) -> Iterator[tuple[str, CodesignResult]]:
    """Runs every configuration in its own folder, and yields (name, result) as each ends.

    Runs that a folder holds already are gone on with, so that a broken batch is repeated without loss.

    Args:
        configs: by name, which is the name of the run's folder.
        folder: that holds the runs.
        executor: where they run; any `concurrent.futures.Executor`.

    Raises:
        ValueError: a run cannot start (`CodesignConfig.check`), before any of them does.
        Exception: what a run raised, once the others that had ended before it have been yielded.
    """
    if not callable(getattr(executor, "submit", None)):
        raise ValueError(f"executor: got {executor!r}, expected a concurrent.futures.Executor")
    for name, config in configs.items():
        try:
            config.check()
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    futures: dict[Future, str] = {}
    for name, config in configs.items():
        futures[executor.submit(codesign_in, folder / name, config, as_task(config.task))] = name
    # Dask's futures are not those that `as_completed` knows.
    is_known = all(isinstance(future, Future) for future in futures)
    for future in as_completed(futures) if is_known else futures:
        yield futures[future], future.result()


class RayExecutor(Executor):
    """Runs calls as tasks of a Ray cluster, the present one or a new local one (extra `evogymcm[ray]`)."""

    def __init__(self, **options: Any) -> None:
        try:
            import ray
        except ImportError as error:
            raise ImportError("RayExecutor needs the package ray: pip install evogymcm[ray]") from error
        self._ray = ray
        if not ray.is_initialized():
            ray.init(**options)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Returns the future of one call."""
        return self._ray.remote(fn).remote(*args, **kwargs).future()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leaves the cluster."""
        self._ray.shutdown()
