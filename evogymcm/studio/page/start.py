"""How designs begin and are found: the list, new ones, and those that somebody shares."""

import time
from functools import partial

from nicegui import events, ui

from evogymcm.algos.learning.bodies import STANDARD_BODY
from evogymcm.body import robots
from evogymcm.studio.drawing import Drawing
from evogymcm.studio.page.theme import icon_button, thumbnail
from evogymcm.studio.sessions import Studio
from evogymcm.studio.store import LARGEST_FILE, Design, Entry


def first_design() -> Design:
    """Returns what a new user sees first: a body that walks."""
    return Design("My first robot", drawing=Drawing.of(STANDARD_BODY))


def keep(studio: Studio, design: Design) -> None:
    """Keeps a new design, and opens it."""
    try:
        ui.navigate.to(f"/d/{studio.store.add(design)}")
    except OSError as error:
        ui.notify(f"It cannot be kept: {error.strerror}", type="negative")


def new_dialog(studio: Studio) -> None:
    """Opens a dialog that makes a new design: drawn anew, of a robot, of a text or of a file."""

    def read(given: str) -> None:
        try:
            keep(studio, Design.read(given))
        except ValueError as error:
            ui.notify(str(error), type="warning", multi_line=True)

    async def upload(event: events.UploadEventArguments) -> None:
        try:
            keep(studio, Design.read_file(event.file.name, await event.file.read()))
        except ValueError as error:
            ui.notify(str(error), type="warning", multi_line=True)

    with ui.dialog(value=True), ui.card().classes("studio-card studio-dialog"):
        ui.label("New design").classes("studio-title")
        with ui.element("div").classes("studio-bar"):
            for label, icon, design in (
                ("Empty grid", "grid_on", Design()),
                ("Biped", "directions_walk", Design("Biped", drawing=Drawing.of(STANDARD_BODY))),
            ):
                ui.button(label, icon=icon, on_click=partial(keep, studio, design)).props("outline no-caps")
        chosen = ui.select(list(robots), label="A robot of the paper", on_change=lambda event: read(str(event.value)))
        chosen.props("dense outlined options-dense").classes("w-full")
        with ui.row().classes("w-full items-center no-wrap gap-1"):
            text = ui.input("A body or design as text", placeholder="HHH/V.V").props("outlined dense")
            text.classes("studio-grow studio-mono").mark("new-text")
            icon_button("arrow_forward", "Make it", lambda: read(text.value or ""), marker="make")
        drop = ui.upload(
            label="A design or body as a file", on_upload=upload, auto_upload=True, max_file_size=LARGEST_FILE
        )
        drop.props('flat bordered accept=".json,.txt,.npz,.npy"').classes("w-full studio-drop")


def design_list(studio: Studio) -> None:
    """Shows all designs."""

    def forget(entry: Entry) -> None:
        with ui.dialog(value=True) as dialog, ui.card().classes("studio-card studio-dialog"):
            ui.label(f"Put {entry.name} away?").classes("studio-title")
            ui.label("Its files and runs move to the folder “deleted”, where you can take them from.")
            with ui.row().classes("w-full justify-end"):
                ui.button("Keep it", on_click=dialog.close).props("flat no-caps")
                ui.button("Put away", on_click=lambda: away(entry)).props("flat no-caps color=negative")

    def away(entry: Entry) -> None:
        try:
            studio.delete(entry.id)
        except (ValueError, OSError) as error:
            ui.notify(str(error), type="negative")
            return
        ui.navigate.to("/designs")

    with ui.element("div").classes("studio-gallery"):
        for entry in studio.store.entries():
            with ui.element("div").classes("studio-card studio-tile"):
                with ui.link(target=f"/d/{entry.id}").classes("studio-thumb"):
                    ui.html(thumbnail(entry.drawing), sanitize=False)
                with ui.row().classes("w-full items-center no-wrap"):
                    with ui.column().classes("gap-0 studio-grow"):
                        ui.link(entry.name, f"/d/{entry.id}").classes("studio-title ellipsis")
                        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(entry.changed))
                        ui.label(when).classes("studio-small")
                    icon_button("delete_outline", f"Put {entry.id} away", partial(forget, entry))


def shared_design(studio: Studio, text: str) -> None:
    """Shows a design that somebody shares, and keeps it where that is wished."""
    try:
        design = Design.read(text)
    except ValueError as error:
        ui.label(f"This link holds no design: {error}")
        return
    ui.label(design.name).classes("studio-title")
    ui.html(thumbnail(design.drawing), sanitize=False).classes("studio-thumb")
    ui.label(design.drawing.problem() or f"{design.drawing.summary()}, for {design.task}").classes("studio-small")
    ui.button("Keep it and open", on_click=lambda: keep(studio, design)).props("no-caps unelevated").mark("keep")
