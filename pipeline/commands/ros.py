"""`armdyn twin`, `armdyn record`, `armdyn trial --robot ros`: a simulated Baxter, recordings and trials behind ROS."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.errors import InputError
from pipeline.commands.output import JsonOption, answered, check_outputs, phase_progress, to_screen, write_json
from pipeline.commands.trial import end_with, parse_hidden, say_result, write_report

if TYPE_CHECKING:
    from pipeline.ros.master import Figures
    from pipeline.trial import ProtocolSettings
    from pipeline.trial.real import Asking, Link, RealTrial


RosOption = Annotated[str, typer.Option("--ros", help="Address of the rosbridge, ws://HOST:9090.")]
ArmOption = Annotated[
    str, typer.Option("--arm", help="The arm behind it: a known robot, or a settings file with a table for ROS.")
]
TWIN_LENGTH = 0.368


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command()(twin)
    app.command()(record)


def twin(
    ros: RosOption,
    hidden: Annotated[
        list[str] | None, typer.Option(help="EFFECT or EFFECT=VALUE that the twin has and no model knows.")
    ] = None,
    length: Annotated[float, typer.Option(help="True length, pivot to the load's centre [m].")] = TWIN_LENGTH,
    seed: Annotated[int, typer.Option(help="Of everything random.")] = 0,
    start: Annotated[
        str | None, typer.Option(help="Joint positions at the start in rad, separated by commas; else s = 0.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Where to write the calibration of its load cell (TOML), for 'armdyn trial'.")
    ] = None,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="End after this long; else with Ctrl-C.")] = None,
    json_file: JsonOption = None,
) -> None:
    """The simulated Baxter behind Baxter's own topics, in real time, its load cell on a pseudo-terminal."""
    import time
    from dataclasses import replace

    import numpy as np

    import ik
    import urdf
    from armdyn.errors import InputError, TaskFailedError
    from pipeline.commands.which_robot import exactly
    from pipeline.interrupts import noted_signals
    from pipeline.robot.settings import PlantSettings
    from pipeline.ros.topics import read_topics, settings_file
    from pipeline.ros.twin import Twin

    check_outputs(json_file, calibration)
    arm = urdf.load("baxter")
    posture = ik.default_table(arm).posture(0.0).q
    if start is not None:
        posture = np.array(exactly(len(arm.joint_names), start, "--start"))
    if seed < 0:
        raise InputError(f"--seed {seed}: give a whole number from 0 on")
    plant = replace(PlantSettings(), length=length)
    ends: list[int] = []
    topics = read_topics(settings_file("baxter"))
    with Twin(ros, arm, topics, posture, plant, parse_hidden(hidden or []), seed) as robot:
        if calibration is not None:
            robot.calibration.save(calibration)
        typer.echo(f"loadcell {robot.port.port}")
        typer.echo("READY")
        end = None if seconds is None else time.monotonic() + seconds
        with noted_signals(ends.append):
            robot.run(
                lambda: bool(ends) or robot.bridge.failure is not None or (end is not None and time.monotonic() >= end)
            )
        lost = robot.bridge.failure
        answer = robot.summary()
    if json_file is not None:
        write_json(answer, json_file)
    if lost is not None:
        raise TaskFailedError(f"{lost}; the twin has ended")


