"""The panel where a policy is trained, the material improved, and bodies evolve, each in a process of its own."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from nicegui import events, run, ui

from evogymcm.studio.page.charts import curve_options, tree_options
from evogymcm.studio.page.theme import SEGMENTS, icon_button
from evogymcm.studio.runs import EVOLVE, MATERIAL, TRAIN, Runs, label
from evogymcm.studio.sessions import Session

if TYPE_CHECKING:
    from evogymcm.studio.processes import Job

_LOOK = 1.0  # seconds between looks at a process
_GOES_ON = ("stopped", "failed", "killed")
_STATES = {
    "new": "not started",
    "running": "running",
    "stopping": "stopping …",
    "stopped": "stopped",
    "finished": "finished",
    "failed": "failed",
    "killed": "its process was killed",
}
_ABOUT = {
    TRAIN: "PPO trains a policy for this body, in this task, from the package's policy where there is one. "
    "The robot above is moved by the newest policy.",
    MATERIAL: "Searches the voxels' stiffness for a better score under what moves the robot (invariant setting).",
    EVOLVE: "Evolves bodies of this grid's size with their policies, each child from its parent's.",
}


class LearnPanel:
    """The panel.

    Args:
        runs: Runs of all designs.
        session: The design.
        refresh: Shows a change everywhere on the page.
    """

    def __init__(self, runs: Runs, session: Session, refresh: Callable[[], None]) -> None:
        with ui.element("section").classes("studio-card").props('aria-label="Learn"'):
            tabs = ui.toggle({TRAIN: "Train", MATERIAL: "Material", EVOLVE: "Evolve"}, value=TRAIN)
            tabs.props(SEGMENTS + " spread").classes("studio-tabs").mark("learn-tabs")
            views = {kind: view(runs, session, refresh) for kind, view in _VIEWS.items()}

        def choose(kind: str) -> None:
            for name, view in views.items():
                view.root.set_visibility(name == kind)

        tabs.on_value_change(lambda event: choose(event.value))
        choose(TRAIN)

        async def look() -> None:
            for view in views.values():
                if view.root.visible:
                    await view.look()

        ui.timer(_LOOK, look)


class _View:
    """A kind of work: its settings, buttons, and how it stands."""

    kind = ""
    axes = ("env-steps", "score")

    def __init__(self, runs: Runs, session: Session, refresh: Callable[[], None]) -> None:
        self._runs, self._session, self._refresh_page = runs, session, refresh
        self._shown: Any = None  # what of the status is on the page
        with ui.column().classes("w-full gap-3") as self.root:
            ui.label(_ABOUT[self.kind]).classes("studio-small")
            with ui.element("div").classes("studio-bar"):
                self.settings()
                self._start = ui.button("Start", icon="play_arrow", on_click=self._begin).props("unelevated no-caps")
                self._start.mark(f"{self.kind}-start")
                self._stop = ui.button("Stop", icon="stop", on_click=self._end).props("outline no-caps")
                self._stop.mark(f"{self.kind}-stop")
                self._resume = ui.button("Resume", icon="play_arrow", on_click=self._go_on).props("outline no-caps")
                self._resume.mark(f"{self.kind}-resume")
                ui.space()
                self._report = icon_button("article", "Report of this run", self._download_report)
            self._bar = ui.linear_progress(show_value=False, size="6px").props("rounded")
            self._says = ui.label().classes("studio-small").props("role=status").mark(f"{self.kind}-status")
            self.results()
        for part in (self._stop, self._resume, self._report, self._bar):
            part.set_visibility(False)

    def settings(self) -> None:
        """Makes the fields of what a new run is to be like."""

    def results(self) -> None:
        """Makes what shows the results."""
        self._chart = ui.echart(curve_options(*self.axes)).classes("studio-chart").mark(f"{self.kind}-curve")
        self._chart.set_visibility(False)

    def start(self) -> "Job":
        """Begins a new run; it is called in a thread."""
        raise NotImplementedError

    def show(self, job: "Job", status: dict[str, Any]) -> None:
        """Shows the results so far."""
        points = [list(point) for point in status.get("curve", [])]
        self._chart.options["series"][0]["data"] = points
        self._chart.update()
        self._chart.set_visibility(bool(points))

    def words(self, status: dict[str, Any]) -> str:
        """Returns how far it is."""
        done, total = status.get("env_steps", 0), status.get("total", 0)
        scores = [score for _, score in status.get("curve", [])]
        best = f" · score {scores[-1]:.2f}" if scores else ""
        return f"{done:,} of {total:,} env-steps{best}"

    def part(self, status: dict[str, Any]) -> float:
        """Returns which part is done, from 0 to 1."""
        return float(status.get("env_steps", 0) / max(status.get("total", 1), 1))

    async def _act(self, work: Callable[[], Any], what: str) -> None:
        """Does something in a thread, and says where it cannot be done."""
        self._says.set_text(what)
        try:
            await run.io_bound(work)
        except (ValueError, OSError, ImportError) as error:
            ui.notify(str(error), type="warning", multi_line=True)
        self._shown = None
        await self.look()

    async def _begin(self) -> None:
        self._start.disable()
        await self._act(self.start, "starting …")
        self._start.enable()
        self._refresh_page()

    async def _end(self) -> None:
        await self._act(lambda: self._on_job("stop"), "stopping …")

    async def _go_on(self) -> None:
        await self._act(lambda: self._on_job("resume"), "starting …")

    def _on_job(self, what: str) -> None:
        job = self._job()
        if job is not None:
            getattr(job, what)()

    async def _download_report(self) -> None:
        from evogymcm.report import make_report

        try:
            job = self._job()
            if job is None:
                return
            page = await run.io_bound(make_report, [job.folder], animations=False)
            ui.download.content(str(page).encode(), f"{self._session.id}-{job.folder.name}.html", "text/html")
        except (ValueError, OSError, ImportError) as error:
            ui.notify(str(error), type="warning", multi_line=True)

    def _job(self) -> "Job | None":
        return self._runs.latest(self._session.id, self.kind)

    async def look(self) -> None:
        """Shows how the newest run stands."""
        try:
            job = await run.io_bound(self._job)
        except (ValueError, OSError) as error:
            self._says.set_text(str(error))
            return
        if job is None:
            return
        status = await run.io_bound(job.status)
        if status is None or status == self._shown:
            return
        state, reason = status["state"], status["error"]
        name = label(job.folder.name)
        self._says.set_text(f"{name}: {_STATES[state]} · {self.words(status)}{f' · {reason}' if reason else ''}")
        self._start.set_text("New run")
        self._start.set_visibility(state not in ("running", "stopping"))
        self._stop.set_visibility(state in ("running", "stopping"))
        self._resume.set_visibility(state in _GOES_ON)
        self._report.set_visibility(bool(status.get("curve")) and self.kind != MATERIAL)
        self._bar.set_visibility(True)
        self._bar.value = min(self.part(status), 1.0)
        self.show(job, status)
        self._shown = status


class _Training(_View):
    kind = TRAIN

    def settings(self) -> None:
        self._steps = ui.number("Env-steps", value=300_000, min=1000, step=10_000, precision=0)
        self._steps.props("dense outlined").classes("w-32").mark("train-steps")
        self._goes_on = ui.checkbox("from the policy above").props("dense").classes("studio-small")
        self._goes_on.tooltip("Begin with what moves the robot, not with the package's policy").mark("train-goes-on")

    def start(self) -> "Job":
        session = self._session
        job = self._runs.train(session.id, session.wanted(with_policy=self._goes_on.value), int(self._steps.value or 0))
        session.drive(f"{session.id}/{job.folder.name}")
        return job


class _Improving(_View):
    kind = MATERIAL
    axes = ("round", "score")

    def settings(self) -> None:
        self._rounds = ui.number("Rounds", value=30, min=1, step=5, precision=0).props("dense outlined")
        self._rounds.classes("w-24").mark("material-rounds")

    def results(self) -> None:
        super().results()
        self._use = ui.button("Paint this field", icon="format_paint", on_click=self._paint).props("outline no-caps")
        self._use.mark("material-use").set_visibility(False)

    def start(self) -> "Job":
        return self._runs.improve(self._session.id, self._session.wanted(), int(self._rounds.value or 0))

    def words(self, status: dict[str, Any]) -> str:
        score = status.get("score")
        gain = f" · score {score:.2f}, {status['gain']:+.2f} since the start" if score is not None else ""
        return f"round {status.get('round', 0)} of {status.get('total', 0)}{gain}"

    def part(self, status: dict[str, Any]) -> float:
        return float(status.get("round", 0) / max(status.get("total", 1), 1))

    def show(self, job: "Job", status: dict[str, Any]) -> None:
        super().show(job, status)
        self._field = status.get("stiffness"), job.config.body
        self._use.set_visibility(status.get("gain", 0.0) > 0.0)

    def _paint(self) -> None:
        field, body = self._field
        drawing = self._session.design.drawing
        if drawing.text != body:
            ui.notify("The body has changed since; this field belongs to the former one.", type="warning")
            return
        with self._session.lock:
            drawing.replace(drawing.body(), field)
        self._session.changed()
        self._refresh_page()


class _Evolving(_View):
    kind = EVOLVE

    def settings(self) -> None:
        self._population = ui.number("Generation", value=6, min=2, step=1, precision=0).props("dense outlined")
        self._population.classes("w-24").mark("evolve-population")
        self._budget = ui.number("Designs", value=24, min=2, step=6, precision=0).props("dense outlined")
        self._budget.classes("w-24").mark("evolve-budget")
        self._steps = ui.number("Env-steps each", value=20_000, min=1000, step=5000, precision=0)
        self._steps.props("dense outlined").classes("w-32").mark("evolve-steps")

    def results(self) -> None:
        self._nodes: list[dict[str, Any]] = []
        self._chart = ui.echart(tree_options([], []), on_point_click=self._take).classes("studio-chart studio-tree")
        self._chart.mark("evolve-tree")
        self._hint = ui.label("Each robot stands at its score, a line leads to its parent; click one to draw it here.")
        self._hint.classes("studio-small")
        for part in (self._chart, self._hint):
            part.set_visibility(False)

    def start(self) -> "Job":
        session = self._session
        counts = [int(field.value or 0) for field in (self._population, self._budget, self._steps)]
        return self._runs.evolve(session.id, session.wanted(with_policy=False), session.design.drawing.shape, *counts)

    def words(self, status: dict[str, Any]) -> str:
        scores = [score for _, score in status.get("curve", [])]
        best = f" · best score {max(scores):.2f}" if scores else ""
        done = f"{status.get('n_designs', 0)} of {status.get('budget', 0)} designs"
        return f"generation {status.get('generation', 0)} · {done}{best}"

    def part(self, status: dict[str, Any]) -> float:
        return float(status.get("n_designs", 0) / max(status.get("budget", 1), 1))

    def show(self, job: "Job", status: dict[str, Any]) -> None:
        tree = job.tree()  # type: ignore[attr-defined]
        self._nodes = tree["nodes"]
        self._chart.options.clear()
        self._chart.options.update(tree_options(tree["nodes"], tree["edges"]))
        self._chart.update()
        for part in (self._chart, self._hint):
            part.set_visibility(bool(self._nodes))
        self._folder = job.folder.name

    def _take(self, event: events.EChartPointClickEventArguments) -> None:
        """Draws a design of the tree, moved by its policy."""
        node = next((node for node in self._nodes if str(node["index"]) == event.name), None)
        if node is None:
            return
        from evogymcm.body import Body

        session = self._session
        with session.lock:
            session.design.drawing.replace(Body(node["body"]), node["stiffness"])
        if node["policy"]:
            session.drive(f"{session.id}/{self._folder}/policy-{node['index']:04}")
        session.changed()
        self._refresh_page()


_VIEWS: dict[str, type[_View]] = {TRAIN: _Training, MATERIAL: _Improving, EVOLVE: _Evolving}
