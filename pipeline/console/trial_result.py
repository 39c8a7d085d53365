"""Run a trial on a real robot, and print and write the result of a simulated or real trial."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.errors import InputError
from pipeline.console.options import CalibrationOption
from pipeline.console.screen import (
    ProgressDisplay,
    progress_display,
    save_report,
    screen_console,
    write_json,
    write_json_if_file_given,
)
from pipeline.fields import attributes_as_json

if TYPE_CHECKING:
    from pipeline.robot.link import LinkStatistics
    from pipeline.trial import ProtocolSettings, SimulatedTrial
    from pipeline.trial.real import OperatorPrompts, RealTrial, RobotLink


@dataclass(frozen=True)
class RobotOptions:
    """Options that choose the robot of a trial: the simulated one, or a real one behind a driver."""

    robot: Annotated[
        str,
        typer.Option(
            help="'simulated', or a driver and the robot's address, such as its rosbridge: ros:ws://HOST:9090."
        ),
    ] = "simulated"
    ros: Annotated[
        str | None, typer.Option("--ros", help="With --robot ros: address of its rosbridge, ws://HOST:9090.")
    ] = None
    arm: Annotated[
        str,
        typer.Option(
            "--arm", help="With a real robot: name of a known robot, or a settings file with driver settings."
        ),
    ] = "baxter"
    loadcell: Annotated[str | None, typer.Option(help="With a real robot: serial port of the load cell.")] = None
    calibration: CalibrationOption = None
    rehearse: Annotated[
        bool, typer.Option("--rehearse", help="With a real robot: only move slowly along the line, without a load.")
    ] = False
    yes: Annotated[
        bool, typer.Option("--yes", help="With a real robot: move without asking for permission, for scripts.")
    ] = False
    landed: Annotated[
        str | None,
        typer.Option(
            help="With a real robot: whether the load landed in the box, yes or no; by default you are asked."
        ),
    ] = None

    def check(self, of_the_simulation: Mapping[str, object]) -> None:
        """Check that the options fit the chosen robot.

        Args:
            of_the_simulation: values of the options that only the simulated robot has, by name of the option.

        Raises:
            InputError: an option does not fit the robot, or the robot's address is missing.
        """
        if self.robot != "simulated":
            for option, value in of_the_simulation.items():
                if value:
                    raise InputError(f"{option}: only the simulated robot has it; leave it out, or leave out --robot")
            if self.robot == "ros" and self.ros is None:
                raise InputError("--robot ros: say where it is: --ros ws://HOST:9090")
            return
        for name in ("ros", "loadcell", "landed", "rehearse"):
            if getattr(self, name):
                raise InputError(f"--{name}: needs a real robot, such as --robot ros")

    def connection(self) -> "RobotLink":
        """Prepare the connection to the real robot and its load cell.

        Raises:
            InputError: the driver, the arm or the calibration cannot be used.
        """
        import urdf
        from pipeline.loadcell.calibration import Calibration, default_calibration_path
        from pipeline.robot.drivers import driver_and_address
        from pipeline.trial.real import RobotLink

        driver, where = driver_and_address(self.robot, self.ros)
        description = urdf.load(self.arm)
        connect = driver.reach(where, self.arm, description)
        port = None if self.rehearse else self.loadcell
        used = None if port is None else Calibration.load(self.calibration or default_calibration_path())
        return RobotLink(where, connect, description, port, used)

    def operator_prompts(self, json_file: Path | None) -> "OperatorPrompts":
        """Make the functions that inform and ask the operator of the robot; options may replace the answers.

        Raises:
            InputError: ``--landed`` is neither yes nor no.
        """
        from pipeline.trial.real import OperatorPrompts

        if self.landed not in (None, "yes", "no"):
            raise InputError(f"--landed {self.landed}: say 'yes' or 'no', or leave it out to be asked")

        def tell(sentence: str) -> None:
            typer.echo(sentence, err=json_file == Path("-"))

        def ask_permission_to_move(question: str) -> bool:
            if self.yes:
                tell(question.partition(" Is its space")[0])
            return self.yes or typer.confirm(question, err=True)

        def has_landed() -> bool:
            if self.landed is not None:
                return self.landed == "yes"
            return typer.confirm("Did the load come to rest in the box?", err=True)

        return OperatorPrompts(tell, ask_permission_to_move, has_landed)


def report_and_save_trial(
    done: "SimulatedTrial | RealTrial",
    out: Path,
    json_file: Path | None,
    answer: dict[str, Any],
    lines: Sequence[str] = (),
    *,
    known: str = "",
    note: str = "",
    draw: Callable[[ProgressDisplay], Sequence[Path]] = lambda _: (),
    always_report: bool = False,
) -> None:
    """Print and write the result of a trial.

    Args:
        done: the trial that ended.
        out: folder of its report.
        json_file: file of the JSON output.
        answer: the JSON output.
        lines: lines that are printed below the result.
        known: text that is printed before the guess of the length.
        note: text that is printed below the length.
        draw: function that makes pictures and returns their files.
        always_report: whether a report is written also if the trial was interrupted.

    Raises:
        typer.Exit: with status 1 if the load missed the box, 128 + n if signal n ended the trial.
        InputError: a file could not be written; the result was printed before.
    """
    result, report = done.result, out / "report.html"
    pictures: Sequence[Path] = ()
    unwritten = result.unwritten
    try:
        # The result is written first, so that a failing report (after a fault, on a full disk) cannot lose it.
        if json_file is not None:
            write_json(answer, json_file)
    except InputError as error:
        unwritten = unwritten or str(error)
    if result.signal is not None and not always_report:
        problem = "no report: who interrupts a trial wants it to end"
    else:
        with progress_display() as progress:
            progress("writing the report")
            try:
                problem = _report_problem(done, report)
                pictures = draw(progress)
            except InputError as error:
                problem, unwritten = "no report", unwritten or str(error)
    if json_file != Path("-"):
        say = screen_console().print
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
        files = f"{'' if problem else f'report {report}, '}recording {result.recording}"
        for line in filter(None, [*result.notes, *lines, problem, files, *(f"picture {drawn}" for drawn in pictures)]):
            say(line, soft_wrap=True)
        if result.repair_command is not None:
            say(f"what the model lacks: {result.repair_command}", soft_wrap=True)
    if result.signal is not None:
        raise typer.Exit(128 + result.signal)
    if unwritten:
        raise InputError(f"the trial went on to its end, but {unwritten}")
    if not result.success:
        raise typer.Exit(1)


def _report_problem(done: "SimulatedTrial | RealTrial", report: Path) -> str:
    """Write the report; after a stopped trial, return why this failed, if it did."""
    try:
        save_report(done.report(), report)
    except Exception as error:
        if not done.result.stopped:
            raise
        return f"no report: {type(error).__name__}: {' '.join(str(error).split())}"
    return ""


def real_trial(
    settings: "ProtocolSettings", options: RobotOptions, out: Path, json_file: Path | None, note: str
) -> None:
    """Run a trial, or a slow rehearsal without a load, on a real robot, and print its result.

    Args:
        settings: settings of the trial.
        options: options that choose the robot.
        out: folder for recording and report.
        json_file: file of the JSON output.
        note: text that is printed below the length.

    Raises:
        typer.Exit: with status 1 if the load missed the box, 128 + n if signal n ended the trial.
    """
    from pipeline.trial.real import rehearse, run_real_trial

    link = options.connection()
    with progress_display() as progress:
        prompts = options.operator_prompts(json_file)
        if not options.rehearse:
            done = run_real_trial(settings, link, prompts, out, progress)
        else:
            statistics, farthest = rehearse(settings, link, prompts, progress)
    if options.rehearse:
        answer = {"schema": "armdyn.rehearsal/1", "tracking_error": farthest, "robot": statistics.as_json()}
        if write_json_if_file_given(json_file, lambda: answer):
            say = screen_console().print
            say(f"the arm followed the whole line; a joint was at most {farthest:.3f} rad from its command")
            for text in _timing(statistics):
                say(text, soft_wrap=True, markup=False)
        return
    statistics = done.robot.statistics
    nodes = {
        name: attributes_as_json(t, "steps mean longest late=overruns skipped")
        for name, t in done.result.timing.items()
    }
    answer = {**done.result.as_json(), "robot": statistics.as_json(), "nodes": nodes}
    report_and_save_trial(done, out, json_file, answer, _timing(statistics), note=note, always_report=True)


def _timing(statistics: "LinkStatistics") -> list[str]:
    said = {
        "command_interval": "time between commands",
        "state_age": "age of the joint states",
        "command_echo": "command and back",
    }
    percentiles = statistics.percentiles
    return [f"{what}: median {spread.milliseconds}" for name, what in said.items() if (spread := percentiles[name])]
