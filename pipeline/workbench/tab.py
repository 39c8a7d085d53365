"""One browser tab: which files it has open, what it shows of them, and the motion of a run in three dimensions."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from html import escape
from typing import Any

from nicegui import Client

from armdyn.arm.model import ArmModel
from armdyn.errors import ArmdynError, InputError
from armdyn.inspection.check import WrongRecordingError
from armdyn.quoting import script_json
from armdyn.run import Run
from pipeline.console.inputs import Given, Inputs
from pipeline.report.missing_force import missing_force_pictures
from pipeline.report.overlay import Overlays, changed
from pipeline.report.page import LOOK, tabs_html
from pipeline.view.motion import arm_scene, joint_motion, swing_of, swing_scene
from pipeline.view.scene import Scene
from pipeline.view.shapes import Links, links_of
from pipeline.workbench import files, panels
from pipeline.workbench.bench import AS_GIVEN, NOW, Atom, Bench, State
from pipeline.workbench.desk import Desk
from pipeline.workbench.ranking import Search

AS_TICKED = "as ticked"
FIRST = 0.05
"""s in which the curves that answer a click leave before anything else is computed."""
OpenDesk = Callable[[Inputs], Desk]


class Tab:
    """One browser tab.

    Args:
        client: NiceGUI's connection to it.
        inputs: files that the command named; None for none.
        open_desk: gives the desk of files, which tabs with the same files share.
    """

    def __init__(self, client: Client, inputs: Inputs | None, open_desk: OpenDesk) -> None:
        self._client, self._open_desk = client, open_desk
        self._folder = files.new_folder()
        self._model = inputs.model if inputs else None
        self._own_effects = inputs.effects if inputs else None
        self._runs = [(path, False) for path in inputs.runs] if inputs else []
        self._runs += [(path, True) for path in (inputs.held_out or ())] if inputs else []
        self._trust = inputs.trust_data if inputs else False
        self._said: list[str] = []
        self._desk: Desk | None = None
        self._given: Given | None = None
        self._bench: Bench | None = None
        self._ticked: tuple[Atom, ...] = ()
        self._values: dict[str, float] = {}
        self._asked = 0  # of the newest answer that is wanted
        self._points = 0
        self._search: Search | None = None

    def close(self) -> None:
        """The tab is gone."""
        if self._search is not None:
            self._search.stop()
        self._folder.cleanup()

    async def _reopen(self) -> None:
        """Read the files anew, and show the model as given."""
        self._asked += 1
        self._ticked, self._values, self._bench = (), {}, None
        if self._search is not None:
            self._search.stop()
            self._search = None
        self._panel("files", panels.files_panel(self._model, self._runs, self._said))
        self._panel("ranking", "<p class='caption'>A search ranks every effect beside what is ticked.</p>")
        self._panel("effects", "")
        self._run("armdynBench.say('');armdynBench.show('stop', false);armdynBench.show('trust', false)")
        fitted = [path for path, held_out in self._runs if not held_out]
        if self._model is None or not fitted:
            missing = (
                "a recording to fit" if self._model is not None else "a model: start one, or drop a model or a URDF"
            )
            self._subtitle(f"still needed: {missing}")
            return
        held_out = [path for path, held in self._runs if held]
        inputs = Inputs(self._model, fitted, held_out or None, None, self._own_effects, self._trust)
        desk = self._desk = self._open_desk(inputs)
        self._busy("reading recordings and fitting the model as given")
        try:
            self._given, bench = await desk.opened()
            if desk is not self._desk:
                return  # other files were chosen meanwhile
            self._panel("checks", panels.checks_panel(self._given.inspection))
            self._bench = bench
            self._subtitle(f"{self._model.name} with {', '.join(run.name for run in bench.study.runs)}")
            state = bench.opening
            overlays = Overlays(state.curves, (AS_GIVEN, NOW))
            self._points = overlays.points
            widget = overlays.widget()
            chart = f"<div class='chart' style='height: {widget.height}px'></div><p class='caption'></p>"
            html = f"{tabs_html(overlays.tabs(), 'bench')}<form class='widget'>{widget.html}{chart}</form>"
            self._run(f"armdynBench.open({script_json({'html': html, 'data': widget.data, 'look': LOOK})})")
            self._panel("errors", panels.errors_panel(state))
            self._panel("knobs", panels.knobs_panel(state))
            await self._show_missing_force(state)
            self._busy("preparing the effects")
            await desk.ready()
            if desk is self._desk:
                self._panel("effects", panels.effects_panel(bench, ()))
        except WrongRecordingError as error:
            self._panel("checks", panels.checks_panel(error.inspection))
            self._run("armdynBench.show('trust', true)")
            raise
        finally:
            self._busy("")

    def _show(self, state: State, *, knobs: bool = True) -> None:
        overlays = Overlays(state.curves, (AS_GIVEN, NOW))
        new = {"changed": [changed(curve, self._points) for curve in state.curves], "totals": overlays.totals()}
        self._run(f"armdynBench.update({script_json(new)})")
        self._panel("errors", panels.errors_panel(state))
        self._run(f"armdynBench.show('refit', {script_json(state.how == 'by hand')})")
        if knobs:
            self._panel("knobs", panels.knobs_panel(state))

    async def _show_missing_force(self, state: State) -> None:
        """After the curves, which need not wait for it; nothing where another answer is wanted meanwhile."""
        bench, asked = self._opened(), self._asked
        await asyncio.sleep(FIRST)
        if asked != self._asked:
            return
        made = asyncio.to_thread(lambda: missing_force_pictures(bench.missing_force(state), AS_TICKED))
        shown = {picture.tab: {"figure": picture.figure, "caption": picture.caption} for picture in await made}
        if asked == self._asked:
            self._run(f"armdynBench.missing({script_json(shown)})")

    def _opened(self) -> Bench:
        if self._bench is None:
            raise InputError("nothing is opened yet: drop a model and recordings first")
        return self._bench

    def _desk_open(self) -> Desk:
        if self._desk is None:
            raise InputError("nothing is opened yet: drop a model and recordings first")
        return self._desk

    async def _working(self, what: str, work: Callable[[], Any]) -> Any:
        """Do something slow beside the page, and say so."""
        self._busy(what)
        try:
            return await self._desk_open().do(work)
        finally:
            self._busy("")

    def _guarded_event(self, handler: Callable[[Any], Awaitable[None]]) -> Callable[[Any], Awaitable[None]]:
        async def handle(event: Any) -> None:
            await self._guarded(handler(event.args if hasattr(event, "args") else event))

        return handle

    async def _guarded(self, work: Awaitable[None]) -> None:
        """What goes wrong is one sentence on the page."""
        try:
            await work
        except ArmdynError as error:
            self._say(str(error).replace(f"{self._folder.name}/", ""))
        except Exception as error:
            from pipeline.console.streams import report_unforeseen

            self._say(report_unforeseen(error))

    def _say(self, text: str) -> None:
        self._run(f"armdynBench.say({script_json(text)}, 'bad')")

    def _busy(self, text: str) -> None:
        self._run(f"armdynBench.busy({script_json(text)})")

    def _subtitle(self, text: str) -> None:
        self._panel("subtitle", escape(text))

    def _panel(self, place: str, html: str) -> None:
        self._run(f"armdynBench.panel({script_json(place)}, {script_json(html)})")

    def _run(self, code: str) -> None:
        self._client.run_javascript(code)


_links: dict[str, Links] = {}
"""Of arms that were drawn already, by fingerprint: meshes take a second or two to read."""


def scene_of_run(bench: Bench, effects: Sequence[Atom], name: str | None) -> Scene:
    """What moves in a run; a load whose angle was not measured swings as the model with these effects says.

    Args:
        bench: model and runs.
        effects: that are ticked.
        name: of the run; the first one where it is None.

    Raises:
        InputError: nothing in the run says how it moves.
    """
    study = bench.study
    runs = (*study.runs, *study.held_out)
    run: Run = next((run for run in runs if run.name == name), runs[0])
    model = study.model
    if isinstance(model, ArmModel):
        robot = model.arm.robot
        if robot.fingerprint not in _links:
            _links[robot.fingerprint] = links_of(robot)
        links = _links[robot.fingerprint]
        return arm_scene(run.name, "run", links, *joint_motion(run.recording, robot))
    if run in study.runs:
        fit = bench.fit(effects)
        return swing_scene(run.name, "run", swing_of(run, model, fit))
    return swing_scene(run.name, "run", swing_of(run, model))
