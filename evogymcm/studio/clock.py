"""A thread that keeps time: calls at a given rate, without spinning and without a rush after a delay."""

import threading
import time
from collections.abc import Callable
from weakref import WeakMethod

from evogymcm._settings import check_number

FASTEST = 1000.0  # calls a second; more would leave others too little time
_BEHIND = 0.1  # seconds of delay that are caught up; more are forgotten


class Clock:
    """Calls a method so many times a second while it runs, in a thread of its own that waits in between.

    An error ends the running and is kept. The method's object is held weakly: a clock keeps nobody alive.

    Args:
        tick: What to call; a bound method.
        rate: Calls a second.

    Attributes:
        error: What the last call raised, None if it raised nothing.

    Raises:
        ValueError: The rate is not above 0 and at most 1000.
    """

    def __init__(self, tick: Callable[[], None], rate: float) -> None:
        self._tick = WeakMethod(tick)
        self._rate = check_number("speed", rate, above=0.0, high=FASTEST)
        self._wake = threading.Condition()
        self._thread: threading.Thread | None = None
        self._runs = self._closed = False
        self.error: Exception | None = None

    @property
    def rate(self) -> float:
        """Calls a second; a new value counts from the last call on."""
        return self._rate

    @rate.setter
    def rate(self, rate: float) -> None:
        self._rate = check_number("speed", rate, above=0.0, high=FASTEST)
        with self._wake:
            self._wake.notify()

    @property
    def runs(self) -> bool:
        """Whether it calls."""
        return self._runs

    def start(self) -> None:
        """Begins to call; RuntimeError after `close`."""
        with self._wake:
            if self._closed:
                raise RuntimeError("player: it is closed")
            self._runs, self.error = True, None
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="evogymcm clock", daemon=True)
                self._thread.start()
            self._wake.notify()

    def stop(self) -> None:
        """Calls no more; a call that has begun may still go on."""
        with self._wake:
            self._runs = False
            self._wake.notify()

    def close(self) -> None:
        """Ends the thread, once a call that has begun has come to its end."""
        with self._wake:
            self._runs, self._closed = False, True
            self._wake.notify()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()

    def _run(self) -> None:
        last = -float("inf")
        while True:
            with self._wake:
                while not self._closed:
                    now = time.monotonic()
                    wait = last + 1.0 / self._rate - now
                    if self._runs and wait <= 0:
                        break
                    self._wake.wait(wait if self._runs else None)
                if self._closed:
                    return
            last = max(last + 1.0 / self._rate, now - _BEHIND)
            tick = self._tick()
            if tick is None:
                return
            try:
                tick()
            except Exception as error:  # whatever it is, it belongs to whoever looks, not to this thread
                self.error = error
                self.stop()
            del tick
