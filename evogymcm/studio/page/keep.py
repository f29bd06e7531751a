"""The header of a design's page: its name, whether it is kept, sharing, files and videos."""

import io
import json
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
from nicegui import run, ui

from evogymcm.studio.exports import film, zip_sheet
from evogymcm.studio.page.start import new_dialog
from evogymcm.studio.page.theme import ICON, icon_button
from evogymcm.studio.sessions import Session, Studio

_VIDEO_STEPS = 250


class Header:
    """The header.

    Args:
        studio: All designs.
        session: The design.
        refresh: Shows a change everywhere on the page.
    """

    def __init__(self, studio: Studio, session: Session, refresh: Callable[[], None]) -> None:
        self._studio, self._session, self._refresh_page = studio, session, refresh
        with ui.header(elevated=False).classes("studio-header items-center no-wrap gap-2"):
            home()
            self._name = ui.input(value=session.design.name).props('dense borderless aria-label="name of the design"')
            self._name.classes("studio-name").mark("name").on("change", self._rename)
            self._kept = ui.icon("cloud_done").classes("studio-kept")
            self._saved = ui.label().classes("studio-saved").mark("saved")
            ui.space()
            icon_button("add", "New design", lambda: new_dialog(studio), marker="new")
            icon_button("folder_open", "All designs", lambda: ui.navigate.to("/designs"), marker="designs")
            icon_button("compare", "Compare with another design", self._choose_other, marker="compare")
            icon_button("share", "Share", self._share, marker="share")
            with icon_button("download", "Files and videos", lambda: None, marker="export"), ui.menu():
                self._make_exports()
        self._alarm = ui.label().classes("studio-alarm").props("role=alert").mark("alarm")
        self.tick()

    def _make_exports(self) -> None:
        for text, handle in (
            ("Design (.json)", self._download_design),
            ("Body for EvoGym (.npz)", self._download_body),
            ("Body as text (.txt)", self._download_text),
            ("Sheet for fabrication (.zip)", self._choose_sheet),
        ):
            ui.menu_item(text, handle)
        ui.separator()
        for suffix in (".gif", ".mp4"):
            for view in ("types", "stiffness"):
                ui.menu_item(f"Video of {view} ({suffix})", partial(self._film, suffix, view))

    def _rename(self) -> None:
        try:
            with self._session.lock:
                self._session.design.rename(self._name.value)
        except ValueError as error:
            ui.notify(str(error), type="warning")
        self._session.changed()
        self._refresh_page()

    def _choose_other(self) -> None:
        others = {entry.id: entry.name for entry in self._studio.store.entries() if entry.id != self._session.id}
        with ui.dialog(value=True), ui.card().classes("studio-card studio-dialog"):
            ui.label("Compare with").classes("studio-title")
            if not others:
                ui.label("There is no other design yet.").classes("studio-small")
                return
            other = ui.select(others, label="Design", on_change=lambda event: self._compare(str(event.value)))
            other.props("dense outlined options-dense").classes("w-full").mark("other")

    def _compare(self, other: str) -> None:
        ui.navigate.to(f"/compare/{self._session.id}/{other}")

    def _share(self) -> None:
        text = self.text()
        request = ui.context.client.request
        base = str(request.base_url).rstrip("/") if request is not None else ""
        link = f"{base}/open?" + urlencode({"design": text})
        with ui.dialog(value=True) as dialog, ui.card().classes("studio-card studio-dialog"):
            ui.label("Share this design").classes("studio-title")
            for label, value, marker in (
                ("Link, for a studio on the same port", link, "link"),
                ("Text, for “New design”", text, "share-text"),
            ):
                with ui.row().classes("w-full items-center no-wrap gap-1"):
                    field = ui.input(label, value=value).props("readonly dense outlined")
                    field.classes("studio-mono studio-grow").mark(marker)
                    icon_button("content_copy", f"Copy {label.split(',')[0].lower()}", partial(_copy, value))
            with ui.row().classes("w-full justify-end"):
                ui.button("Close", on_click=dialog.close).props("flat no-caps")

    def text(self) -> str:
        """Returns the design as one line of text."""
        with self._session.lock:
            record = self._session.design.record()
        if "/" in record["policy"]:
            del record["policy"]  # runs stay where they are
        return json.dumps(record, separators=(",", ":"), ensure_ascii=False)

    def _download_design(self) -> None:
        record = json.dumps(self._session.design.record(), indent=1, ensure_ascii=False)
        ui.download.content(record.encode(), f"{self._session.id}.json", "application/json")

    def _download_text(self) -> None:
        text = self._session.design.drawing.text.replace("/", "\n") + "\n"
        ui.download.content(text.encode(), f"{self._session.id}.txt", "text/plain")

    def _download_body(self) -> None:
        try:
            body = self._session.design.drawing.body()
        except ValueError as error:
            ui.notify(str(error), type="warning")
            return
        file = io.BytesIO()
        np.savez(file, body.grid, body.connections)
        ui.download.content(file.getvalue(), f"{self._session.id}.npz", "application/octet-stream")

    def _choose_sheet(self) -> None:
        with ui.dialog(value=True), ui.card().classes("studio-card studio-dialog"):
            ui.label("Sheet for fabrication").classes("studio-title")
            ui.label("A drawing in true size, a table of the voxels, and a mesh for each material.").classes(
                "studio-small"
            )
            with ui.element("div").classes("studio-bar"):
                size = ui.number("Edge of a voxel, mm", value=10, min=0.1, step=1).props("dense outlined").mark("edge")
                classes = ui.number("Classes of stiffness", value=5, min=1, step=1, precision=0)
                classes.props("dense outlined").mark("classes")

                async def make() -> None:
                    await self._download_sheet(float(size.value or 0), int(classes.value or 0))

                ui.button("Make it", icon="download", on_click=make).props("unelevated no-caps").mark("sheet")

    async def _download_sheet(self, size: float, classes: int) -> None:
        try:
            with self._session.lock:
                drawing = self._session.design.drawing
                body, field = drawing.body(), drawing.stiffness
            content = await run.io_bound(zip_sheet, body, field, size=size, classes=classes)
        except (ValueError, OSError, ImportError) as error:
            ui.notify(str(error), type="warning", multi_line=True)
            return
        ui.download.content(content or b"", f"{self._session.id}-sheet.zip", "application/zip")

    async def _film(self, suffix: str, view: str) -> None:
        """Makes a video of the robot as it moves now, beside the page."""
        note = ui.notification("Making the video …", spinner=True, timeout=None)
        try:
            wanted = self._session.wanted()
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"{self._session.id}{suffix}"
                await run.io_bound(film, wanted, path, steps=_VIDEO_STEPS, view=view)
                content = path.read_bytes()
        except (ValueError, OSError, ImportError) as error:
            note.dismiss()
            ui.notify(str(error), type="warning", multi_line=True)
            return
        note.dismiss()
        ui.download.content(content, f"{self._session.id}{suffix}")

    def refresh(self) -> None:
        """Shows the name as it is."""
        self._name.value = self._session.design.name

    def tick(self) -> None:
        """Shows whether the design is kept."""
        session = self._session
        state = "not saved" if session.unsaved is not None else "saved" if session.is_saved else "saving …"
        self._saved.set_text(state)
        self._kept.set_name({"saved": "cloud_done", "saving …": "sync"}.get(state, "cloud_off"))
        self._alarm.set_visibility(session.unsaved is not None)
        if session.unsaved is not None:
            self._alarm.set_text(f"NOT SAVED: {session.unsaved}. Keep this page open: it is tried again.")


def home() -> None:
    """Shows what the page is, and leads to all designs."""
    with ui.link(target="/designs").classes("studio-home"):
        ui.html(ICON, sanitize=False).classes("studio-icon")
        ui.label("evogymcm studio").classes("studio-logo")


def _copy(text: str) -> None:
    ui.clipboard.write(text)
    ui.notify("copied", type="positive")