def record(
    ros: RosOption,
    output: Annotated[Path, typer.Option("--output", "--out", help="The run to write (CSV, and TOML beside it).")],
    seconds: Annotated[float, typer.Option(min=0.1, help="How long [s].")] = 30.0,
    arm: ArmOption = "baxter",
    loadcell: Annotated[str | None, typer.Option(help="Serial port of the load cell; none if not given.")] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="What 'armdyn loadcell calibrate' wrote; your settings if not given.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Record joint states and load cell of a ROS robot as a run for 'compare' and 'repair'; nothing is commanded."""
    import urdf
    from pipeline.commands.output import phase_progress
    from pipeline.ros.record import record_run
    from pipeline.ros.topics import read_topics, settings_file

    check_outputs(output, json_file)
    with phase_progress() as progress:
        run, said = record_run(
            ros,
            urdf.load(arm),
            read_topics(settings_file(arm)),
            output,
            seconds,
            loadcell,
            calibration,
            lambda share: progress("recording", share),
        )
    answer = {
        "schema": "armdyn.record/1",
        "output": str(output),
        "channels": {name: len(channel) for name, channel in run.channels.items()},
        "notes": list(said),
    }
    if answered(json_file, lambda: answer):
        say = to_screen().print
        say(f"{output}: {len(run.channels)} channels, {max(map(len, run.channels.values()))} samples", soft_wrap=True)
        for note in said:
            say(note, soft_wrap=True, markup=False)


def real_trial(
    settings: "ProtocolSettings",
    ros: str,
    arm: str,
    port: str | None,
    calibration: Path | None,
    out: Path,
    rehearsed: bool,
    yes: bool,
    landed: str | None,
    json_file: Path | None,
    note: str,
) -> None:
    """Run or rehearse a trial on a robot, and tell what came of it and `note`; exit status 1 where it did not land."""
    from pipeline.trial.real import rehearse, run_real

    link = _link(ros, arm, None if rehearsed else port, calibration)
    with phase_progress() as progress:
        asking = _asking(yes, landed, json_file)
        if rehearsed:
            figures, farthest = rehearse(settings, link, asking, progress)
        else:
            done = run_real(settings, link, asking, out, progress)
    if rehearsed:
        _show_rehearsal(figures, farthest, json_file)
        return
    _show(done, out, json_file, note)
    end_with(done.result)


def _link(ros: str, arm: str, port: str | None, calibration: Path | None) -> "Link":
    import urdf
    from pipeline.loadcell.calibration import Calibration, default_path
    from pipeline.ros.topics import read_topics, settings_file
    from pipeline.trial.real import Link

    topics = read_topics(settings_file(arm))
    used = None if port is None else Calibration.load(calibration or default_path())
    return Link(ros, urdf.load(arm), topics, port, used)


def _asking(yes: bool, landed: str | None, json_file: Path | None) -> "Asking":
    from pipeline.trial.real import Asking

    if landed not in (None, "yes", "no"):
        raise InputError(f"--landed {landed}: say 'yes' or 'no', or leave it out to be asked")

    def tell(sentence: str) -> None:
        typer.echo(sentence, err=json_file == Path("-"))

    def may_move(question: str) -> bool:
        if yes:
            tell(question.partition(" Is its space")[0])
            return True
        return typer.confirm(question, err=True)

    def has_landed() -> bool:
        if landed is not None:
            return landed == "yes"
        return typer.confirm("Did the load come to rest in the box?", err=True)

    return Asking(tell, may_move, has_landed)


def _show(done: "RealTrial", out: Path, json_file: Path | None, note: str) -> None:
    result = done.result
    answer: dict[str, Any] = {**result.as_json(), "robot": done.figures.as_json(), "nodes": _nodes(done)}
    if json_file is not None:
        write_json(answer, json_file)
    report = out / "report.html"
    told = write_report(done, report)
    if json_file != Path("-"):
        lines = filter(None, (note, *result.notes, *_timing(done.figures), told))
        say_result(result, lines, None if told else report)


def _show_rehearsal(figures: "Figures", farthest: float, json_file: Path | None) -> None:
    answer = {"schema": "armdyn.rehearsal/1", "tracking_error": farthest, "robot": figures.as_json()}
    if answered(json_file, lambda: answer):
        say = to_screen().print
        say(f"the arm followed the whole line; a joint was at most {farthest:.3f} rad from its command")
        for note in _timing(figures):
            say(note, soft_wrap=True, markup=False)


def _timing(figures: "Figures") -> list[str]:
    """What the commands and the states were like, in words."""
    from pipeline.ros.master import Spread

    told = []
    for what, values in (
        ("time between commands", figures.intervals),
        ("age of the joint states", figures.ages),
        ("command and back", figures.echoes),
    ):
        spread = Spread.of(tuple(values))
        if spread is not None:
            told.append(f"{what}: median {spread.milliseconds}")
    return told


def _nodes(done: "RealTrial") -> dict[str, Any]:
    """Computing time per node, and the cycles that it missed."""
    return {
        name: {"steps": t.steps, "mean": t.mean, "longest": t.longest, "late": t.overruns, "skipped": t.skipped}
        for name, t in done.result.timing.items()
    }
