"""Processes of this machine that do calls, each its own, through the interface of executors."""

import json
import os
import pickle
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import IO, Any

import cloudpickle

# Ctrl-C is the main process's to handle. What is imported is what it would import.
_CHILD = f"""
import json, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.path[:] = json.loads(sys.argv[1])
from {__name__} import _serve
_serve()
"""
_LENGTH = 8  # bytes that say how many follow
_PATIENCE = 5.0  # seconds for idle processes to end


class Workers(ThreadPoolExecutor):
    """Runs calls in processes of this machine, which start when they are first needed.

    Unlike with `ProcessPoolExecutor`, a process that dies costs the call that it was at and no other, whose future
    then raises `BrokenExecutor`; another process takes its place. Processes do not import the main module, so that
    scripts need no `if __name__ == "__main__"`. They ignore Ctrl-C, and end with this process.

    As a context manager that an exception leaves, it kills them, whatever they are at.

    Args:
        count: the most processes at a time.
    """

    def __init__(self, count: int) -> None:
        super().__init__(count)
        self._own = threading.local()
        self._processes: list[subprocess.Popen[bytes]] = []
        self._lock, self._is_closed = threading.Lock(), False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Returns the future of one call; what it takes and returns is copied."""
        return super().submit(self._ask, cloudpickle.dumps((fn, args, kwargs)))

    def _ask(self, call: bytes) -> Any:
        """Has the process of this thread do a call."""
        process = self._process()
        try:
            _send(process.stdin, call)
            is_error, value = pickle.loads(_receive(process.stdout))
        except (OSError, EOFError):
            process.kill()
            raise BrokenExecutor(f"worker process {process.pid} died, exit status {process.wait()}") from None
        if is_error:
            raise value
        return value

    def _process(self) -> subprocess.Popen[bytes]:
        """Returns this thread's process, a new one where it has none that lives."""
        process: subprocess.Popen[bytes] | None = getattr(self._own, "process", None)
        if process is not None and process.poll() is None:
            return process
        with self._lock:
            if self._is_closed:
                raise BrokenExecutor("the workers were ended")
            command = [sys.executable, "-c", _CHILD, json.dumps(sys.path)]
            self._own.process = process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            self._processes.append(process)
        return process

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Takes no more calls; processes end after those that there are, at the latest with this process."""
        super().shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            for process in self._processes:
                with process:  # closes its pipes, which ends it
                    try:
                        process.communicate(timeout=_PATIENCE)
                    except subprocess.TimeoutExpired:
                        process.kill()

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        if kind is not None:
            with self._lock:
                self._is_closed = True
                for process in self._processes:
                    process.kill()
        self.shutdown(cancel_futures=kind is not None)


def _send(pipe: IO[bytes] | None, message: bytes) -> None:
    assert pipe is not None
    pipe.write(len(message).to_bytes(_LENGTH, "big"))
    pipe.write(message)
    pipe.flush()


def _receive(pipe: IO[bytes] | None) -> bytes:
    assert pipe is not None
    length = pipe.read(_LENGTH)
    message = pipe.read(int.from_bytes(length, "big")) if len(length) == _LENGTH else b""
    if not length or len(message) < int.from_bytes(length, "big"):
        raise EOFError
    return message


def _serve() -> None:
    """Does calls that come through the standard input, one after another: all that a worker process does."""
    from evogymcm.algos.learning.memory import keep_freed_memory

    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a task prints must not come between
    calls = SimpleQueue[bytes]()
    threading.Thread(target=_listen, args=(calls,), daemon=True).start()
    keep_freed_memory()
    while True:
        _send(answers, _answer(calls.get()))


def _listen(calls: SimpleQueue[bytes]) -> None:
    """Takes calls until the main process ends or wants no more; then this one ends, whatever it is at."""
    while True:
        try:
            calls.put(_receive(sys.stdin.buffer))
        except EOFError:
            os._exit(0)


def _answer(call: bytes) -> bytes:
    """Does a call; returns whether there was an error, and what it returned or the error, as bytes."""
    try:
        fn, args, kwargs = pickle.loads(call)
        return cloudpickle.dumps((False, fn(*args, **kwargs)))
    except Exception as error:
        told = f"in worker process {os.getpid()}:\n{traceback.format_exc()}"
        error.add_note(told)
        try:
            answer = cloudpickle.dumps((True, error))
            pickle.loads(answer)
        except Exception:  # some errors cannot be sent
            return cloudpickle.dumps((True, RuntimeError(told)))
        return answer
