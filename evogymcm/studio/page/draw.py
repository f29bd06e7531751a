"""The panel where a design is drawn: its voxels, their stiffness, and a terrain of its own."""

import secrets
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from evogymcm._grid import CELL_CHARS, EMPTY, FIXED, H_ACT, RIGID, SOFT, V_ACT
from evogymcm.body import STIFFNESS_HIGH, STIFFNESS_LOW, robots
from evogymcm.envs.render import palette
from evogymcm.sim import world_names
from evogymcm.studio.drawing import Drawing
from evogymcm.studio.page.grid import NAMES, GridCanvas, Stroke, hex_color
from evogymcm.studio.page.theme import SEGMENTS, Says, icon_button, stiffness_ramp, swatch_button
from evogymcm.studio.sessions import Session
from evogymcm.studio.sketch import Sketch
from evogymcm.studio.store import TERRAIN
from evogymcm.studio.terrain import Terrain

BODY, STIFFNESS, WORLD = "body", "stiffness", "world"
_TABS = {BODY: "Body", STIFFNESS: "Stiffness", WORLD: "Terrain"}
_BODY_BRUSHES = (RIGID, SOFT, H_ACT, V_ACT, EMPTY)
_WORLD_BRUSHES = (FIXED, RIGID, SOFT, EMPTY)
_LABEL = "grid of cells: arrows move, space draws, letters choose a brush"
_TOOLS = {"brush": ("brush", "Draw"), "fill": ("format_color_fill", "Fill"), "gradient": ("gradient", "Gradient")}


