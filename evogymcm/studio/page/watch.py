"""The panel where a design is watched in its task."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from nicegui import run, ui

import evogymcm
from evogymcm.studio.page.scene import SceneCanvas
from evogymcm.studio.page.theme import SEGMENTS, icon_button
from evogymcm.studio.runs import Runs
from evogymcm.studio.sessions import Session
from evogymcm.studio.store import TERRAIN, check_task

if TYPE_CHECKING:
    from evogymcm.studio.player import Player

_MATERIALS = {"invariant": "Invariant", "reactive": "Reactive"}
VIEWS_SHOWN = {"types": "Types", "stiffness": "Stiffness"}
SLOWEST, FASTEST = 5, 200  # env-steps a second


class WatchPanel:
    """The panel.

    Args:
        runs: Runs of all designs.
        session: The design.
        refresh: Shows a change everywhere on the page.
    """

    def __init__(self, runs: Runs, session: Session, refresh: Callable[[], None]) -> None:
        self._runs, self._session, self._refresh_page = runs, session, refresh
        with ui.element("section").classes("studio-card").props('aria-label="Watch"'):
            self._make_choices()
            self._scene = SceneCanvas(f"/live/{session.id}")
            with self._scene.mark("scene"):
                self._tally = ui.label().classes("studio-tally").mark("tally")
                self._over = ui.element("div").classes("studio-over")
                with self._over, ui.column().classes("items-center gap-2"):
                    self._spinner = ui.spinner(size="lg")
                    self._reason = ui.label().mark("reason")
            self._make_controls()
            self._problem = ui.label().classes("studio-small text-negative").mark("watch-problem")
        self.refresh()
        self.tick()

    def _make_choices(self) -> None:
        design = self._session.design
        options = {
            TERRAIN: "My terrain",
            **{id: f"{id}: {task.about}" if task.about else id for id, task in evogymcm.tasks.items()},
        }
        with ui.element("div").classes("studio-bar"):
            self._task = ui.select(options, value=design.task, label="Task", with_input=True)
            self._task.props("dense outlined options-dense").classes("studio-grow").style("flex: 3 1 200px")
            self._task.mark("task").on_value_change(lambda event: self._choose_task(event.value))
            self._policy = ui.select(self._policies(), value=self._session.design.policy, label="Moved by")
            self._policy.props("dense outlined options-dense").style("flex: 1.5 1 150px").mark("policy")
            self._policy.on("popup-show", lambda: self._policy.set_options(self._policies()))
            self._policy.on_value_change(lambda event: self._choose_policy(event.value))
            self._material = ui.select(_MATERIALS, value=design.material, label="Stiffness")
            self._material.tooltip(
                "Invariant: stiffness belongs to the body. Reactive: the policy sets it in every step."
            )
            self._material.props("dense outlined options-dense").style("flex: 1 1 110px")
            self._material.mark("material").on_value_change(lambda event: self._choose_material(event.value))

    def _make_controls(self) -> None:
        with ui.element("div").classes("studio-bar"):
            self._play = icon_button("pause", "Play or pause", self._turn, marker="play")
            icon_button("skip_next", "One step", self._step, marker="step")
            icon_button("replay", "Start again", self._reset, marker="reset")
            ui.icon("speed").classes("text-grey-7 q-ml-sm").props("size=xs")
            speed = ui.slider(min=SLOWEST, max=FASTEST, step=5, value=self._session.watch.speed)
            speed.props('aria-label="env-steps a second"').style("width: 110px").mark("speed")
            self._speed = ui.label().classes("studio-small")
            speed.on_value_change(lambda event: self._set_speed(float(event.value)))
            ui.space()
            view = ui.toggle(VIEWS_SHOWN, value="types", on_change=lambda event: self._scene.look(event.value))
            view.props(SEGMENTS + " dense").classes("studio-tabs").style("width: 160px").mark("view")
        self._set_speed(self._session.watch.speed)

    def _policies(self) -> dict[str, str]:
        """Returns what can be chosen, the present choice included."""
        design = self._session.design
        chosen, found = design.policy, self._runs.policies(design.task, design.material)
        return found if chosen in found else found | {chosen: self._runs.title(chosen)}

    def _choose_task(self, task: str | None) -> None:
        if task is None or task == self._session.design.task:
            return
        with self._session.lock:
            self._session.design.task = check_task(task)
        self._session.changed()
        self._refresh_page()

    def _choose_policy(self, policy: str | None) -> None:
        if policy is not None and policy != self._session.design.policy:
            self._session.drive(policy)
            self._refresh_page()

    def _choose_material(self, material: str) -> None:
        if material == self._session.design.material:
            return
        with self._session.lock:
            self._session.design.material = material
        self._session.changed()
        self._refresh_page()

    def _turn(self) -> None:
        watch = self._session.watch
        watch.plays = not watch.plays
        self.refresh()

    async def _step(self) -> None:
        watch = self._session.watch
        watch.plays = False
        if watch.player is not None:
            await run.io_bound(watch.player.step)
        self.refresh()

    async def _reset(self) -> None:
        player = self._session.watch.player
        if player is not None:
            await run.io_bound(player.reset)

    def _set_speed(self, speed: float) -> None:
        self._session.watch.speed = speed
        self._speed.set_text(f"{speed:.0f} steps/s")

    def refresh(self) -> None:
        """Shows the settings as they are."""
        design, watch = self._session.design, self._session.watch
        if design.policy not in self._policy.options:
            self._policy.set_options(self._policies())
        self._task.value, self._material.value, self._policy.value = design.task, design.material, design.policy
        self._play.props(f"icon={'pause' if watch.plays else 'play_arrow'}")

    def tick(self) -> None:
        """Shows what has become of the robot since."""
        watch = self._session.watch
        player = watch.player
        self._over.set_visibility(player is None)
        problem = self._session.show()
        self._spinner.set_visibility(problem is None and watch.problem is None)
        waits = "Getting the simulator ready; the very first time it is compiled, which takes about 20 s."
        self._reason.set_text(problem or watch.problem or waits)
        fault = player.frame()["error"] if player is not None else None
        self._problem.set_text((problem or watch.problem or fault or "") if player is not None else "")
        self._problem.set_visibility(bool(self._problem.text))
        self._tally.set_visibility(player is not None)
        if player is not None:
            self._tally.set_text(tally(player))


def tally(player: "Player") -> str:
    """Returns in words where an episode stands."""
    frame = player.frame()
    ending = f" · {frame['ending']}" if frame["ending"] else ""
    return f"step {frame['step']} · score {frame['score']:.2f}{ending}"
