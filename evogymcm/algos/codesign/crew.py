"""Who does the pieces of a generation: this process, one after another, or the workers of an executor."""

import pickle
import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Protocol
from uuid import uuid4

import cloudpickle

from evogymcm.algos.codesign.pieces import ShouldStop, Tell
from evogymcm.algos.runs.folder import RunInUseError

_PAUSE = 0.2  # seconds between looks at what workers have done
_DEATHS = 3  # of its workers that a piece may see
_WAITING = 60  # seconds for the piece's former worker, which the program before may have left, to stop
_GO, _PREFIX = "go", "pieces-"
_LOST = (  # of Dask and Ray, neither of which is needed here
    "distributed.scheduler.KilledWorker",
    "ray.exceptions.NodeDiedError",
    "ray.exceptions.OutOfMemoryError",  # which killed it
    "ray.exceptions.OwnerDiedError",
    "ray.exceptions.WorkerCrashedError",
)


class Piece(Protocol):
    """A piece of work, with all that it needs; returns something with `env_steps`, None where it was stopped."""

    def __call__(self, *, tell: Tell, should_stop: ShouldStop) -> Any:
        """Does it."""


class Crew:
    """Does pieces of work: in this process one after another, or on an executor.

    A worker that dies costs its piece, which another does anew, from its checkpoint if there is one.

    Args:
        executor: Whose workers do the pieces; None does them here.
        folder: Of the run; None keeps what workers and this process tell each other in a temporary folder.
    """

    def __init__(self, executor: Executor | None = None, folder: Path | None = None) -> None:
        self._executor, self._folder = executor, folder
        for old in folder.glob(f"{_PREFIX}*") if folder else ():  # of a run that was killed
            shutil.rmtree(old, ignore_errors=True)  # which also stops those of its pieces that still go on

    def do(self, pieces: Sequence[Piece], tell: Tell, is_stopped: ShouldStop) -> list[Any] | None:
        """Returns what the pieces return, in their order; None where it was stopped.

        Args:
            pieces: What is to be done.
            tell: Called with the env-steps that all have simulated so far.
            is_stopped: Asked now and then; once it is True, pieces stop after their present updates.

        Raises:
            Exception: The first error of a piece; the others have stopped then.
            RuntimeError: One piece has lost several workers.
        """
        if self._executor is not None:
            with self._board() as board:
                return self._spread(self._executor, board, pieces, tell, is_stopped)
        done, steps = list[Any](), 0
        for piece in pieces:
            if done and is_stopped():
                return None
            found = piece(tell=partial(_tell_more, tell, steps), should_stop=is_stopped)
            if found is None:
                return None
            done.append(found)
            steps += found.env_steps
        return done

    def _spread(
        self, executor: Executor, board: Path, pieces: Sequence[Piece], tell: Tell, is_stopped: ShouldStop
    ) -> list[Any] | None:
        """Does pieces on an executor."""
        calls = [cloudpickle.dumps(piece) for piece in pieces]
        done: dict[int, Any] = {}
        waiting: dict[Future, int] = {}
        deaths, changed, seen, is_patient = Counter[int](), threading.Event(), 0, True

        def submit(number: int) -> None:
            future = executor.submit(_do, calls[number], str(board), number)
            waiting[future] = number
            future.add_done_callback(lambda _: changed.set())

        try:
            for number in range(len(pieces)):
                submit(number)
            while waiting:
                changed.wait(_PAUSE)
                changed.clear()
                for future in [future for future in waiting if future.done()]:
                    number = waiting.pop(future)
                    try:
                        done[number] = pickle.loads(future.result())
                    except Exception as error:
                        if not _is_lost(error):
                            raise
                        deaths[number] += 1
                        if deaths[number] == _DEATHS:
                            raise RuntimeError(f"{_DEATHS} workers died at the same piece of work: {error}") from error
                        submit(number)
                steps = sum(_steps(board, number, done.get(number)) for number in range(len(pieces)))
                if steps != seen:
                    tell(steps)
                    seen = steps
                if None in done.values() or (waiting and is_stopped()):
                    return None
            return [done[number] for number in range(len(pieces))]
        except KeyboardInterrupt:
            is_patient = False
            raise
        finally:
            (board / _GO).unlink(missing_ok=True)
            # Not cancelled: Dask and Ray would call pieces cancelled that still go on, and hold their folders.
            while is_patient and not all(future.done() for future in waiting):
                changed.wait(_PAUSE)
                changed.clear()

    @contextmanager
    def _board(self) -> Iterator[Path]:
        """Yields a folder in which workers find whether to go on, and tell how far they are."""
        if self._folder is None:
            board = Path(tempfile.mkdtemp(prefix=_PREFIX))
        else:
            board = self._folder.resolve() / f"{_PREFIX}{uuid4().hex[:12]}"
            board.mkdir()
        (board / _GO).touch()
        try:
            yield board
        finally:
            shutil.rmtree(board, ignore_errors=True)


def check_executor(executor: Any) -> None:
    """Raises a ValueError for what is no executor."""
    if not callable(getattr(executor, "submit", None)):
        raise ValueError(f"executor: got {executor!r}, expected a concurrent.futures.Executor")


def _do(call: bytes, board: str, number: int) -> bytes:
    """Does a piece: what a worker does.

    In a worker that does not see the folder `board` it cannot be stopped.
    """
    piece = pickle.loads(call)
    here, own = Path(board), Path(board, f"{number}.steps")
    if not here.is_dir():
        return cloudpickle.dumps(piece(tell=lambda steps: None, should_stop=lambda: False))
    go, end = here / _GO, time.monotonic() + _WAITING
    while go.exists():
        try:
            return cloudpickle.dumps(piece(tell=partial(_write, own), should_stop=lambda: not go.exists()))
        except RunInUseError:
            if time.monotonic() > end:
                raise
            time.sleep(1.0)
    return pickle.dumps(None)


def _write(path: Path, steps: int) -> None:
    path.write_text(str(steps))


def _steps(board: Path, number: int, found: Any) -> int:
    """Returns the env-steps of a piece: of what it has returned, or that it has told of so far."""
    if found is not None:
        return int(found.env_steps)
    try:
        return int((board / f"{number}.steps").read_text())
    except (OSError, ValueError):  # not yet begun, or just being written
        return 0


def _tell_more(tell: Tell, before: int, steps: int) -> None:
    tell(before + steps)


def _is_lost(error: Exception) -> bool:
    """Whether an error says that a worker died, rather than what it worked on."""
    kinds = (f"{kind.__module__}.{kind.__qualname__}" for kind in type(error).__mro__)
    return isinstance(error, BrokenExecutor) or any(kind in _LOST for kind in kinds)
