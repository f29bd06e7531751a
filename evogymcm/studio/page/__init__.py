"""The studio's pages."""

from nicegui import app, ui
from starlette.websockets import WebSocket

from evogymcm.studio.drawing import Drawing
from evogymcm.studio.page.draw import DrawPanel
from evogymcm.studio.page.keep import BIPED, Header, new_dialog
from evogymcm.studio.page.scene import stream
from evogymcm.studio.page.theme import dress
from evogymcm.studio.page.watch import WatchPanel
from evogymcm.studio.sessions import Session, Studio
from evogymcm.studio.store import Design

_LOOK = 0.1  # seconds between looks at what other tabs and threads have done


def register(studio: Studio) -> None:
    """Makes the pages of a studio in NiceGUI's app."""

    @ui.page("/", title="evogymcm studio")
    def first() -> None:
        entries = studio.store.entries()
        id = entries[0].id if entries else studio.store.add(Design("My first robot", drawing=Drawing.of(BIPED)))
        ui.navigate.to(f"/d/{id}")

    @ui.page("/d/{id}", title="evogymcm studio")
    def design(id: str) -> None:
        try:
            session = studio.open(id)
        except ValueError as error:
            lost(studio, str(error))
            return
        DesignPage(studio, session)

    @ui.page("/designs", title="evogymcm studio: designs")
    def designs() -> None:
        dress()
        with ui.element("main").classes("studio-main"), ui.element("section").classes("studio-card"):
            ui.label("Designs").classes("studio-title")
            for entry in studio.store.entries():
                ui.link(entry.name, f"/d/{entry.id}")
            ui.button("New", icon="add", on_click=lambda: new_dialog(studio).open()).props("flat no-caps")

    @app.websocket("/live/{id}")
    async def live(socket: WebSocket, id: str) -> None:
        try:
            session = studio.open(id)
        except ValueError:
            await socket.close(1008)
            return
        await stream(socket, session)


def lost(studio: Studio, why: str) -> None:
    """Shows that there is no such design."""
    dress()
    with ui.element("main").classes("studio-main"), ui.element("section").classes("studio-card"):
        ui.label(why)
        ui.link("All designs", "/designs")


class DesignPage:
    """The page of a design in one tab: it shows the session, which all tabs share.

    Args:
        studio: All designs.
        session: The design.
    """

    def __init__(self, studio: Studio, session: Session) -> None:
        self._session, self._shown = session, -1
        session.show()
        dress()
        self._header = Header(studio, session, self._refresh)
        with ui.element("main").classes("studio-main"):
            self._draw = DrawPanel(session, self._refresh)
            with ui.element("div").classes("studio-side"):
                self._watch = WatchPanel(session, self._refresh)
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
