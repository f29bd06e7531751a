"""The robot of an open design: its player, kept up to date by a thread, so that no page waits for the simulator."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # it loads numba
    from evogymcm.studio.player import Player

_logger = logging.getLogger("evogymcm")


@dataclass(frozen=True)
class Wanted:
    """What is to be seen.

    Attributes:
        task: Id of a task, or the file of a world.
        world: The world's picture where it is a file, so that its change is noticed.
        material: "invariant" or "reactive".
        policy: What moves the robot, see `Player`.
        version: Of that policy: counts up where the file has another content.
        body: The body as text.
        stiffness: Its field as text, None for 1.
    """

    task: str
    world: str
    material: str
    policy: str
    version: int
    body: str
    stiffness: str | None


class Watch:
    """Makes the player that is wanted, and changes it as the wish changes; only the latest wish counts.

    Attributes:
        player: The player, None before there is one.
        problem: Why what is wanted cannot be seen, None where it can.
    """

    def __init__(self) -> None:
        self.player: Player | None = None
        self.problem: str | None = None
        self._wanted: Wanted | None = None
        self._shown: Wanted | None = None
        self._speed, self._plays, self._viewers = 50.0, True, 0
        self._change = threading.Condition()
        self._thread: threading.Thread | None = None
        self._is_closed = False

    @property
    def is_busy(self) -> bool:
        """Whether the latest wish is not fulfilled yet."""
        return self._wanted is not self._shown

    @property
    def speed(self) -> float:
        """Env-steps a second."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._speed = speed
        if self.player is not None:
            self.player.speed = speed

    @property
    def plays(self) -> bool:
        """Whether the robot moves by itself while somebody looks on."""
        return self._plays

    @plays.setter
    def plays(self, plays: bool) -> None:
        self._plays = plays
        self._start_or_stop()

    @property
    def is_viewed(self) -> bool:
        """Whether somebody looks on."""
        return self._viewers > 0

    @contextmanager
    def viewed(self) -> Iterator[None]:
        """Says that somebody looks on; without anybody the robot stands still."""
        self._viewers += 1
        self._start_or_stop()
        try:
            yield
        finally:
            self._viewers -= 1
            self._start_or_stop()

    def _start_or_stop(self) -> None:
        player = self.player
        if player is None:
            return
        with suppress(RuntimeError):  # it has just been closed
            if self._plays and self._viewers:
                player.play()
            else:
                player.pause()

    def want(self, wanted: Wanted) -> None:
        """Says what is to be seen from now on."""
        with self._change:
            if wanted == self._wanted or self._is_closed:
                return
            self._wanted = wanted
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="studio-watch", daemon=True)
                self._thread.start()
            self._change.notify()

    def close(self) -> None:
        """Ends the player and the thread; it does not wait for them."""
        with self._change:
            self._is_closed = True
            self._change.notify()

    def _run(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._is_closed or self._wanted is not self._shown)
                wanted = self._wanted
            if self._is_closed:
                break
            assert wanted is not None
            try:
                self._fulfil(wanted)
                self.problem = None
            except (ValueError, OSError, RuntimeError) as error:
                self.problem = str(error)
            except Exception as error:  # the thread has to live on: the next wish may work
                _logger.exception("studio: the robot cannot be shown")
                self.problem = f"{type(error).__name__}: {error}"
            self._shown = wanted
        if self.player is not None:
            self.player.close()

    def _fulfil(self, wanted: Wanted) -> None:
        from evogymcm.studio.player import Player

        was, player = self._shown, self.player
        field = read_field(wanted)
        place = ("task", "world", "material")
        if player is not None and was is not None and self.problem is None and _alike(was, wanted, place):
            if not _alike(was, wanted, ("policy", "version")):
                player.use(wanted.policy)
            if not _alike(was, wanted, ("body", "stiffness")):
                player.update(wanted.body, field)
            return
        new = Player(wanted.body, field, wanted.task, wanted.material, wanted.policy, speed=self._speed)
        self.player = new
        self._start_or_stop()
        if player is not None:
            with suppress(RuntimeError):
                player.close()


def _alike(one: Wanted, other: Wanted, names: tuple[str, ...]) -> bool:
    return all(getattr(one, name) == getattr(other, name) for name in names)


def read_field(wanted: Wanted) -> Any:
    """Returns the field of what is wanted as `Player` takes it."""
    if wanted.stiffness is None or wanted.material == "reactive":
        return None
    return [[float(number) for number in row.split(",")] for row in wanted.stiffness.split("/")]
