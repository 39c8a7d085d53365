"""What a person sees and clicks: one page of one browser tab, with its own choice of effects."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from nicegui import Client, events, ui

from armdyn.errors import ArmdynError, InputError
from pipeline.commands.identify import Given, Inputs
from pipeline.report.overlay import OverlaySection, changed
from pipeline.report.page import LOOK, tabs_html
from pipeline.workbench import panels, uploads
from pipeline.workbench.bench import AS_GIVEN, NOW, Atom, Bench, State
from pipeline.workbench.desk import Desk
from pipeline.workbench.keeping import keep
from pipeline.workbench.ranking import Ranking, Search

TEMPLATES = Path(__file__).parent / "templates"
STILL = 0.25
"""s without another click before a refit begins: it takes time from the answers to the clicks."""
OpenDesk = Callable[[Inputs], Desk]


class Page:
    """One browser tab.

    Args:
        client: NiceGUI's connection to it.
        inputs: files that the command named; None for none.
        open_desk: gives the desk of files, which tabs with the same files share.
    """

    def __init__(self, client: Client, inputs: Inputs | None, open_desk: OpenDesk) -> None:
        self._client, self._open_desk = client, open_desk
        self._folder = uploads.new_folder()
        self._model = inputs.model if inputs else None
        self._own_effects = inputs.effects if inputs else None
        self._runs = [(path, False) for path in inputs.runs] if inputs else []
        self._runs += [(path, True) for path in (inputs.held_out or ())] if inputs else []
        self._said: list[str] = []
        self._desk: Desk | None = None
        self._given: Given | None = None
        self._bench: Bench | None = None
        self._ticked: tuple[Atom, ...] = ()
        self._values: dict[str, float] = {}
        self._asked = 0  # of the newest answer that is wanted
        self._points = 0
        self._search: Search | None = None
        self._kept: Path | None = None
        self._build()

    def _build(self) -> None:
        skeleton = Template((TEMPLATES / "workbench.html").read_text(encoding="utf-8"))
        from urdf.load import known_robots

        robots = "".join(f"<option>{name}</option>" for name in known_robots())
        ui.html(skeleton.substitute(robots=robots, kinds=panels.kinds_of_export()), sanitize=False)
        label = "Drop recordings, a model or a URDF here, or choose files with +"
        upload = ui.upload(
            label=label, multiple=True, auto_upload=True, max_file_size=uploads.LARGEST,
            on_multi_upload=self._guarded_event(self._dropped),
            on_rejected=lambda: self._say("A file is too large: record for a shorter time."),
        ).props("flat")  # fmt: skip
        upload.classes("drop").props('id="drop"')
        self._uploader = upload
        handlers: dict[str, Callable[[dict[str, Any]], Awaitable[None]]] = {
            "pick": self._pick, "every": self._every, "try": self._try, "clear": self._clear, "knob": self._knob,
            "refit": self._refit, "role": self._role, "scene": self._scene, "search": self._look, "stop": self._stop,
            "start-pendulum": self._pendulum, "start-arm": self._arm, "keep": self._keep, "go-on": self._go_on,
        }  # fmt: skip
        for name, handler in handlers.items():
            ui.on(name, self._guarded_event(handler))

    async def begin(self) -> None:
        """Show what the command named, as soon as the browser is there."""
        self._run("document.querySelector('section[aria-label=Files]').append(document.getElementById('drop'))")
        await self._guarded(self._reopen())

    def close(self) -> None:
        """The tab is gone."""
        if self._search is not None:
            self._search.stop()
        self._folder.cleanup()

    # What a person clicks

    async def _pick(self, args: dict[str, Any]) -> None:
        atom = self._atom(args["label"])
        await self._tick([*(a for a in self._ticked if a != atom), *([atom] if args["on"] else [])])

    async def _every(self, args: dict[str, Any]) -> None:
        mine = [atom for atom in self._opened().atoms if atom.effect == args["effect"]]
        rest = [atom for atom in self._ticked if atom not in mine]
        await self._tick(rest if set(mine) <= set(self._ticked) else [*rest, *mine], told=False)

    async def _try(self, args: dict[str, Any]) -> None:
        effect, _, joints = str(args["label"]).partition(":")
        new = [self._atom(f"{effect}:{joint}" if joint else effect) for joint in joints.split(",")]
        await self._tick([*(a for a in self._ticked if a not in new), *new], told=False)

    async def _clear(self, _: dict[str, Any]) -> None:
        await self._tick([], told=False)

    async def _tick(self, effects: list[Atom], *, told: bool = True) -> None:
        """Show at once what these effects would do, then what they do."""
        bench = self._opened()
        self._ticked, self._values = tuple(effects), {}
        if not told:
            self._run(f"armdynBench.ticks({_json([atom.label for atom in effects])})")
        self._asked += 1
        asked = self._asked
        self._show(bench.foretold(self._ticked))
        if not effects:
            return
        await asyncio.sleep(STILL)
        if asked != self._asked:
            return
        state = await self._working("refitting", lambda: bench.fitted(self._ticked) if asked == self._asked else None)
        if state is not None and asked == self._asked:
            self._show(state)

    async def _knob(self, args: dict[str, Any]) -> None:
        bench = self._opened()
        self._values[str(args["name"])] = float(args["value"])
        self._asked += 1
        try:
            values = dict(self._values)
            state = await self._desk_open().do(lambda: bench.by_hand(self._ticked, values))
            self._show(state, knobs=False)
        finally:
            self._run("armdynBench.turned()")

    async def _refit(self, _: dict[str, Any]) -> None:
        await self._tick(list(self._ticked))

    async def _look(self, _: dict[str, Any]) -> None:
        self._opened()
        if self._search is not None:
            self._search.stop()
        loop, here = asyncio.get_running_loop(), self._desk_open()

        def told(kind: str, what: object) -> None:  # from another thread
            if not loop.is_closed():
                loop.call_soon_threadsafe(self._heard, here, kind, what)

        self._panel("ranking", "<p class='busy' id='progress'>starting the search</p>")
        self._run("armdynBench.show('stop', true)")
        labels = [effect.label for effect in self._opened().effects_of(self._ticked)]
        self._search = Search(here.inputs, labels, told)

    def _heard(self, asked: Desk, kind: str, what: object) -> None:
        if asked is not self._desk:
            return
        if kind == "progress":
            self._panel("progress", escape(str(what)))
            return
        self._run("armdynBench.show('stop', false)")
        if isinstance(what, Ranking):
            self._panel("ranking", panels.ranking_panel(what, what.units))
        else:
            self._panel("ranking", f"<p class='caption'>{escape(str(what))}</p>")

    async def _stop(self, _: dict[str, Any]) -> None:
        if self._search is not None:
            self._search.stop()
        self._run("armdynBench.show('stop', false)")
        self._panel("ranking", "<p class='caption'>The search was stopped.</p>")

    async def _scene(self, args: dict[str, Any]) -> None:
        from pipeline.workbench.space import scene_of_run

        bench, name, ticked = self._opened(), args.get("run"), self._ticked
        scene = await self._working("drawing in 3-D", lambda: scene_of_run(bench, ticked, name).data())
        self._run(f"armdynBench.scene({_json(scene)})")

    async def _role(self, args: dict[str, Any]) -> None:
        i = int(args["run"])
        path, _ = self._runs[i]
        kept = [] if args["role"] == "leave out" else [(path, args["role"] == "hold out")]
        self._runs[i : i + 1] = kept
        await self._reopen()

    async def _pendulum(self, args: dict[str, Any]) -> None:
        self._model = uploads.pendulum(Path(self._folder.name), str(args["mass"]), str(args["length"]))
        await self._reopen()

    async def _arm(self, args: dict[str, Any]) -> None:
        folder, robot = Path(self._folder.name), str(args["robot"])
        self._model = await asyncio.to_thread(uploads.known_arm, folder, robot)
        await self._reopen()

    async def _dropped(self, event: events.MultiUploadEventArguments) -> None:
        joints = tuple(getattr(self._bench.study.model, "joints", ())) if self._bench else ()
        problems = []
        # A model first: its joints name the columns of recordings.
        for file in sorted(event.files, key=lambda file: not file.name.lower().endswith((".urdf", ".xml", ".toml"))):
            try:
                path = uploads.place_for(Path(self._folder.name), file.name)
                await file.save(path)
                found = await asyncio.to_thread(uploads.taken_in, path, joints)
            except InputError as error:
                problems.append(str(error).replace(f"{self._folder.name}/", ""))
                continue
            self._said.append(found.said)
            if found.kind == "model":
                self._model = found.path
            elif found.kind == "run":
                self._runs = [(p, held) for p, held in self._runs if p != found.path] + [(found.path, False)]
        self._uploader.reset()
        await self._reopen()
        if problems:
            self._say("; ".join(problems))

    async def _keep(self, args: dict[str, Any]) -> None:
        bench, given = self._opened(), self._given
        assert given is not None  # it was opened together with the bench
        if not self._ticked:
            raise InputError("nothing is ticked: the model is as given; tick an effect first")
        model = Path(str(args["model"]).strip() or "repaired.toml").expanduser()
        report = model.with_suffix(".html") if args["report"] else None
        ending = str(args["export"])
        exported = model.with_suffix(ending) if ending else None
        opened, ticked, force = self._desk_open().inputs, self._ticked, bool(args["force"])
        kept = await self._working(
            "fitting and writing", lambda: keep(opened, given, bench, ticked, model, report, exported, force=force)
        )
        self._kept = model
        lines = [f"<p class='sentence'>{escape(kept.sentence)}</p>"]
        lines += [f"<p class='caption'>written to {escape(str(path.resolve()))}</p>" for path in kept.files]
        lines += [f"<p class='caption'>not in it: {escape(note)}</p>" for note in kept.notes]
        lines.append(f"<p class='next'>next:<code>{escape(kept.next_step)}</code></p>")
        lines.append("<button type='button' id='go-on'>go on from this model</button>")
        self._panel("kept", "".join(lines))

    async def _go_on(self, _: dict[str, Any]) -> None:
        self._model = self._kept
        await self._reopen()

    # What the page shows

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
        self._run("armdynBench.say('');armdynBench.show('stop', false)")
        fitted = [path for path, held_out in self._runs if not held_out]
        if self._model is None or not fitted:
            missing = (
                "a recording to fit" if self._model is not None else "a model: start one, or drop a model or a URDF"
            )
            self._subtitle(f"still needed: {missing}")
            return
        held_out = [path for path, held in self._runs if held]
        inputs = Inputs(self._model, fitted, held_out or None, None, self._own_effects)
        desk = self._desk = self._open_desk(inputs)
        self._busy("reading recordings and fitting the model as given")
        try:
            self._given, bench = await desk.opened()
            if desk is not self._desk:
                return  # other files were chosen meanwhile
            self._bench = bench
            self._subtitle(f"{self._model.name} with {', '.join(run.name for run in bench.study.runs)}")
            state = bench.opening
            section = OverlaySection(state.curves, (AS_GIVEN, NOW))
            self._points = section.points
            widget = section.widget()
            chart = f"<div class='chart' style='height: {widget.height}px'></div><p class='caption'></p>"
            html = f"{tabs_html(section.tabs(), 'bench')}<form class='widget'>{widget.html}{chart}</form>"
            self._run(f"armdynBench.open({_json({'html': html, 'data': widget.data, 'look': LOOK})})")
            self._panel("errors", panels.errors_panel(state))
            self._panel("knobs", panels.knobs_panel(state))
            self._busy("preparing the effects")
            await desk.ready()
            if desk is self._desk:
                self._panel("effects", panels.effects_panel(bench, ()))
        finally:
            self._busy("")

    def _show(self, state: State, *, knobs: bool = True) -> None:
        section = OverlaySection(state.curves, (AS_GIVEN, NOW))
        new = {"changed": [changed(curve, self._points) for curve in state.curves], "totals": section.totals()}
        self._run(f"armdynBench.update({_json(new)})")
        self._panel("errors", panels.errors_panel(state))
        if knobs:
            self._panel("knobs", panels.knobs_panel(state))

    def _atom(self, label: str) -> Atom:
        effect, _, joint = label.partition(":")
        return Atom(effect, joint)

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
        except (asyncio.CancelledError, RuntimeError):  # the tab is gone, or the server ends
            raise
        except Exception as error:
            from pipeline.commands.unforeseen import report_unforeseen

            self._say(report_unforeseen(error))

    def _say(self, text: str) -> None:
        self._run(f"armdynBench.say({_json(text)}, 'bad')")

    def _busy(self, text: str) -> None:
        self._run(f"armdynBench.busy({_json(text)})")

    def _subtitle(self, text: str) -> None:
        self._panel("subtitle", escape(text))

    def _panel(self, place: str, html: str) -> None:
        self._run(f"armdynBench.panel({_json(place)}, {_json(html)})")

    def _run(self, code: str) -> None:
        self._client.run_javascript(code)


def _json(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))
