"""What torch and TorchRL keep for the whole process, set for one thread: runs may go side by side in threads.

Torch's global generator is not among it: runs draw from generators of their own.
"""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar

import torch
from torchrl.envs.utils import ExplorationType, exploration_type, set_exploration_type

_LOCK = threading.Lock()
_EXPLORES: ContextVar[bool | None] = ContextVar("explores", default=None)  # None: as TorchRL's exploration type says


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Sets for a while how many threads torch uses for the calling thread's work, and for no other's."""
    before = torch.get_num_threads()  # a thread's first question settles its number, which a new default may not change
    if count == before:
        yield
        return
    _set_threads(count)
    try:
        yield
    finally:
        _set_threads(before)


def _set_threads(count: int) -> None:
    """Sets the calling thread's number.

    Torch sets at the same time the number that threads yet to come begin with; one of them puts that back.
    """
    with _LOCK, ThreadPoolExecutor(1) as newcomer:
        default = newcomer.submit(torch.get_num_threads).result()
        torch.set_num_threads(count)
        newcomer.submit(torch.set_num_threads, default).result()


def explores() -> bool:
    """Returns whether actors act at random in the calling thread."""
    told = _EXPLORES.get()
    return exploration_type() in (None, ExplorationType.RANDOM) if told is None else told


@contextmanager
def exploration(is_random: bool) -> Iterator[None]:
    """Has this library's actors act at random in the calling thread, or not, whatever other threads do meanwhile.

    TorchRL's exploration type is one for all threads, and its collectors and losses set it on their way. Here it is set
    for the sake of other modules only.
    """
    kind = ExplorationType.RANDOM if is_random else ExplorationType.DETERMINISTIC
    token = _EXPLORES.set(is_random)
    try:
        with _KEPT, set_exploration_type(kind):
            yield
    finally:
        _EXPLORES.reset(token)


class _KeptType:
    """Puts TorchRL's exploration type back once all have left: by themselves they may do so in the wrong order."""

    def __init__(self) -> None:
        self._users = 0
        self._outermost: AbstractContextManager[None] | None = None

    def __enter__(self) -> None:
        with _LOCK:
            if not self._users:
                self._outermost = set_exploration_type(exploration_type())
                self._outermost.__enter__()
            self._users += 1

    def __exit__(self, *exception: object) -> None:
        with _LOCK:
            self._users -= 1
            if not self._users and self._outermost is not None:
                self._outermost.__exit__(None, None, None)


_KEPT = _KeptType()
