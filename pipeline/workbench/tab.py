"""One browser tab of the workbench: its open files, its figures and panels, and the 3-D scene of a recording."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from html import escape
from typing import Any, NamedTuple

from nicegui import Client

from armdyn.checked_study import CheckedStudy
from armdyn.document import Chart
from armdyn.errors import ArmdynError, InputError
from armdyn.inspection.check import WrongRecordingError
from armdyn.quoting import script_json
from pipeline.console.inputs import ModelAndRunInputs
from pipeline.report.missing_force import missing_force_charts
from pipeline.report.motion import motion_charts
from pipeline.report.overlay import OverlayFigure, last_step_curve_data
from pipeline.report.page import PLOTLY_LOOK, tabs_html, widget_html
from pipeline.view.motion import arm_scene, joint_motion, load_swing, swing_scene
from pipeline.view.scene import Scene
from pipeline.view.shapes import ArmShapes, arm_shapes
from pipeline.workbench import files, panels
from pipeline.workbench.background import SearchProcess, WorkbenchComputingThread
from pipeline.workbench.bench import AS_GIVEN_CURVE_LABEL, TICKED_EFFECTS_CURVE_LABEL, SelectedEffectsModel, Workbench

TICKED_LABEL = "as ticked"
PAUSE_TO_SEND_CURVES_SECONDS = 0.05
"""Pause after a click in which the new curves are sent before other figures are computed [s]."""
OpenSession = Callable[[ModelAndRunInputs], WorkbenchComputingThread]
"""Function that returns the computing thread for some files; tabs with the same files share it."""


class WorkbenchTabState(NamedTuple):
    """Open files of a browser tab.

    Attributes:
        session: thread that computes with the files.
        given: model and recordings as they were read.
        bench: workbench of these files.
    """

    session: WorkbenchComputingThread
    given: CheckedStudy
    bench: Workbench


class BrowserTab:
    """One browser tab of the workbench.

    Args:
        client: NiceGUI's connection to the tab.
        inputs: files that the command named; None for none.
        open_session: function that returns the computing thread for some files.
    """

    def __init__(self, client: Client, inputs: ModelAndRunInputs | None, open_session: OpenSession) -> None:
        self._client, self._open_desk = client, open_session
        self._folder = files.new_page_folder()
        self._model = inputs.model if inputs else None
        self._own_effects = inputs.effects if inputs else None
        self._runs = [(path, False) for path in inputs.runs] if inputs else []
        self._runs += [(path, True) for path in (inputs.held_out or ())] if inputs else []
        self._trust = inputs.trust_data if inputs else False
        self._said: list[str] = []
        self._session: WorkbenchComputingThread | None = None
        self._open: WorkbenchTabState | None = None
        self._ticked: tuple[str, ...] = ()
        self._values: dict[str, float] = {}
        self._asked = 0  # number of the newest request
        self._points = 0
        self._search: SearchProcess | None = None

    def close(self) -> None:
        """Stop the tab's search and remove its temporary files, after the browser has closed the tab."""
        self._stop_search()
        self._folder.cleanup()

    def _stop_search(self) -> None:
        if self._search is not None:
            self._search.stop()
        self._search = None

    async def _reopen(self) -> None:
        self._asked += 1
        self._ticked, self._values, self._open = (), {}, None
        self._stop_search()
        self._call("panel", "files", panels.files_panel(self._model, self._runs, self._said))
        self._call(
            "panel",
            "ranking",
            "<p class='caption'>A search ranks every effect that could be added to the ticked ones.</p>",
        )
        self._call("panel", "effects", "")
        self._call("panel", "proposal", "")
        self._call("say", "")
        self._call("show", "stop", False)
        self._call("show", "trust", False)
        fitted, held_out = ([path for path, held in self._runs if held is wanted] for wanted in (False, True))
        if self._model is None or not fitted:
            model = "a model: start one, or drop a model or a URDF"
            self._call("panel", "subtitle", f"still needed: {model if self._model is None else 'a recording to fit'}")
            needed = "A model and recordings are needed: drop them below, or name them on the command line."
            self._call("panel", "curves", f"<p class='caption'>{needed}</p>")
            return
        inputs = ModelAndRunInputs(self._model, fitted, held_out or None, None, self._own_effects, self._trust)
        session = self._session = self._open_desk(inputs)
        self._call("busy", "reading recordings and fitting the model as given")
        try:
            given, bench = await session.opened()
            if session is not self._session:
                return  # the user chose other files meanwhile
            self._open = WorkbenchTabState(session, given, bench)
            self._call("panel", "checks", panels.checks_panel(given.inspection))
            names = ", ".join(run.name for run in bench.study.runs)
            said = ". ".join([f"{self._model.name} with {names}", *given.set_aside])
            self._call("panel", "subtitle", escape(said))
            await self._show_first(bench.given_state)
            self._call("busy", "preparing the effects")
            await session.ready()
            if session is self._session:
                self._call("panel", "effects", panels.effects_panel(bench, ()))
                await self._show_motion(())
        except WrongRecordingError as error:
            self._call("panel", "checks", panels.checks_panel(error.inspection))
            self._call("show", "trust", True)
            raise
        finally:
            self._call("busy", "")

    async def _show_first(self, state: SelectedEffectsModel) -> None:
        overlays = OverlayFigure(state.curves, (AS_GIVEN_CURVE_LABEL, TICKED_EFFECTS_CURVE_LABEL))
        self._points = overlays.points
        widget = overlays.widget()
        html = f"{tabs_html(overlays.tabs, 'bench')}<form class='widget'>{widget_html(widget)}</form>"
        self._call("open", {"html": html, "data": widget.data, "look": PLOTLY_LOOK})
        self._call("panel", "errors", panels.errors_panel(state))
        self._call("panel", "knobs", panels.sliders_panel(state))
        await self._show_missing_force(state)

    def _show(self, state: SelectedEffectsModel, *, knobs: bool = True) -> None:
        totals = OverlayFigure(state.curves, (AS_GIVEN_CURVE_LABEL, TICKED_EFFECTS_CURVE_LABEL)).totals()
        new = {"changed": [last_step_curve_data(curve, self._points) for curve in state.curves], "totals": totals}
        self._call("update", new)
        self._call("panel", "errors", panels.errors_panel(state))
        self._call("show", "refit", state.how == "by hand")
        if knobs:
            self._call("panel", "knobs", panels.sliders_panel(state))

    async def _show_missing_force(self, state: SelectedEffectsModel) -> None:
        bench = self._opened().bench
        asked = self._asked
        await asyncio.sleep(PAUSE_TO_SEND_CURVES_SECONDS)
        if asked == self._asked:
            await self._show_charts("missing", lambda: missing_force_charts(bench.missing_force(state), TICKED_LABEL))

    async def _show_motion(self, effects: Sequence[str]) -> None:
        """Show the fitted motion, last, because an arm's simulator is compiled for it."""
        bench = self._opened().bench
        await self._show_charts("motion", lambda: motion_charts(bench.motion(effects)))

    async def _show_charts(self, function: str, make: Callable[[], Sequence[Chart]]) -> None:
        """Make figures in another thread, and show them unless a newer request has arrived."""
        asked = self._asked
        charts = await asyncio.to_thread(make)
        if asked == self._asked:
            self._call(function, {chart.tab: {"figure": chart.figure, "caption": chart.caption} for chart in charts})

    def _opened(self) -> WorkbenchTabState:
        if self._open is None:
            raise InputError("nothing is opened yet: drop a model and recordings first")
        return self._open

    async def _working(self, what: str, work: Callable[[], Any]) -> Any:
        self._call("busy", what)
        try:
            return await self._opened().session.do(work)
        finally:
            self._call("busy", "")

    def _guarded_event(self, handler: Callable[[Any], Awaitable[None]]) -> Callable[[Any], Awaitable[None]]:
        async def handle(event: Any) -> None:
            await self._guarded(handler(event.args if hasattr(event, "args") else event))

        return handle

    async def _guarded(self, work: Awaitable[None]) -> None:
        try:
            await work
        except ArmdynError as error:
            self._call("say", str(error).replace(f"{self._folder.name}/", ""), "bad")
        except Exception as error:
            from pipeline.console.streams import report_unexpected_error

            self._call("say", report_unexpected_error(error), "bad")

    def _call(self, function: str, *arguments: Any) -> None:
        """Call a function of the page's script, ``armdynBench``."""
        self._client.run_javascript(f"armdynBench.{function}({', '.join(map(script_json, arguments))})")


_links: dict[str, ArmShapes] = {}
"""Shapes of arms that were read before, by fingerprint of the arm; reading meshes takes a second or two."""


def scene_of_run(bench: Workbench, effects: Sequence[str], name: str | None) -> Scene:
    """3-D scene of a recording; a swing angle that was not measured is predicted by the model with added effects.

    Args:
        bench: model and recordings.
        effects: labels of the added effects.
        name: name of the recording; None for the first one.

    Raises:
        InputError: the recording does not contain a motion.
    """
    study, model = bench.study, bench.study.model
    run = next((run for run in (*study.runs, *study.held_out) if run.name == name), study.runs[0])
    robot = model.robot
    if robot is None:
        fit = bench.fit(effects) if run in study.runs else None
        return swing_scene(run.name, "run", load_swing(run, model, fit))
    if robot.fingerprint not in _links:
        _links[robot.fingerprint] = arm_shapes(robot)
    return arm_scene(run.name, "run", _links[robot.fingerprint], *joint_motion(run.recording, robot))