class DrawPanel:
    """The panel.

    Args:
        session: The design.
        refresh: Shows a change everywhere on the page.
    """

    def __init__(self, session: Session, refresh: Callable[[], None]) -> None:
        self._session, self._refresh_page = session, refresh
        self._tab, self._tool, self._value = BODY, "brush", STIFFNESS_HIGH
        self._held = {BODY: H_ACT, WORLD: FIXED}
        with ui.element("section").classes("studio-card").props('aria-label="Draw"'):
            tabs = ui.toggle(_TABS, value=BODY, on_change=lambda event: self._choose_tab(event.value))
            tabs.props(SEGMENTS + " spread").classes("studio-tabs").mark("tabs")
            self._make_brushes()
            self._make_tools()
            self._grid = GridCanvas(_LABEL, self._stroke, self._command)
            self._grid.mark("grid")
            self._says = Says("validity")
            self._make_texts()
        self._fill_start_menu()
        self.refresh()

    @property
    def _sketch(self) -> Drawing | Terrain:
        design = self._session.design
        return design.terrain if self._tab == WORLD else design.drawing

    def _make_brushes(self) -> None:
        self._brushes: dict[str, dict[int, ui.button]] = {}
        self._rows: dict[str, ui.element] = {}
        for tab, codes in ((BODY, _BODY_BRUSHES), (WORLD, _WORLD_BRUSHES)):
            with ui.element("div").classes("studio-brushes") as self._rows[tab]:
                self._brushes[tab] = {
                    code: swatch_button(code, NAMES[CELL_CHARS[code]], partial(self._hold, code)) for code in codes
                }
        with ui.column().classes("w-full gap-1") as self._rows[STIFFNESS]:
            with ui.row().classes("w-full items-center no-wrap gap-3"):
                slider = ui.slider(min=-1, max=1, step=0.05, value=1).classes("studio-grow").mark("stiffness-slider")
                self._number = ui.number(min=STIFFNESS_LOW, max=STIFFNESS_HIGH, step=0.1, value=self._value)
                self._number.props('dense outlined aria-label="stiffness of the brush"').classes("w-20")
                self._number.mark("stiffness")
            stiffness_ramp()
            with ui.row().classes("w-full justify-between studio-small"):
                for text in ("0.5 soft", "1", "2 stiff"):
                    ui.label(text)
        slider.on_value_change(lambda event: self._set_value(float(np.round(2.0 ** float(event.value), 2))))
        self._number.on_value_change(lambda event: self._set_value(event.value))
        self._slider = slider

    def _make_tools(self) -> None:
        with ui.element("div").classes("studio-bar"):
            self._tools = {
                name: icon_button(icon, what, partial(self._take, name), marker=f"tool-{name}")
                for name, (icon, what) in _TOOLS.items()
            }
            ui.separator().props("vertical inset")
            self._undo = icon_button("undo", "Undo (Ctrl+Z)", lambda: self._command("undo", {}))
            self._redo = icon_button("redo", "Redo (Ctrl+Y)", lambda: self._command("redo", {}))
            ui.separator().props("vertical inset")
            icon_button("swap_horiz", "Mirror left and right", lambda: self._do(lambda sketch: sketch.mirror()))
            icon_button("swap_vert", "Mirror top and bottom", lambda: self._do(lambda s: s.mirror(upside_down=True)))
            with icon_button("open_with", "Move (Shift+arrows)", lambda: None), ui.menu():
                for name, way in (("Up", (-1, 0)), ("Down", (1, 0)), ("Left", (0, -1)), ("Right", (0, 1))):
                    ui.menu_item(name, partial(self._shift, way), auto_close=False)
            ui.space()
            self._start_menu = icon_button("auto_awesome", "Start from …", lambda: None, marker="start-from")
            with self._start_menu, ui.menu():
                self._start_items = ui.column().classes("gap-0")

    def _make_texts(self) -> None:
        self._sizes: list[ui.number] = []
        with ui.row().classes("w-full items-start no-wrap gap-2"):
            self._text = ui.textarea("As text").props("dense outlined autogrow spellcheck=false")
            self._text.classes("studio-mono studio-grow").mark("text")
            self._text.on("change", lambda: self._write(self._text.value or ""))
            with ui.column().classes("gap-2 w-24"):
                for name in ("rows", "columns"):
                    size = ui.number(name, min=1, step=1, precision=0).props("dense outlined").classes("w-full")
                    size.on("change", self._resize).mark(name)
                    self._sizes.append(size)

    def _choose_tab(self, tab: str) -> None:
        self._tab = tab
        if self._tool == "gradient" and tab != STIFFNESS:
            self._tool = "brush"
        self._fill_start_menu()
        self.refresh()

    def _fill_start_menu(self) -> None:
        self._start_items.clear()
        with self._start_items:
            if self._tab == WORLD:
                ui.menu_item("Flat ground", lambda: self._do(lambda s: s.write(Terrain.flat().text)))
                ui.separator()
                for name in world_names():
                    ui.menu_item(name, partial(self._use_world, name))
                return
            ui.menu_item("Empty grid", lambda: self._do(lambda s: s.clear()))
            ui.menu_item("Random body", lambda: self._do(lambda s: s.randomize(np.random.default_rng(_seed()))))
            ui.menu_item("Mutate this body", lambda: self._do(self._mutate)).mark("mutate")
            ui.separator()
            for name in robots:
                ui.menu_item(name, partial(self._use_robot, name))

    def _shift(self, way: tuple[int, int]) -> None:
        self._do(lambda sketch: sketch.shift(*way))

    def _use_world(self, name: str) -> None:
        self._do(lambda terrain: terrain.write(Terrain.of(name).text))

    def _use_robot(self, name: str) -> None:
        self._do(lambda drawing: drawing.replace(robots[name]))

    @staticmethod
    def _mutate(drawing: Drawing) -> None:
        if not drawing.mutate(np.random.default_rng(_seed())):
            raise ValueError("No mutation of this body is a body; try again.")

    def _hold(self, code: int) -> None:
        if self._tab == STIFFNESS:
            return
        self._held[self._tab] = code
        self.refresh()

    def _take(self, tool: str) -> None:
        self._tool = tool
        self.refresh()

    def _set_value(self, value: float | None) -> None:
        if value is None or not STIFFNESS_LOW <= value <= STIFFNESS_HIGH or value == self._value:
            return
        self._value = float(value)
        self._number.value = self._value
        self._slider.value = float(np.log2(self._value))
        self._hold_tool()

    def _do(self, change: Callable[[Any], Any]) -> None:
        """Changes what is drawn, and says so where that does not go."""
        try:
            with self._session.lock:
                change(self._sketch)
        except ValueError as error:
            ui.notify(str(error), type="warning", multi_line=True)
        self._session.changed()
        self._refresh_page()

    def _stroke(self, stroke: Stroke) -> None:
        with self._session.lock:
            sketch = self._sketch
            if stroke.phase == "start":
                sketch.begin()
            for row, col in stroke.cells if stroke.phase != "end" else ():
                if 0 <= row < sketch.shape[0] and 0 <= col < sketch.shape[1]:
                    self._touch(sketch, row, col, stroke.erases, is_first=stroke.phase == "start")
            if stroke.phase == "end":
                if self._tool == "gradient" and isinstance(sketch, Drawing) and self._tab == STIFFNESS:
                    with suppress(ValueError):  # another tab has made the grid smaller meanwhile
                        sketch.gradient(stroke.cells[0], stroke.cells[-1], *self._ends())
                sketch.end()
        self._session.changed()
        self._refresh_page()

    def _touch(self, sketch: Sketch, row: int, col: int, erases: bool, *, is_first: bool) -> None:
        if self._tool == "gradient":
            return
        if isinstance(sketch, Drawing) and self._tab == STIFFNESS:
            value = 1.0 if erases else self._value
            if self._tool == "fill":
                sketch.fill_stiffness(row, col, value)
            else:
                sketch.paint_stiffness(row, col, value)
            return
        code = EMPTY if erases else self._held[self._tab]
        if self._tool == "fill" and is_first:
            sketch.fill(row, col, code)
        elif self._tool != "fill":
            sketch.paint(row, col, code)

    def _ends(self) -> tuple[float, float]:
        """Returns the factors where a gradient begins and ends: from the other end of the range to the brush's."""
        return (STIFFNESS_LOW if self._value >= 1.0 else STIFFNESS_HIGH), self._value

    def _command(self, name: str, arguments: dict[str, Any]) -> None:
        if name == "undo":
            self._do(lambda sketch: sketch.undo())
        elif name == "redo":
            self._do(lambda sketch: sketch.redo())
        elif name == "shift":
            down, right = arguments["by"]
            self._shift((int(down), int(right)))
        elif name == "brush" and arguments.get("brush") in NAMES and self._tab != STIFFNESS:
            code = CELL_CHARS.index(arguments["brush"])
            if code in self._brushes[self._tab]:
                self._hold(code)

    def _write(self, text: str) -> None:
        if self._tab == STIFFNESS:
            self._do(lambda drawing: drawing.write_stiffness(text))
        else:
            self._do(lambda sketch: sketch.write(text))

    def _resize(self) -> None:
        rows, cols = (size.value for size in self._sizes)
        if rows and cols and (int(rows), int(cols)) != self._sketch.shape:
            self._do(lambda sketch: sketch.resize(int(rows), int(cols)))

    def _hold_tool(self) -> None:
        """Gives the canvas what the hand holds."""
        if self._tab == STIFFNESS:
            ink = hex_color(palette.stiffness_colors(np.array([self._value]))[0])
            self._grid.hold(self._tool, "", ink, "")
            return
        code = self._held[self._tab]
        ink = hex_color(palette.type_color(code)) if code != EMPTY else "#191c21"
        characters = "".join(CELL_CHARS[code] for code in self._brushes[self._tab])
        self._grid.hold(self._tool, CELL_CHARS[code], ink, characters)

    def refresh(self) -> None:
        """Shows the design as it is."""
        sketch, tab = self._sketch, self._tab
        for name, row in self._rows.items():
            row.set_visibility(name == tab)
        for name, tool in self._tools.items():
            tool.classes(add="is-held" if name == self._tool else "", remove="" if name == self._tool else "is-held")
        self._tools["gradient"].set_visibility(tab == STIFFNESS)
        for code, button in self._brushes.get(tab, {}).items():
            is_held = code == self._held[tab]
            button.classes(add="is-held" if is_held else "", remove="" if is_held else "is-held")
        self._undo.set_enabled(sketch.can_undo)
        self._redo.set_enabled(sketch.can_redo)
        self._grid.show(sketch, by_stiffness=tab == STIFFNESS)
        self._hold_tool()
        text = sketch.stiffness_text if isinstance(sketch, Drawing) and tab == STIFFNESS else sketch.text
        self._text.value = text.replace("/", "\n")
        for size, value in zip(self._sizes, sketch.shape, strict=True):
            size.value = value
        self._say()

    def _say(self) -> None:
        design = self._session.design
        if self._tab == WORLD:
            problem = design.terrain.problem(*design.drawing.shape)
            good = "A world to walk in" + ("." if design.task == TERRAIN else ": choose My terrain as the task.")
            self._says.say(problem or good, problem is None)
            return
        problem = design.drawing.problem()
        good = "" if problem else f"A body: {design.drawing.summary()}."
        if self._tab == STIFFNESS and not problem and design.material == "reactive":
            good = "The policy sets the stiffness (reactive); this field is for the invariant setting."
        self._says.say(problem or good, problem is None)


def _seed() -> int:
    """Returns a seed of the user's luck; what it gives is drawn, and kept."""
    return secrets.randbits(32)
