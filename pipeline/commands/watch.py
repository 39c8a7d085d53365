"""The command `armdyn watch`: compare a model with its robot while the robot works, and report events."""

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.atomic import CrashSafeGrowingFile
from armdyn.errors import InputError
from armdyn.quoting import shell_quoted_command
from pipeline.console.options import ArmOption, EffectsOption, ModelArgument, NoBrowserOption, WrenchTopicOption
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import progress_display

if TYPE_CHECKING:
    from armdyn.watch.event import WatchEvent
    from armdyn.watch.fault_free import FaultFreeStatistics, JointSample
    from armdyn.watch.watch import Watch
    from pipeline.watch.log import SampleLog

HELP_PANEL = "Recordings"
STANDARD_STREAM = Path("-")


def watch(
    model: ModelArgument,
    runs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[RUN...]", help="Recordings or a folder of them; '-' for CSV lines on standard input."),
    ] = None,
    ros: Annotated[str | None, typer.Option("--ros", help="Address of the rosbridge, ws://HOST:9090.")] = None,
    arm: ArmOption = "baxter",
    wrench: WrenchTopicOption = None,
    calibrate: Annotated[
        list[Path] | None,
        typer.Option(
            "--calibrate",
            help="A recording of the robot in good condition, from which the thresholds are computed; may be repeated.",
        ),
    ] = None,
    false_alarms_per_hour: Annotated[
        float, typer.Option(min=1e-6, max=100.0, help="Accepted rate of false alarms for a robot in good condition.")
    ] = 0.01,
    changes: Annotated[
        str | None,
        typer.Option(
            metavar="EFFECT[:JOINT,...]",
            help="Further effects whose changes are told; join several by '+'. Friction, offset and gain are anyway.",
        ),
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="File for a recording of the samples; after a change a new file is begun.")
    ] = None,
    page: Annotated[
        bool, typer.Option("--page", help="Show residuals, tolerance bands and events on a web page.")
    ] = False,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the web page; by default any free port.")
    ] = None,
    no_browser: NoBrowserOption = False,
    effects: EffectsOption = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="File with one line of JSON per event; '-' is standard output.")
    ] = None,
) -> None:
    """Compare a repaired model with its arm at work, and report contacts, loads and changes. The arm is not moved.

    Exit status 1 if no sample could be watched.
    """
    from armdyn.arm.model import required_arm
    from armdyn.effects.catalogue import find_several
    from armdyn.effects.user import load_effects
    from armdyn.errors import error_location
    from armdyn.model_file import read_model_file
    from armdyn.watch.channels import WatchedChannels
    from armdyn.watch.fault_free import statistics_of_model_error, statistics_of_recordings
    from armdyn.watch.watch import Watch
    from pipeline.ros.bridge import RosBridge
    from pipeline.ros.wrenches import chosen_wrench_topics, topics_with_wrenches
    from pipeline.watch.log import SampleLog
    from pipeline.watch.sources import read_arm_runs, recordings_in, sample_sources

    runs, calibrate, topics = runs or [], recordings_in(calibrate or []), chosen_wrench_topics(wrench or ())
    if (ros is None) == (not runs) or (STANDARD_STREAM in runs and len(runs) > 1):
        raise InputError("a watch needs one source: recordings, '-' for standard input, or --ros ws://HOST:9090")
    if topics and ros is None:
        raise InputError("--wrench names a topic: it needs --ros ws://HOST:9090; recordings contain their sensors")
    live = ros is not None or runs == [STANDARD_STREAM]
    files = [] if live else recordings_in(runs)
    check_outputs(log, json_file, inputs=[model, *files, *calibrate])
    with progress_display() as say:
        own = load_effects(effects, stages=None)
        file = read_model_file(model, own)
        given = required_arm(file.model, f"{model}: a watch is", "'armdyn compare' takes it")
        sound_runs, watched = read_arm_runs(given, calibrate), read_arm_runs(given, files)
        given = given.adapted_to([*sound_runs, *watched])
        further = find_several(changes, own) if changes is not None else ()
        if unknown := topics.keys() - given.sensors:
            raise InputError(
                f"--wrench {min(unknown)}: {model} has no such force/torque sensor; it has "
                f"{', '.join(given.sensors) or 'none'}: see docs/wrench.md"
            )
        sensed = None if ros is None else topics
        channels = WatchedChannels.of(given, [*sound_runs, *watched], sensed=sensed)
        say("measuring a sound robot")
        with error_location(model):
            if sound_runs:
                sources = sample_sources(given, sound_runs, channels)
                sound = statistics_of_recordings(given, sources, further, channels)
            else:
                sound = statistics_of_model_error(given, file.history, further, channels)
        say("preparing")
        watching = Watch(given, sound, false_alarms_per_hour)
    with ExitStack() as stack:
        kept = SampleLog(log, channels) if log is not None else None
        out = _Out(model, effects, json_file, sound, stack)
        for sensor in given.sensors.keys() - {*channels.sensors}:
            why = "a recording lacks it"
            if ros is not None and sensor not in topics:
                with RosBridge(ros) as bridge:
                    why = f"add --wrench {sensor}=TOPIC; {topics_with_wrenches(bridge)}"
            out.note(f"The wrench of the sensor {sensor} is not watched: {why}.")
        if kept is not None:
            stack.callback(kept.close)
        shown = None
        if page:
            from pipeline.watch.page import LivePage

            shown = stack.enter_context(LivePage(watching, port))
            out.note(f"watching at {shown.address}")
            if not no_browser and sys.stdout.isatty():
                shown.open()
        ended, recorded = threading.Event(), [*zip(files, sample_sources(given, watched, channels), strict=True)]
        for name, samples in _sources(watching, ros, arm, topics, recorded, ended):
            out.source, heard = name, time.monotonic()
            watching.begin_source()
            for sample in samples:
                found = watching.process_sample(*sample) if sample is not None else []
                if watching.coverage.is_watching and sample is not None:
                    heard = time.monotonic()
                elif live:
                    found += watching.wait(time.monotonic() - heard)
                if kept is not None and sample is not None:
                    kept.write(sample)
                if shown is not None:
                    shown.take(found)
                for event in found:
                    out.report(event, kept)
        out.end(watching, files)
        if shown is not None and ros is None and not ended.is_set():
            shown.stay(out.note)
    for written in (kept, out.file):
        if written is not None and written.failure is not None:
            raise InputError(f"the watch went on to its end, but {written.failure}")
    if not watching.coverage.watched:
        raise typer.Exit(1)


