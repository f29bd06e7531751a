"""The header: the design's name, whether it is kept, other designs, sharing and files."""

import json
from collections.abc import Callable
from urllib.parse import urlencode

from nicegui import events, ui

from evogymcm.body import robots
from evogymcm.studio.drawing import Drawing
from evogymcm.studio.page.theme import ICON, icon_button
from evogymcm.studio.sessions import Session, Studio
from evogymcm.studio.store import LARGEST_FILE, Design

BIPED = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"


class Header:
    """The header of a design's page.

    Args:
        studio: All designs.
        session: The design.
        refresh: Shows a change everywhere on the page.
    """

    def __init__(self, studio: Studio, session: Session, refresh: Callable[[], None]) -> None:
        self._studio, self._session, self._refresh_page = studio, session, refresh
        with ui.header(elevated=False).classes("studio-header items-center no-wrap gap-2"):
            with (
                ui.link(target="/designs")
                .classes("row items-center no-wrap gap-2 no-underline")
                .style("color: inherit")
            ):
                ui.html(ICON, sanitize=False).style("width: 26px; height: 26px")
                ui.html("<span>evogymcm studio</span>", sanitize=False).classes("studio-logo")
            self._name = ui.input(value=session.design.name).props('dense borderless aria-label="name of the design"')
            self._name.classes("studio-name").mark("name").on("change", self._rename)
            self._saved = ui.label().classes("studio-saved ellipsis").mark("saved")
            ui.space()
            icon_button("add", "New design", lambda: new_dialog(studio).open(), marker="new")
            icon_button("folder_open", "All designs", lambda: ui.navigate.to("/designs"), marker="designs")
            icon_button("share", "Share", self._share, marker="share")
        self.tick()

    def _rename(self) -> None:
        try:
            with self._session.lock:
                self._session.design.rename(self._name.value)
        except ValueError as error:
            ui.notify(str(error), type="warning")
        self._session.changed()
        self._refresh_page()

    def _share(self) -> None:
        design = self._session.design
        with ui.dialog(value=True) as dialog, ui.card().classes("studio-card").style("max-width: 520px"):
            ui.label("Share this design").classes("studio-title")
            link = "/open?" + urlencode({"design": json.dumps(design.record(), separators=(",", ":"))})
            field = ui.input("Link, for anyone who runs a studio on this port").props("readonly dense outlined")
            field.classes("w-full studio-mono").mark("link")
            ui.run_javascript("return location.origin")
            field.value = link
            text = (
                ui.textarea("Text", value=json.dumps(design.record()))
                .props("readonly outlined dense")
                .classes("w-full studio-mono")
            )
            text.mark("share-text")
            with ui.row().classes("w-full justify-end"):
                ui.button("File", icon="download", on_click=self._download).props("flat no-caps")
                ui.button("Close", on_click=dialog.close).props("flat no-caps")

    def _download(self) -> None:
        record = json.dumps(self._session.design.record(), indent=1)
        ui.download.content(record.encode(), f"{self._session.id}.json", "application/json")

    def refresh(self) -> None:
        """Shows the name as it is."""
        self._name.value = self._session.design.name

    def tick(self) -> None:
        """Shows whether the design is kept."""
        session = self._session
        if session.unsaved is not None:
            self._saved.set_text(f"NOT SAVED: {session.unsaved}. Keep this page open; it is tried again.")
            self._saved.classes(add="text-negative")
        else:
            self._saved.set_text("saved" if session.is_saved else "saving …")
            self._saved.classes(remove="text-negative")


def new_dialog(studio: Studio) -> ui.dialog:
    """Returns a dialog that makes a new design: drawn anew, of a robot, of a text or of a file."""

    def make(design: Design) -> None:
        try:
            ui.navigate.to(f"/d/{studio.store.add(design)}")
        except OSError as error:
            ui.notify(f"It cannot be kept: {error.strerror}", type="negative")

    def read(text: str) -> None:
        try:
            make(Design.read(text))
        except ValueError as error:
            ui.notify(str(error), type="warning", multi_line=True)

    async def upload(event: events.UploadEventArguments) -> None:
        try:
            read(await event.file.text())
        except UnicodeDecodeError:
            ui.notify("This file is no text.", type="warning")

    with ui.dialog() as dialog, ui.card().classes("studio-card").style("max-width: 440px"):
        ui.label("New design").classes("studio-title")
        with ui.element("div").classes("studio-bar"):
            ui.button("Empty grid", icon="grid_on", on_click=lambda: make(Design())).props("outline no-caps").mark(
                "new-empty"
            )
            biped = Design("Biped", drawing=Drawing.of(BIPED))
            ui.button("Biped", icon="directions_walk", on_click=lambda: make(biped)).props("outline no-caps")
        chosen = ui.select(list(robots), label="A robot of the paper", on_change=lambda event: read(str(event.value)))
        chosen.props("dense outlined options-dense").classes("w-full")
        text = (
            ui.textarea("A body or design as text", placeholder="HHH/V.V")
            .props("outlined dense")
            .classes("w-full studio-mono")
        )
        ui.button("Make it", on_click=lambda: read(text.value or "")).props("flat no-caps")
        drop = ui.upload(
            label="… or a file", on_upload=upload, auto_upload=True, max_file_size=LARGEST_FILE, max_files=1
        )
        drop.props('flat bordered accept=".json,.txt"').classes("w-full")
    return dialog
