"""Threads that share out the worlds of a batch."""

import os
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

# Springs: each takes half a microsecond an env-step, and a thread up to 0.1 ms to wake and to be waited for.
_PAYS = 600  # as many for each thread, or fewer threads
_SMALLEST = 200  # in a piece; to hand one out takes some ten microseconds


class Threads:
    """Runs pieces of a batch on several threads, where it pays; the kernels release Python's lock.

    The threads are started when they are first needed, and anew in a process that was forked, where there are none.
    """

    def __init__(self, n: int) -> None:
        self._n = n
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0  # the process that has the threads

    def run(self, job: Callable[[np.ndarray, int], None], worlds: np.ndarray, costs: np.ndarray) -> None:
        """Calls the job with pieces of the worlds, and the number of the thread that runs it.

        Whoever is done takes the next piece. An error, of which thread ever, is raised when none is at work any more.

        Args:
            job: What to run.
            worlds: (m,) numbers.
            costs: (m,) how much each world takes, in springs.
        """
        total = list(accumulate(costs.tolist()))
        n = min(self._n, len(worlds), total[-1] // _PAYS)
        if n < 2:
            job(worlds, 0)
            return
        if self._pool is None or self._process != os.getpid():
            self._pool, self._process = ThreadPoolExecutor(self._n - 1, thread_name_prefix="evogymcm"), os.getpid()
        pieces = iter([worlds[start:end] for start, end in pairwise(_ends(total, n))])

        def work(thread: int) -> None:
            for piece in pieces:
                job(piece, thread)

        others = [self._pool.submit(work, thread) for thread in range(1, n)]
        try:
            work(0)
        finally:
            for _ in pieces:  # after an error nobody takes another one
                pass
            # A thread that has not begun by now, on a busy machine, is not waited for.
            errors = [other.exception() for other in others if not other.cancel()]
        for error in errors:
            if error is not None:
                raise error

    def close(self) -> None:
        """Ends the threads; a later run starts them again."""
        if self._pool is not None and self._process == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_pool": None}


def _ends(total: Sequence[int], n: int) -> Iterator[int]:
    """Yields where pieces begin and end: large ones first, since few cost least, then ever smaller ones.

    So all of `n` threads end at about the same time, though what worlds really take shows only when they are advanced.

    Args:
        total: Cumulated costs of m worlds.
        n: Threads.
    """
    end, left = 0, total[-1]
    yield end
    while end < len(total):
        left -= max(left // (2 * n), _SMALLEST)
        end = bisect_left(total, total[-1] - left, end) + 1 if left > 0 else len(total)
        yield end