def _sources(
    watching: "Watch",
    ros: str | None,
    arm: str,
    wrenches: Mapping[str, str],
    recorded: "list[tuple[Path, Callable[[], Iterator[JointSample]]]]",
    ended: threading.Event,
) -> "Iterator[tuple[Path | None, Iterator[JointSample | None]]]":
    """Yield each source of samples: the recording's file, or None for a live source, and its samples.

    A signal that ends standard input sets `ended`.
    """
    from pipeline.watch.sources import samples_from_lines

    if ros is not None:
        from pipeline.ros.topics import read_topics, settings_file
        from pipeline.watch.ros_source import RosSampleSource

        topic = read_topics(settings_file(arm)).joint_states
        yield None, RosSampleSource(ros, topic, watching.channels, wrenches).samples()
    elif recorded:
        for file, samples in recorded:
            yield file, samples()
    else:
        if sys.stdin is None:
            raise InputError("standard input is closed: give recordings, or write lines to it")
        yield None, samples_from_lines(sys.stdin, watching.channels, ended=ended)


class _Out:
    """Prints each event as a sentence, or as a line of JSON."""

    def __init__(
        self, model: Path, effects: Path | None, json_file: Path | None, sound: "FaultFreeStatistics", stack: ExitStack
    ) -> None:
        self._model, self._effects, self._sound = model, effects, sound
        self._quiet = json_file == STANDARD_STREAM
        self.file = None
        if json_file is not None and not self._quiet:
            self.file = CrashSafeGrowingFile(json_file)
            stack.callback(self.file.finish)
        self.source: Path | None = None
        self._events = 0
        self._changed: Path | None = None
        self.note(sound.sentence)

    def note(self, sentence: str) -> None:
        """Print a sentence, unless JSON uses standard output."""
        if not self._quiet:
            typer.echo(sentence)
            sys.stdout.flush()

    def report(self, event: "WatchEvent", kept: "SampleLog | None") -> None:
        """Report an event; after a change, start a new log file and print the command for a repair."""
        from armdyn.watch.event import EventKind

        self._events += 1
        self._write({**event.answer, **({} if self.source is None else {"run": str(self.source)})})
        where = "" if self.source is None else f"{self.source}: "
        self.note(f"{where}{event.time:.2f} s: {event.sentence}")
        if event.kind in (EventKind.LOAD_CHANGED, EventKind.ROBOT_CHANGED):
            self._changed = self.source
            if kept is not None:
                kept.next_file()
                self.note(f"to repair the model from here on: {self._repair([kept.file])}")

    def end(self, watching: "Watch", files: list[Path]) -> None:
        """Print the summary, and the command for a repair with the files after a change."""
        from armdyn.watch.event import EVENT_SCHEMA

        seen = watching.coverage
        answer = {
            "schema": EVENT_SCHEMA, "event": "summary", "watched": round(seen.watched, 6),
            "skipped": seen.skipped.total(), "reasons": seen.reasons,
            "false_alarms_per_hour": watching.false_alarms_per_hour,
        }  # fmt: skip
        self._write(answer)
        self.note(f"{seen.sentence}.")
        if not seen.watched:
            return self.note("Nothing was watched: whether something happened is unknown.")
        count = f"{self._events} event{'s' * (self._events != 1)}"
        self.note(f"{count}, at {self._rate()}." if self._events else f"Nothing happened, at {self._rate()}.")
        after = files[files.index(self._changed) + 1 :] if self._changed in files else []
        if after:
            self.note(f"to repair the model with what came after: {self._repair(after)}")

    def _write(self, answer: Mapping[str, Any]) -> None:
        line = json.dumps(answer, allow_nan=False) + "\n"
        if self._quiet:
            sys.stdout.write(line)
            sys.stdout.flush()
        elif self.file is not None:
            self.file.write(line)

    def _rate(self) -> str:
        extrapolated = "" if self._sound.seconds is None else ", extrapolated from the sound recordings"
        return f"the rate of false alarms that was requested{extrapolated}"

    def _repair(self, files: list[Path]) -> str:
        own = ["--effects", self._effects] if self._effects is not None else []
        return shell_quoted_command("repair", self._model, *files, *own)
