"""Run folders: settings, a table that grows, checkpoints; safe against interruption at any moment."""

import errno
import json
import math
import os
import shutil
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from evogymcm._files import write_atomic
from evogymcm.algos.runs.older import present_settings

CONFIG, TABLE = "config.json", "curve.jsonl"
_LOCK = ".lock"
_CANNOT_LOCK = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)  # of some network file systems
_SAME_PRESS = 0.5  # seconds; launchers may pass one Ctrl-C on twice


def _plain(value: Any) -> Any:
    """`value` as JSON knows it: tuples become lists, numbers that JSON lacks (NaN, infinity) become null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class RunInUseError(RuntimeError):
    """Another process or thread is working in a run's folder."""


class RunFiles:
    """The files of a run's folder, for reading only: nothing is written or locked.

    Attributes:
        path: The folder.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)

    @property
    def config(self) -> dict[str, Any]:
        """The settings of the run, {} where the folder has none."""
        return self.read_json(CONFIG)

    def read_json(self, name: str) -> dict[str, Any]:
        """Returns the object in a JSON file, {} where there is no such file.

        Raises:
            ValueError: It is not JSON, or not an object.
        """
        path = self.path / name
        if not path.is_file():
            return {}
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"{path}: not JSON: {error}") from error
        if not isinstance(content, dict):
            raise ValueError(f"{path}: got {type(content).__name__}, expected a JSON object")
        return content

    def rows(self) -> list[dict[str, Any]]:
        """Returns the table; a last row cut short by a crash is left out.

        Raises:
            ValueError: It is not a table of JSON rows.
        """
        table = self.path / TABLE
        if not table.is_file():
            return []
        lines = table.read_text(encoding="utf-8").splitlines(keepends=True)
        try:
            return [json.loads(line) for line in lines if line.endswith("\n")]
        except ValueError as error:
            raise ValueError(f"{table}: not a table of JSON rows: {error}") from error

    def load(self, name: str) -> dict[str, Any] | None:
        """Returns the checkpoint `name`, None if there is none."""
        import torch  # loading settings and tables does without

        path = self.path / f"{name}.pt"
        return torch.load(path, weights_only=True) if path.exists() else None


class RunFolder(RunFiles):
    """A folder that holds one run: `config.json`, the table `curve.jsonl`, and named checkpoints (`*.pt`).

    Whoever adds to a run should hold its `lock`, as `train` and `codesign` do. `RunFolder.open` is for reading.

    Args:
        path: the folder, made if it does not exist.
        config: settings of the run, of JSON types, saved and compared when resuming.
        resume: continue an existing run with equal settings.
        overwrite: delete an existing run first.

    Raises:
        FileExistsError: if the folder exists and neither flag is given, or it is not a run folder.
        ValueError: if both flags are given, or the settings differ from those of the run to resume.
        RunInUseError: if another process or thread is working in the folder that is to be overwritten.
    """

    def __init__(
        self, path: str | os.PathLike[str], config: Mapping[str, Any], *, resume: bool = False, overwrite: bool = False
    ) -> None:
        super().__init__(path)
        config = _plain(config)
        if resume and overwrite:
            raise ValueError("resume and overwrite: only one of them can be set")
        if not self._may_begin(config, resume, overwrite):
            return
        self.path.mkdir(parents=True, exist_ok=True)
        with self.lock():
            if not self._may_begin(config, resume, overwrite):  # another process was quicker
                return
            for old in self._files(halves=True):
                shutil.rmtree(old) if old.is_dir() and not old.is_symlink() else old.unlink()
            self.write_json(CONFIG, config)

    @staticmethod
    def open(path: str | os.PathLike[str]) -> RunFiles:
        """Returns an existing run, of this version or an earlier one, for reading.

        Raises:
            ValueError: The folder holds no run.
        """
        files = RunFiles(path)
        if not any((files.path / name).is_file() for name in (CONFIG, TABLE)):
            raise ValueError(f"{path} holds no run: neither {CONFIG} nor {TABLE}")
        return files

    def _files(self, halves: bool = False) -> list[Path]:
        """Returns what there is besides the lock, with or without what a kill left half written."""
        files = self.path.iterdir() if self.path.exists() else ()
        return [file for file in files if file.name != _LOCK and (halves or file.suffix != ".part")]

    def _may_begin(self, config: Mapping[str, Any], resume: bool, overwrite: bool) -> bool:
        """Returns whether a run starts here; False if one is resumed. Raises an error where neither is allowed."""
        if not self._files():
            return True
        if not (self.path / CONFIG).is_file():
            raise FileExistsError(f"{self.path} exists and is not a run folder")
        if not (resume or overwrite):
            raise FileExistsError(f"{self.path} exists; set resume to continue it or overwrite to replace it")
        if resume:
            self._refuse_others(config, set.union)
        return overwrite

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Locks the folder against other processes, and against other threads of this one.

        The lock ends with the process in any case. On a file system without locks there is a warning instead.

        Raises:
            RunInUseError: if another process or thread has locked it.
        """
        lock = FileLock(self.path / _LOCK)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise RunInUseError(f"{self.path} is in use: another process or thread works on the run") from None
        except (OSError, NotImplementedError) as error:
            if isinstance(error, OSError) and error.errno not in _CANNOT_LOCK:
                raise
            warnings.warn(
                f"{self.path}: this file system knows no locks; see to it that only one process works here",
                stacklevel=2,
            )
        try:
            yield
        finally:
            lock.release()

    def check_settings(self, config: Mapping[str, Any]) -> None:
        """Compares the settings of a run that is about to start with those that the folder was opened with.

        Args:
            config: Settings; the folder may have more of them, or fewer if it was made for something else.

        Raises:
            ValueError: Settings of one name differ.
        """
        self._refuse_others(_plain(config), set.intersection)

    def _refuse_others(self, config: Mapping[str, Any], which: Callable[[set[str], set[str]], set[str]]) -> None:
        """Raises a ValueError where settings differ from those saved, among the names of either or of both."""
        saved = present_settings(self.config)
        differing = sorted(name for name in which({*saved}, {*config}) if saved.get(name) != config.get(name))
        if differing:
            changes = "; ".join(f"{name}: got {config.get(name)}, the run has {saved.get(name)}" for name in differing)
            raise ValueError(f"cannot resume {self.path} with other settings: {changes}")

    def write_json(self, name: str, value: Any) -> None:
        """Writes `value` to the file `name`, atomically."""
        text = json.dumps(_plain(value), indent=2, allow_nan=False) + "\n"
        write_atomic(self.path / name, lambda part: part.write_text(text, encoding="utf-8"))

    def append(self, row: Mapping[str, Any]) -> None:
        """Adds a row to the table."""
        with (self.path / TABLE).open("a", encoding="utf-8") as file:
            file.write(json.dumps(_plain(row), allow_nan=False) + "\n")

    def keep_rows(self, count: int) -> None:
        """Cuts the table back to its first `count` rows: what came after the checkpoint will be repeated."""
        text = "".join(json.dumps(row) + "\n" for row in self.rows()[:count])
        write_atomic(self.path / TABLE, lambda part: part.write_text(text, encoding="utf-8"))

    def save(self, name: str, state: Mapping[str, Any]) -> None:
        """Writes the checkpoint `name`, atomically; `state` holds tensors, numbers, text, lists and mappings."""
        import torch

        write_atomic(self.path / f"{name}.pt", lambda part: torch.save(dict(state), part))


@contextmanager
def stop_on_interrupt() -> Iterator[Callable[[], bool]]:
    """Turns the first Ctrl-C into a flag, so that work can end in an orderly way; a second one interrupts as usual.

    Yields:
        A function that returns whether Ctrl-C was pressed; always False outside the main thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    pressed: list[float] = []

    def note(signum: int, frame: Any) -> None:
        pressed.append(time.monotonic())
        if pressed[-1] - pressed[0] > _SAME_PRESS:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)
