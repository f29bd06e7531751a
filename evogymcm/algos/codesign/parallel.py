"""Independent co-design runs (seeds, tasks, materials) on any executor: processes of this machine, Dask, Ray.

    with ProcessPoolExecutor() as executor:
        for folder, result in codesign_all(configs, Path("runs"), executor): ...

With Dask, `Client(...).get_executor(pure=False)` is an executor; with Ray, `RayExecutor()`. Workers must see the same
file system; several threads in one are as good as several workers. The pieces of one run spread over the same
executors, see `codesign`.
"""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, as_completed
from concurrent.futures import wait as futures_wait
from pathlib import Path
from typing import Any

from evogymcm._extras import load_extra
from evogymcm.algos.codesign.codesigning import CodesignResult, codesign
from evogymcm.algos.codesign.config import CodesignConfig
from evogymcm.algos.codesign.crew import check_executor
from evogymcm.algos.codesign.start import check_start
from evogymcm.envs.tasks import Task, as_task, register_task


def codesign_in(folder: Path, config: CodesignConfig, task: Task | None = None) -> CodesignResult:
    """Runs co-design in a folder, or resumes the run that is there; this is what a worker does.

    `task` is the one that the settings name, for workers that have not registered it.
    """
    if task is not None and task.id == config.task:  # the file of a world has no id
        register_task(task, replace=True)
    return codesign(config, run=folder, should_stop=lambda: False, workers=1)


def codesign_all(
    configs: Mapping[str, CodesignConfig], folder: Path, executor: Executor
) -> Iterator[tuple[str, CodesignResult]]:
    """Runs every configuration in its own folder, and yields (name, result) as each ends.

    Runs that exist in the folder are resumed, so that an interrupted batch can be started again without loss.

    Args:
        configs: settings by name; the name is that of the run's folder.
        folder: the folder that holds the runs.
        executor: any `concurrent.futures.Executor`.

    Raises:
        ValueError: a run cannot start, see `codesign`; then none has started.
        Exception: the error of a run, after the results of those that ended before it were yielded.
    """
    check_executor(executor)
    for name, config in configs.items():
        try:
            check_start(config)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    futures: dict[Future, str] = {}
    for name, config in configs.items():
        futures[executor.submit(codesign_in, folder / name, config, as_task(config.task))] = name
    # Dask's futures are not those that `as_completed` knows.
    is_known = all(isinstance(future, Future) for future in futures)
    for future in as_completed(futures) if is_known else futures:
        yield futures[future], future.result()


def _call(function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
    """Calls anything: Ray itself takes plain functions only, and makes an actor of a class."""
    return function(*args, **kwargs)


_PATIENCE = 1.0  # seconds


class RayExecutor(Executor):
    """Runs calls as tasks of a Ray cluster (extra `evogymcm[ray]`).

    If the program has a Ray session already, it is used, and stays open after the executor; otherwise one is opened.

    Args:
        options: arguments of `ray.init`, where a session is opened, such as `address="auto"`; by default a new local
            cluster.

    Raises:
        ImportError: the package ray is missing.
    """

    def __init__(self, **options: Any) -> None:
        ray = load_extra("ray", "RayExecutor needs the package ray", "ray")
        self._ray, self._is_ours = ray, not ray.is_initialized()
        if self._is_ours:
            ray.init(**options)
        self._is_shut = False
        self._pending: dict[Future, Any] = {}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Returns the future of one call."""
        if self._is_shut:
            raise RuntimeError("submit: the executor has been shut down")
        call = self._ray.remote(_call).remote(fn, *args, **kwargs)
        future = call.future()
        self._pending[future] = call
        future.add_done_callback(self._pending.pop)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Takes no more calls, and ends the session if it was this executor that opened it.

        Args:
            wait: whether to wait for running calls; otherwise they continue in the session until the program ends.
            cancel_futures: whether calls that have not ended are cancelled.
        """
        self._is_shut = True
        pending = dict(self._pending)
        if cancel_futures:
            self._cancel(pending)
        if wait:
            # A call that Ray is just about to begin may miss being cancelled, so that it is told again.
            while cancel_futures and (left := futures_wait(pending, timeout=_PATIENCE).not_done):
                self._cancel({future: pending[future] for future in left})
            futures_wait(pending)
            if self._is_ours:
                self._is_ours = False
                self._ray.shutdown()

    def _cancel(self, calls: dict[Future, Any]) -> None:
        for call in calls.values():
            self._ray.cancel(call)
