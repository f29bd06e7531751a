"""The studio's pages."""

from nicegui import app, ui
from starlette.websockets import WebSocket

from evogymcm.studio.page.compare import ComparePage
from evogymcm.studio.page.draw import DrawPanel
from evogymcm.studio.page.keep import Header, home
from evogymcm.studio.page.learn import LearnPanel
from evogymcm.studio.page.scene import stream
from evogymcm.studio.page.start import design_list, first_design, new_dialog, shared_design
from evogymcm.studio.page.theme import dress, icon_button
from evogymcm.studio.page.watch import WatchPanel
from evogymcm.studio.sessions import Session, Studio

_LOOK = 0.1  # seconds between looks at what other tabs and threads have done
_TITLE = "evogymcm studio"


def register(studio: Studio) -> None:
    """Makes the pages of a studio in NiceGUI's app."""

    @ui.page("/", title=_TITLE)
    def first() -> None:
        entries = studio.store.entries()
        ui.navigate.to(f"/d/{entries[0].id if entries else studio.store.add(first_design())}")

    @ui.page("/d/{id}", title=_TITLE)
    def design(id: str) -> None:
        try:
            session = studio.open(id)
        except ValueError as error:
            with _frame(studio), ui.element("section").classes("studio-card studio-span"):
                ui.label(str(error))
            return
        DesignPage(studio, session)

    @ui.page("/designs", title=f"{_TITLE}: designs")
    def designs() -> None:
        with _frame(studio), ui.element("div").classes("studio-span"):
            design_list(studio)

    @ui.page("/open", title=_TITLE)
    def shared(design: str = "") -> None:
        with _frame(studio), ui.element("section").classes("studio-card studio-span"):
            shared_design(studio, design)

    @ui.page("/compare/{one}/{other}", title=f"{_TITLE}: two designs")
    def compare(one: str, other: str) -> None:
        try:
            pair = studio.pair(one, other)
        except ValueError as error:
            with _frame(studio), ui.element("section").classes("studio-card studio-span"):
                ui.label(str(error))
            return
        _header(studio)
        ComparePage(pair)

    @app.websocket("/live/{id}")
    async def live(socket: WebSocket, id: str) -> None:
        try:
            watch = studio.open(id).watch
        except ValueError:
            await socket.close(1008)
            return
        await stream(socket, watch)

    @app.websocket("/pair/{one}/{other}/{side}")
    async def live_pair(socket: WebSocket, one: str, other: str, side: int) -> None:
        try:
            watch = studio.pair(one, other).watches[1 if side else 0]
        except ValueError:
            await socket.close(1008)
            return
        await stream(socket, watch)


def _header(studio: Studio) -> None:
    dress()
    with ui.header(elevated=False).classes("studio-header items-center no-wrap gap-2"):
        home()
        ui.space()
        icon_button("add", "New design", lambda: new_dialog(studio), marker="new")
        icon_button("folder_open", "All designs", lambda: ui.navigate.to("/designs"))


def _frame(studio: Studio) -> ui.element:
    """Returns the main part of a page that shows no design."""
    _header(studio)
    return ui.element("main").classes("studio-main")


class DesignPage:
    """The page of a design in one tab: it shows the session, which all tabs share.

    Args:
        studio: All designs.
        session: The design.
    """

    def __init__(self, studio: Studio, session: Session) -> None:
        self._session, self._shown = session, session.version
        session.show()
        dress()
        self._header = Header(studio, session, self._refresh)
        with ui.element("main").classes("studio-main"):
            self._draw = DrawPanel(session, self._refresh)
            with ui.element("div").classes("studio-side"):
                self._watch = WatchPanel(studio.runs, session, self._refresh)
                LearnPanel(studio.runs, session, self._refresh)
        ui.timer(_LOOK, self._tick)

    def _refresh(self) -> None:
        self._shown = self._session.version
        for part in (self._header, self._draw, self._watch):
            part.refresh()

    def _tick(self) -> None:
        if self._session.version != self._shown:
            self._refresh()
        for part in (self._header, self._watch):
            part.tick()


__all__ = ["register"]
