"""Work in a process of its own, kept in a run's folder: it outlives whoever started it, and can be found again."""

import io
import json
import os
import subprocess
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self

from filelock import FileLock, Timeout

from evogymcm._files import write_atomic
from evogymcm.algos.runs.folder import RunFiles, RunFolder
from evogymcm.sim.world import World, is_world_file
from evogymcm.studio.notes import Note

LOCK, STOP, _LOG = ".job.lock", ".job.stop", "job.log"
_LAST = 2000  # characters of the log in which the reason of an end is looked for
_PROBING = threading.Lock()  # one look at a lock at a time: each holds it for a moment

Tell = Callable[[Mapping[str, Any]], None]


class Job(ABC):
    """Work that runs in a process of its own and keeps what it has in a run's folder.

    The folder says everything: another `Job` on it, in this process or after a restart, finds the work as it is. States
    are "new" (not started), "running", "stopping", "stopped" (it can be resumed), "finished", "failed" (with an error;
    it can be resumed too) and "killed" (the process is gone without a word; it can be resumed).

    Args:
        folder: Of the run; made when the work starts.
        config: Its settings, a dataclass.

    Attributes:
        folder: The folder.
        config: The settings.
    """

    kind: ClassVar[str]  # by which the process knows what to do, see `worker`
    _world: tuple[str, bytes] | None = None  # name and content of a file: the world to walk in may change elsewhere

    def __init__(self, folder: str | os.PathLike[str], config: Any) -> None:
        self.folder, self.config = Path(folder).absolute(), config
        self._process: subprocess.Popen[bytes] | None = None

    @classmethod
    @abstractmethod
    def read_config(cls, saved: Mapping[str, Any]) -> Any:
        """Returns settings from a run's `config.json`; ValueError where they are of something else."""

    @abstractmethod
    def check(self) -> None:
        """Raises a ValueError where the work cannot start with these settings."""

    @abstractmethod
    def work(self, run: RunFolder, should_stop: Callable[[], bool], tell: Tell) -> bool:
        """Does the work, in its process, from where the folder is; returns whether it came to its end.

        Args:
            run: The folder.
            should_stop: To be asked often; work ends in an orderly way where it returns True.
            tell: Takes what `status` is to say besides what the folder holds; may be called as often as one likes.
        """

    @abstractmethod
    def progress(self, told: Mapping[str, Any]) -> dict[str, Any]:
        """Returns what `status` says besides state and error, from the folder and what the work told last."""

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> Self:
        """Returns the work in a folder, whoever started it and when.

        Raises:
            ValueError: There is none of this kind.
        """
        job = cls.__new__(cls)
        saved = RunFolder.open(folder).config
        try:
            config = cls.read_config(saved)
        except (TypeError, KeyError) as error:
            raise ValueError(f"{folder} holds no {cls.kind} run: {error}") from error
        Job.__init__(job, folder, config)
        return job

    @property
    @abstractmethod
    def has_finished(self) -> bool:
        """Whether the folder holds the end of the work."""

    @property
    def files(self) -> RunFiles:
        """The run's files, for reading."""
        return RunFiles(self.folder)

    @property
    def is_running(self) -> bool:
        """Whether its process is at work, started by this object or by another."""
        if self._is_locked():
            return True
        is_there = self._process is not None and self._process.poll() is None
        return is_there and Note(self.folder).read().get("state") == "running"  # else it is on its way out

    def start(self) -> None:
        """Begins the work in a new folder.

        Raises:
            ValueError: It cannot be done with these settings; then there is no folder.
            FileExistsError: The folder exists and is not empty.
            OSError: The folder cannot be made, or there is no room in it.
        """
        self.check()
        run = RunFolder(self.folder, asdict(self.config))
        self._prepare(run)
        self._launch()

    def resume(self) -> None:
        """Goes on with work that was stopped, has failed or was killed; without effect where it runs or has finished.

        Raises:
            ValueError: There is nothing to go on with, or its settings differ.
            OSError: There is no room in the folder.
        """
        if not (self.folder / "config.json").is_file():
            raise ValueError(f"{self.folder} holds no run to go on with")
        RunFolder(self.folder, asdict(self.config), resume=True)
        if self.status()["state"] not in ("running", "stopping", "finished"):
            self._launch()

    def _own(self, folder: str | os.PathLike[str], task: Any) -> str:
        """Returns the task as settings have it: of a world the copy that the folder is going to get."""
        if isinstance(task, World):
            self._world = "world.json", json.dumps(task.to_design_tool()).encode()
        elif is_world_file(task):
            World.load(task)
            self._world = f"world{Path(task).suffix.lower()}", Path(task).read_bytes()
        else:
            return task
        return str(Path(folder).absolute() / self._world[0])

    def _prepare(self, run: RunFolder) -> None:
        """Puts into a new folder what the work needs besides its settings."""
        if self._world is not None:
            name, content = self._world
            write_atomic(run.path / name, lambda part: part.write_bytes(content))

    def _launch(self) -> None:
        self._stop_file.unlink(missing_ok=True)
        note = Note(self.folder)
        note.write({"state": "running"})
        command = [sys.executable, "-m", "evogymcm.studio.worker", self.kind, str(self.folder)]
        options: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
        with (self.folder / _LOG).open("wb") as log:  # Ctrl-C is meant for whoever started it, not for the work
            self._process = subprocess.Popen(command, stderr=log, start_new_session=True, **options)

    def stop(self, wait: float = 0.0) -> bool:
        """Asks the work to end in an orderly way, keeping all that it has; returns whether it has ended.

        Args:
            wait: Seconds to wait for that at most.
        """
        if self.is_running:
            try:
                self._stop_file.touch()
            except OSError:  # the disk is full
                if self._process is None:
                    raise
                self._process.terminate()
        return self.wait(wait)

    def wait(self, seconds: float) -> bool:
        """Returns whether the process has ended, after so many seconds at most."""
        end = time.monotonic() + seconds
        while self.is_running:
            if time.monotonic() >= end:
                return False
            time.sleep(0.05)
        return True

    def status(self) -> dict[str, Any]:
        """Returns how the work stands: `state`, `error` (None where there is none), and what its class says."""
        running, told = self.is_running, Note(self.folder).read()
        state, error = told.pop("state", None), told.pop("error", None)
        if running:
            state, error = "stopping" if self._stop_file.exists() else "running", None
        elif self.has_finished:
            state, error = "finished", None
        elif state == "running":
            state, error = "killed", self._last_words()
        elif state is None:
            state = "stopped" if (self.folder / "config.json").is_file() else "new"
        try:
            progress = self.progress(told)
        except (ValueError, OSError) as broken:
            progress, error = {}, error or str(broken)
        return {"state": state, "error": error, **progress}

    def _last_words(self) -> str:
        """Returns why a process is gone that has said nothing, as far as that is known."""
        try:
            with (self.folder / _LOG).open("rb") as log:
                log.seek(max(0, log.seek(0, io.SEEK_END) - _LAST))
                lines = log.read().decode(errors="replace").split("\n")
        except OSError:
            lines = []
        said = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return f"its process was killed{': ' + said if said else ''}"

    @property
    def _stop_file(self) -> Path:
        return self.folder / STOP

    def _is_locked(self) -> bool:
        if not (self.folder / LOCK).exists():
            return False
        lock = FileLock(self.folder / LOCK)
        with _PROBING:
            try:
                lock.acquire(timeout=0)
            except Timeout:
                return True
            except (OSError, NotImplementedError):  # no locks here, or a folder that cannot be written
                return False
            lock.release()
        return False
