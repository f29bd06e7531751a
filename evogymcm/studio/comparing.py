"""Two designs side by side, moved by one clock, so that they are in step."""

from typing import TYPE_CHECKING

from evogymcm.studio.clock import Clock
from evogymcm.studio.watching import Watch

if TYPE_CHECKING:
    from evogymcm.studio.sessions import Session


class Pair:
    """The robots of two open designs, apart from those that their own pages show.

    Args:
        sessions: The designs.

    Attributes:
        watches: Their robots, once `follow` was called.
    """

    def __init__(self, sessions: "tuple[Session, Session]") -> None:
        self.sessions = sessions
        self.watches = (Watch(), Watch())
        for watch in self.watches:
            watch.plays = False
        self._clock = Clock(self.step, 50.0)

    @property
    def plays(self) -> bool:
        """Whether they move by themselves."""
        return self._clock.runs

    @property
    def speed(self) -> float:
        """Env-steps a second."""
        return self._clock.rate

    @speed.setter
    def speed(self, speed: float) -> None:
        self._clock.rate = speed

    def follow(self) -> list[str | None]:
        """Lets both be as they are drawn now; returns in words why one cannot be."""
        problems = []
        for session, watch in zip(self.sessions, self.watches, strict=True):
            try:
                watch.want(session.wanted())
                problems.append(watch.problem)
            except (ValueError, OSError) as error:
                problems.append(str(error))
        return problems

    def step(self) -> None:
        """Makes one env-step of both while somebody looks on; one whose episode has ended waits for the other."""
        first, second = (watch.player for watch in self.watches)
        if first is None or second is None or not any(watch.is_viewed for watch in self.watches):
            return
        if first.has_ended and second.has_ended:
            self.reset()
            return
        for player in (first, second):
            if not player.has_ended:
                player.step()

    def play(self) -> None:
        """Lets them move by themselves."""
        self._clock.start()

    def pause(self) -> None:
        """Lets them stand."""
        self._clock.stop()

    def reset(self) -> None:
        """Begins an episode of both, with the same draws."""
        for watch in self.watches:
            if watch.player is not None:
                watch.player.reset(0)

    def close(self) -> None:
        """Ends both."""
        self._clock.close()
        for watch in self.watches:
            watch.close()
