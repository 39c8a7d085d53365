"""Result, report and exit status of a simulated or real trial, and the conduct of a real one."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from armdyn.errors import InputError
from pipeline.console.screen import Say, save_report, spinner, to_screen, write_answer, write_json
from pipeline.fields import fields

if TYPE_CHECKING:
    from pipeline.robot.link import LinkStatistics
    from pipeline.trial import ProtocolSettings, SimulatedTrial, TrialResult
    from pipeline.trial.real import Link, OperatorPrompts, RealTrial


def conclude_trial(
    done: "SimulatedTrial | RealTrial",
    out: Path,
    json_file: Path | None,
    answer: dict[str, Any],
    lines: Iterable[str],
    *,
    known: str = "",
    note: str = "",
    draw: Callable[[Say], Sequence[Path]] = lambda _: (),
    always_report: bool = False,
) -> None:
    """Write and print a trial's result; exit status 1 where the load missed, 128 + n where signal n ended it.

    Args:
        done: the trial that ended.
        out: folder of its report.
        json_file: file of the answer.
        answer: answer for JSON.
        lines: lines printed below the result's message.
        known: text before the guess of the length.
        note: text below the length.
        draw: function that makes pictures.
        always_report: whether an interrupted trial gets a report, as a trial on a real robot cannot be repeated.
    """
    result, report = done.result, out / "report.html"
    # The result is written first, so that a failing report (after a fault, on a full disk) cannot lose it.
    if json_file is not None:
        write_json(answer, json_file)
    pictures: Sequence[Path] = ()
    if result.signal is not None and not always_report:
        problem = "no report: who interrupts a trial wants it to end"
    else:
        with spinner() as progress:
            progress("writing the report")
            problem = _report_problem(done, report)
            pictures = draw(progress)
    if json_file != Path("-"):
        files = f"{'' if problem else f'report {report}, '}recording {result.recording}"
        below = [*result.notes, *lines, problem, files, *(f"picture {drawn}" for drawn in pictures)]
        _say_result(result, filter(None, below), known, note)
    if result.signal is not None:
        raise typer.Exit(128 + result.signal)
    if not result.success:
        raise typer.Exit(1)


def _say_result(result: "TrialResult", below: Iterable[str], known: str, note: str) -> None:
    say = to_screen().print
    if result.estimates:
        say(
            f"length {result.length_estimate:.4f} m +/- {1e3 * result.length_std:.2f} mm "
            f"({known}guess {result.length_guess:g} m)"
        )
    if note:
        say(note)
    if result.investigation is not None:
        for number, stage in enumerate(result.investigation.stages, start=1):
            say(f"experiment {number}: {stage.diagnosis.sentence}")
        say(result.investigation.sentence)
    say(result.message, style=f"bold {'green' if result.success else 'red'}")
    for line in below:
        say(line, soft_wrap=True)
    if result.repair_command is not None:
        say(f"what the model lacks: {result.repair_command}", soft_wrap=True)


def _report_problem(done: "SimulatedTrial | RealTrial", report: Path) -> str:
    """Write the report; returns why it could not be made where the same fault stopped the trial, otherwise empty."""
    try:
        save_report(done.report(), report)
    except Exception as error:
        if not done.result.stopped:
            raise
        return f"no report: {type(error).__name__}: {' '.join(str(error).split())}"
    return ""


def real_trial(
    settings: "ProtocolSettings",
    robot: str,
    address: str | None,
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
    """Run or rehearse a trial on a robot, and print its result and `note`; exit status 1 where the load missed."""
    from pipeline.trial.real import rehearse, run_real

    link = _link(robot, address, arm, None if rehearsed else port, calibration)
    with spinner() as progress:
        prompts = _prompts(yes, landed, json_file)
        if rehearsed:
            statistics, farthest = rehearse(settings, link, prompts, progress)
        else:
            done = run_real(settings, link, prompts, out, progress)
    if rehearsed:
        _show_rehearsal(statistics, farthest, json_file)
        return
    statistics = done.robot.statistics
    answer = {**done.result.as_json(), "robot": statistics.as_json(), "nodes": _nodes(done)}
    conclude_trial(done, out, json_file, answer, _timing(statistics), note=note, always_report=True)


def _link(robot: str, address: str | None, arm: str, port: str | None, calibration: Path | None) -> "Link":
    import urdf
    from pipeline.loadcell.calibration import Calibration, default_path
    from pipeline.robot.drivers import driver_at
    from pipeline.trial.real import Link

    driver, where = driver_at(robot, address)
    description = urdf.load(arm)
    connect = driver.reach(where, arm, description)
    used = None if port is None else Calibration.load(calibration or default_path())
    return Link(where, connect, description, port, used)


def _prompts(yes: bool, landed: str | None, json_file: Path | None) -> "OperatorPrompts":
    from pipeline.trial.real import OperatorPrompts

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

    return OperatorPrompts(tell, may_move, has_landed)


def _show_rehearsal(statistics: "LinkStatistics", farthest: float, json_file: Path | None) -> None:
    answer = {"schema": "armdyn.rehearsal/1", "tracking_error": farthest, "robot": statistics.as_json()}
    if write_answer(json_file, lambda: answer):
        say = to_screen().print
        say(f"the arm followed the whole line; a joint was at most {farthest:.3f} rad from its command")
        for note in _timing(statistics):
            say(note, soft_wrap=True, markup=False)


def _timing(statistics: "LinkStatistics") -> list[str]:
    """Sentence about the timing of the commands and of the states."""
    said = {
        "command_interval": "time between commands",
        "state_age": "age of the joint states",
        "command_echo": "command and back",
    }
    spreads = statistics.spreads
    return [f"{what}: median {spread.milliseconds}" for name, what in said.items() if (spread := spreads[name])]


def _nodes(done: "RealTrial") -> dict[str, Any]:
    """Lines with the computing time and the missed cycles of each node."""
    return {name: fields(t, "steps mean longest late=overruns skipped") for name, t in done.result.timing.items()}
