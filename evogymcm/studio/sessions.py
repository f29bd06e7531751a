"""Designs that are open: one session each, whatever tabs show it; a thread saves them soon after each change."""

import logging
import os
import threading
from collections.abc import Callable, Sequence

from evogymcm.studio.comparing import Pair
from evogymcm.studio.runs import Runs
from evogymcm.studio.store import TERRAIN, Design, Store, check_policy
from evogymcm.studio.watching import Wanted, Watch

_logger = logging.getLogger("evogymcm")
_PAUSE = 0.3  # seconds from a change to its saving, so that a stroke is saved once
_RETRY = 5.0  # seconds until a design that could not be saved is tried again


class Session:
    """An open design.

    Attributes:
        id: Its id in the store.
        design: What is drawn.
        version: Counts changes.
        unsaved: Why its last change could not be saved, None where it could.
        lock: Held by whoever changes or reads the design.
        watch: Its robot, once `show` was called.
    """

    def __init__(self, id: str, design: Design, store: Store, runs: Runs, wake: Callable[[], None]) -> None:
        self.id, self.design = id, design
        self.version = self.saved = 0
        self.unsaved: str | None = None
        self.lock = threading.RLock()
        self.watch = Watch()
        self._store, self._runs, self._wake = store, runs, wake
        self._looked: object = None  # of which version and policy the robot is shown

    @property
    def is_saved(self) -> bool:
        """Whether the folder holds the design as it is now."""
        return self.saved == self.version

    def changed(self) -> None:
        """Says that the design was changed: it is saved soon, and shown wherever it is open."""
        with self.lock:
            self.version += 1
        self._wake()
        self.show()

    def wanted(self, *, with_policy: bool = True) -> Wanted:
        """Returns what is to be seen of the design.

        Args:
            with_policy: Whether its policy has to be there; otherwise it is a sine gait.

        Raises:
            ValueError: It is no body, its terrain no world with room for it, or its policy not there.
            OSError: The terrain cannot be written to its file.
        """
        with self.lock:
            design, drawing = self.design, self.design.drawing
            problem = drawing.problem()
            if problem is not None:
                raise ValueError(problem)
            task = self._store.task(self.id, design, drawing.shape)
            world = design.terrain.text if design.task == TERRAIN else ""
            record = drawing.record()
            shown = (record["body"], record["stiffness"])
            policy, version = self._runs.policy(design.policy) if with_policy else ("sine", 0)
            return Wanted(task, world, design.material, policy, version, *shown)

    def show(self) -> str | None:
        """Lets the robot be as it is drawn; returns in words why it cannot, None where it can.

        Where it cannot, the last robot that could goes on.
        """
        try:
            look = self.version, self._runs.policy(self.design.policy)
            if look != self._looked:  # it is asked for often, and seldom has anything changed
                self.watch.want(self.wanted())
                self._looked = look
        except (ValueError, OSError) as error:
            self._looked = None
            return str(error)
        return None

    def drive(self, policy: str) -> None:
        """Lets something else move the robot, see `check_policy`; ValueError where it is nothing that can."""
        policy = check_policy(policy)
        with self.lock:
            self.design.policy = policy
        self.changed()

    def save(self) -> bool:
        """Writes the design if it was changed, and returns whether that worked."""
        with self.lock:
            version, record = self.version, self.design.record()
        if version == self.saved:
            return True
        try:
            self._store.save(self.id, record)
        except OSError as error:
            self.unsaved = error.strerror or str(error)
            return False
        self.saved, self.unsaved = version, None
        return True


class Studio:
    """A folder of designs and the sessions of those that are open.

    Args:
        store: The folder.
        given: Runs elsewhere whose policies may be used too, see `Runs`.
    """

    def __init__(self, store: Store, given: Sequence[str | os.PathLike[str]] = ()) -> None:
        self.store, self.runs = store, Runs(store, given)
        self._sessions: dict[str, Session] = {}
        self._pairs: dict[tuple[str, str], Pair] = {}
        self._lock = threading.Lock()
        self._is_due, self._is_closed = threading.Event(), threading.Event()
        self._saver = threading.Thread(target=self._save_on, name="studio-saver", daemon=True)
        self._saver.start()

    def open(self, id: str) -> Session:
        """Returns the session of a design.

        Raises:
            ValueError: There is no such design, or it cannot be read.
        """
        with self._lock:
            if id not in self._sessions:
                self._sessions[id] = Session(id, self.store.load(id), self.store, self.runs, self._is_due.set)
            return self._sessions[id]

    def pair(self, one: str, other: str) -> Pair:
        """Returns two designs side by side; ValueError as `open`."""
        sessions = (self.open(one), self.open(other))
        with self._lock:
            if (one, other) not in self._pairs:
                self._pairs[one, other] = Pair(sessions)
            return self._pairs[one, other]

    def sessions(self) -> list[Session]:
        """Returns the sessions."""
        with self._lock:
            return list(self._sessions.values())

    def delete(self, id: str) -> None:
        """Closes a design and moves it to the folder's "deleted"."""
        with self._lock:
            session = self._sessions.pop(id, None)
        if session is not None:
            session.save()
            session.watch.close()
        self.runs.check_idle(id)
        self.store.delete(id)

    def save(self) -> bool:
        """Saves all changes, and returns whether all could be saved."""
        saved = [session.save() for session in self.sessions()]
        return all(saved)

    def close(self) -> None:
        """Saves all changes and ends the saving."""
        self._is_closed.set()
        self._is_due.set()
        self._saver.join(10)
        for session in self.sessions():
            session.watch.close()
        for pair in self._pairs.values():
            pair.close()
        if not self.save():
            _logger.warning("some designs could not be saved")

    def _save_on(self) -> None:
        while not self._is_closed.is_set():
            self._is_due.wait(_RETRY)
            self._is_closed.wait(_PAUSE)
            self._is_due.clear()
            for session in self.sessions():
                session.save()
