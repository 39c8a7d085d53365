"""Controls of the workbench's page (buttons, check boxes, sliders), and the actions that they start."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from nicegui import Client, events, ui

from armdyn.errors import InputError
from pipeline.console.inputs import ModelAndRunInputs
from pipeline.report.page import template_text
from pipeline.workbench import files, panels
from pipeline.workbench.background import (
    SearchProcess,
    SearchWork,
    WorkbenchComputingThread,
    run_diagnosis,
    run_discovery,
)
from pipeline.workbench.tab import BrowserTab, OpenSession, scene_of_run
from urdf.bounds import MAX_UPLOAD_BYTES
from urdf.loader import known_robots

REFIT_DELAY_AFTER_CLICK_SECONDS = 0.25
"""Time without another click after which a refit begins [s], because a refit delays the answers to clicks."""


class WorkbenchPage(BrowserTab):
    """A browser tab of the workbench with its controls.

    Args:
        client: NiceGUI's connection to the tab.
        inputs: files that the command named; None for none.
        open_session: function that returns the computing thread for some files.
        writable: check of the files that the user saves.
    """

    def __init__(
        self,
        client: Client,
        inputs: ModelAndRunInputs | None,
        open_session: OpenSession,
        writable: files.WritableFileCheck,
    ) -> None:
        super().__init__(client, inputs, open_session)
        self._writable = writable
        self._kept: Path | None = None
        self._build()

    def _build(self) -> None:
        skeleton = Template(template_text("workbench", "workbench.html"))
        robots = "".join(f"<option>{name}</option>" for name in known_robots())
        ui.html(skeleton.substitute(robots=robots, kinds=panels.export_options_html()), sanitize=False)
        label = "Drop recordings, a model or a URDF here, or choose files with +"
        upload = ui.upload(
            label=label, multiple=True, auto_upload=True, max_file_size=MAX_UPLOAD_BYTES,
            on_multi_upload=self._guarded_event(self._dropped),
            on_rejected=lambda: self._call("say", "A file is too large: record for a shorter time.", "bad"),
        ).props("flat")  # fmt: skip
        upload.classes("drop").props('id="drop"')
        self._uploader = upload
        handlers: dict[str, Callable[[dict[str, Any]], Awaitable[None]]] = {
            "pick": self._pick, "every": self._every, "try": lambda args: self._add([str(args["label"])]),
            "clear": lambda _: self._tick([], by_click=False), "refit": lambda _: self._tick(list(self._ticked)),
            "knob": self._knob, "role": self._role, "scene": self._scene, "search": self._look, "stop": self._stop,
            "discover": self._discover, "start-pendulum": self._pendulum, "start-arm": self._arm, "keep": self._keep,
            "go-on": self._go_on, "trust": self._trusted,
        }  # fmt: skip
        for name, handler in handlers.items():
            ui.on(name, self._guarded_event(handler))

    async def begin(self) -> None:
        """Show the files that the command named, after the browser has connected."""
        self._client.run_javascript(
            "document.querySelector('section[aria-label=Files]').append(document.getElementById('drop'))"
        )
        await self._guarded(self._reopen())

    async def _pick(self, args: dict[str, Any]) -> None:
        label = str(args["label"])
        await self._tick([*(other for other in self._ticked if other != label), *([label] if args["on"] else [])])

    async def _every(self, args: dict[str, Any]) -> None:
        mine = [label for label, one in self._opened().bench.candidates.items() if one.effect == args["effect"]]
        rest = [label for label in self._ticked if label not in mine]
        await self._tick(rest if set(mine) <= set(self._ticked) else [*rest, *mine], by_click=False)

    async def _add(self, labels: Sequence[str]) -> None:
        new = []
        for effect, colon, joints in (label.partition(":") for label in labels):
            new += [f"{effect}{colon}{joint}" for joint in joints.split(",")]
        await self._tick([*(label for label in self._ticked if label not in new), *new], by_click=False)

    async def _tick(self, effects: list[str], *, by_click: bool = True) -> None:
        bench = self._opened().bench
        self._ticked, self._values = tuple(effects), {}
        if not by_click:
            self._call("ticks", effects)
        self._asked += 1
        asked = self._asked
        state = bench.predict(self._ticked)
        self._show(state)
        await self._show_missing_force(state)
        if not effects:
            return
        await asyncio.sleep(REFIT_DELAY_AFTER_CLICK_SECONDS)
        if asked != self._asked:
            return
        fitted = await self._working("refitting", lambda: bench.refit(self._ticked) if asked == self._asked else None)
        if fitted is not None and asked == self._asked:
            self._show(fitted)
            await self._show_missing_force(fitted)
            await self._show_motion(self._ticked)

    async def _knob(self, args: dict[str, Any]) -> None:
        session, _, bench = self._opened()
        self._values[str(args["name"])] = float(args["value"])
        self._asked += 1
        try:
            values = dict(self._values)
            state = await session.do(lambda: bench.with_values(self._ticked, values))
            self._show(state, knobs=False)
        finally:
            self._call("turned")
        await self._show_missing_force(state)

    async def _look(self, _: dict[str, Any]) -> None:
        self._begin(run_diagnosis, self._ranked)

    async def _discover(self, _: dict[str, Any]) -> None:
        self._begin(run_discovery, self._proposed)
        self._call("panel", "proposal", "Looking for a formula; the progress is under 'What is missing'.")

    def _begin(self, work: SearchWork, done: Callable[[Any], Awaitable[None]]) -> None:
        session, _given, bench = self._opened()
        self._stop_search()
        loop = asyncio.get_running_loop()

        def tell(kind: str, what: Any) -> None:  # called from another thread
            if not loop.is_closed():
                asyncio.run_coroutine_threadsafe(self._guarded(self._heard(session, kind, what, done)), loop)

        self._call("panel", "proposal", "")
        self._call("panel", "ranking", "<p class='busy' id='progress'>starting the search</p>")
        self._call("show", "stop", True)
        labels = [effect.label for effect in bench.effects_of(self._ticked)]
        self._search = SearchProcess(work, session.inputs, labels, tell)

    async def _heard(
        self, asked: WorkbenchComputingThread, kind: str, what: Any, done: Callable[[Any], Awaitable[None]]
    ) -> None:
        if asked is not self._session:
            return
        if kind == "progress":
            self._call("panel", "progress", escape(what))
            return
        self._call("show", "stop", False)
        if kind == "done":
            await done(what)
        else:
            self._call("panel", "proposal", "")
            self._call("panel", "ranking", f"<p class='caption'>{escape(what)}</p>")

    async def _ranked(self, answer: Mapping[str, Any]) -> None:
        self._call("panel", "ranking", panels.ranking_panel(answer))

    async def _proposed(self, answer: Mapping[str, Any]) -> None:
        ticked = self._ticked
        if answer["text"]:
            self._own_effects = files.write_discovered_laws(
                Path(self._folder.name), self._own_effects, str(answer["text"])
            )
            await self._reopen()
            self._ticked = ticked
        sentence = escape(answer["sentence"])
        self._call("panel", "proposal", sentence)
        self._call("panel", "ranking", f"<p class='caption'>{sentence}</p>")
        if answer["labels"]:
            await self._add(answer["labels"])

    async def _stop(self, _: dict[str, Any]) -> None:
        self._stop_search()
        self._call("show", "stop", False)
        self._call("panel", "proposal", "")
        self._call("panel", "ranking", "<p class='caption'>The search was stopped.</p>")

    async def _scene(self, args: dict[str, Any]) -> None:
        bench, name, ticked = self._opened().bench, args.get("run"), self._ticked
        scene = await self._working("drawing in 3-D", lambda: scene_of_run(bench, ticked, name).data())
        self._call("scene", scene)

    async def _role(self, args: dict[str, Any]) -> None:
        i = int(args["run"])
        path, _ = self._runs[i]
        kept = [] if args["role"] == "leave out" else [(path, args["role"] == "hold out")]
        self._runs[i : i + 1] = kept
        await self._reopen()

    async def _trusted(self, _: dict[str, Any]) -> None:
        self._trust = True
        await self._reopen()

    async def _pendulum(self, args: dict[str, Any]) -> None:
        self._model = files.write_pendulum_model(Path(self._folder.name), str(args["mass"]), str(args["length"]))
        await self._reopen()

    async def _arm(self, args: dict[str, Any]) -> None:
        folder, robot = Path(self._folder.name), str(args["robot"])
        self._model = await asyncio.to_thread(files.write_known_arm_model, folder, robot)
        await self._reopen()

    async def _dropped(self, event: events.MultiUploadEventArguments) -> None:
        joints = tuple(getattr(self._open.bench.study.model, "joints", ())) if self._open else ()
        problems = []
        # Models come first: their joints name the columns of recordings.
        for file in sorted(event.files, key=lambda file: not file.name.lower().endswith((".urdf", ".xml", ".toml"))):
            try:
                path = files.dropped_file_path(Path(self._folder.name), file.name)
                await file.save(path)
                found = await asyncio.to_thread(files.read_dropped, path, joints)
            except InputError as error:
                problems.append(str(error).replace(f"{self._folder.name}/", ""))
                (Path(self._folder.name) / Path(file.name).name).unlink(missing_ok=True)  # no model may name it
                continue
            self._said.append(found.said)
            if found.kind == "model":
                self._model = found.path
            elif found.kind == "run":
                self._runs = [(p, held) for p, held in self._runs if p != found.path] + [(found.path, False)]
        self._uploader.reset()
        await self._reopen()
        if problems:
            self._call("say", "; ".join(problems), "bad")

    async def _keep(self, args: dict[str, Any]) -> None:
        session, given, bench = self._opened()
        if not self._ticked:
            raise InputError("nothing is ticked: the model is as given; tick an effect first")
        model = Path(str(args["model"]).strip() or "repaired.toml").expanduser()
        report = model.with_suffix(".html") if args["report"] else None
        ending = str(args["export"])
        exported = model.with_suffix(ending) if ending else None
        ticked, over = self._ticked, bool(args["over"])
        kept = await self._working(
            "fitting and writing",
            lambda: files.save_model(
                session.inputs, given, bench, ticked, model, report, exported, writable=self._writable, over=over
            ),
        )
        self._kept = model
        lines = [f"<p class='sentence'>{escape(kept.sentence)}</p>"]
        lines += [f"<p class='caption'>written to {escape(str(path.resolve()))}</p>" for path in kept.files]
        lines += [f"<p class='caption'>not in it: {escape(note)}</p>" for note in kept.notes]
        lines.append(f"<p class='next'>next:<code>{escape(kept.next_step)}</code></p>")
        lines.append("<button type='button' id='go-on'>go on from this model</button>")
        self._call("panel", "kept", "".join(lines))

    async def _go_on(self, _: dict[str, Any]) -> None:
        self._model = self._kept
        await self._reopen()
