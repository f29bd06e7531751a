"""The process of a job: `python -m evogymcm.studio.worker KIND FOLDER`."""

import contextlib
import os
import shutil
import signal
import sys
import time
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from evogymcm.algos.runs.folder import RunFolder
from evogymcm.studio.notes import Note
from evogymcm.studio.processes import LOCK, STOP, Job

KINDS = {
    "train": ("evogymcm.studio.learning", "Learning"),
    "material": ("evogymcm.studio.improving", "MaterialImprovement"),
    "codesign": ("evogymcm.studio.evolving", "Evolution"),
}
_NICE = 5  # at least: pages go first
_PATIENCE = 5.0  # seconds for others that look at the lock
_PAUSE = 0.25  # seconds between two notes
_LITTLE = 1 << 20  # bytes


def main(kind: str, folder: Path) -> int:
    """Does the work of a folder and returns the exit status."""
    asked: list[int] = []
    for interrupt in (signal.SIGINT, signal.SIGTERM):
        signal.signal(interrupt, lambda number, frame: asked.append(number))
    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(timeout=_PATIENCE)
    except Timeout:
        return 1  # another process is at it
    with contextlib.suppress(AttributeError, OSError):
        os.nice(max(0, _NICE - os.nice(0)))
    note, stop = Note(folder), folder / STOP
    note.write({"state": "running"})
    latest: dict[str, Any] = {}
    last = time.monotonic()

    def tell(told: Mapping[str, Any]) -> None:
        nonlocal last
        latest.update(told)
        if time.monotonic() - last >= _PAUSE:
            note.write({"state": "running", **latest})
            last = time.monotonic()

    try:
        module, name = KINDS[kind]
        job: Job = getattr(import_module(module), name).open(folder)
        run = RunFolder(folder, job.files.config, resume=True)
        finished = job.work(run, lambda: bool(asked) or stop.exists(), tell)
    except BaseException as error:
        note.write({"state": "failed", "error": _in_words(error, folder), **latest})
        raise
    note.write({"state": "finished" if finished else "stopped", **latest})
    return 0


def _in_words(error: BaseException, folder: Path) -> str:
    """Returns an error as people read it; torch does not say that a disk is full."""
    with contextlib.suppress(OSError):
        if isinstance(error, OSError | RuntimeError) and shutil.disk_usage(folder).free < _LITTLE:
            return "there is no room left on the disk; make some, then go on"
    return str(error) if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {error}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
