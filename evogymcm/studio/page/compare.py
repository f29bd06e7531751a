"""Two designs side by side, in step."""

from nicegui import run, ui

from evogymcm.studio.comparing import Pair
from evogymcm.studio.page.scene import SceneCanvas
from evogymcm.studio.page.theme import SEGMENTS, icon_button
from evogymcm.studio.page.watch import FASTEST, SLOWEST, VIEWS_SHOWN, tally

_ASPECT = 1.6


class ComparePage:
    """The page of a pair.

    Args:
        pair: The designs.
    """

    def __init__(self, pair: Pair) -> None:
        self._pair = pair
        self._scenes, self._tallies, self._problems = [], [], []
        pair.follow()
        with ui.element("main").classes("studio-main studio-wide"):
            for side, session in enumerate(pair.sessions):
                with ui.element("section").classes("studio-card"):
                    ui.link(session.design.name, f"/d/{session.id}").classes("studio-title")
                    with SceneCanvas(f"/pair/{pair.sessions[0].id}/{pair.sessions[1].id}/{side}", _ASPECT) as scene:
                        self._tallies.append(ui.label().classes("studio-tally").mark(f"tally-{side}"))
                    self._scenes.append(scene)
                    self._problems.append(ui.label().classes("studio-small text-negative"))
            with ui.element("div").classes("studio-bar studio-span"):
                self._play = icon_button("pause", "Play or pause", self._turn, marker="play")
                icon_button("skip_next", "One step", self._step, marker="step")
                icon_button("replay", "Start again", lambda: run.io_bound(pair.reset), marker="reset")
                speed = ui.slider(min=SLOWEST, max=FASTEST, step=5, value=pair.speed).style("width: 130px")
                speed.props('aria-label="env-steps a second"')
                speed.on_value_change(lambda event: setattr(pair, "speed", float(event.value)))
                ui.space()
                view = ui.toggle(VIEWS_SHOWN, value="types", on_change=lambda event: self._look(event.value))
                view.props(SEGMENTS + " dense").classes("studio-tabs").style("width: 160px")
        pair.play()
        ui.timer(0.1, self._tick)

    def _turn(self) -> None:
        if self._pair.plays:
            self._pair.pause()
        else:
            self._pair.play()

    async def _step(self) -> None:
        self._pair.pause()
        await run.io_bound(self._pair.step)

    def _look(self, view: str) -> None:
        for scene in self._scenes:
            scene.look(view)

    def _tick(self) -> None:
        self._play.props(f"icon={'pause' if self._pair.plays else 'play_arrow'}")
        problems = self._pair.follow()
        for watch, problem, tally_label, label in zip(
            self._pair.watches, problems, self._tallies, self._problems, strict=True
        ):
            label.set_text(problem or "")
            label.set_visibility(problem is not None)
            waits = "" if problem else "getting ready …"
            tally_label.set_text(tally(watch.player) if watch.player is not None else waits)
            tally_label.set_visibility(bool(tally_label.text))
