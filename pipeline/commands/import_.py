"""The command `armdyn import`: convert recordings in other formats to runs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from armdyn import atomic
from armdyn.errors import InputError
from armdyn.quoting import shell_quoted_command
from pipeline.console.import_proposal import column_map_json, print_proposal
from pipeline.console.inputs import exit_on_wrong_recording
from pipeline.console.options import JsonOption, RobotChoice, TrustOption
from pipeline.console.outputs import check_outputs, check_overwrite, write_runs
from pipeline.console.screen import (
    print_document,
    progress_display,
    write_json_if_file_given,
)

if TYPE_CHECKING:
    from armdyn.run import Run
    from pipeline.imports.conversion import ImportedRun
    from pipeline.imports.foreign import ForeignRecording
    from pipeline.imports.joints import RobotJoints
    from pipeline.imports.register_entries import DriveKinds

HELP_PANEL = "Recordings"


@dataclass(frozen=True)
class ImportOptions:
    """Arguments and options of the command `import`."""

    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="CSV, Parquet, ROS bag (.bag, .mcap, .db3, directory), LeRobot data set."
        ),
    ]
    output: Annotated[
        Path, typer.Option("--output", "--out", metavar="DIR", help="Directory for the runs; it is created.")
    ]
    mapping: Annotated[
        Path | None, typer.Option("--map", help="TOML file that says which column is which channel.")
    ] = None
    confirm: Annotated[
        bool, typer.Option("--confirm", help="With --map: every guess in it is right, whatever its 'check' asks.")
    ] = False
    guess: Annotated[
        bool,
        typer.Option("--guess", help="Propose such a file from names, units and ranges; nothing is imported."),
    ] = False
    commands: Annotated[
        Path | None,
        typer.Option(
            "--commands",
            metavar="FILE",
            help="Commands of the joints, in a file of its own with its own stamps; a command holds until the next.",
        ),
    ] = None
    rate: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="Rows per second of tables without time stamps.")
    ] = None
    drive: Annotated[
        list[str] | None,
        typer.Option(
            "--drive",
            help="Joints whose columns are raw registers of a servo, such as Present_Position: sts3215=all, or "
            "xl330=joint,joint; may be repeated.",
        ),
    ] = None
    force: Annotated[bool, typer.Option("--force", help="Overwrite runs that exist.")] = False

    def __post_init__(self) -> None:
        if self.confirm and self.mapping is None:
            raise InputError("--confirm takes the guesses of a mapping as right: give the mapping with --map")
        if self.mapping is not None and self.guess:
            raise InputError("--map gives a mapping and --guess proposes one: choose one of them")
        if self.mapping is not None and self.drive:
            raise InputError("--map states what registers mean, and --drive does: leave one of them out")

    @property
    def drives(self) -> "DriveKinds":
        """Kinds of drives whose registers the columns are."""
        from pipeline.imports.register_entries import DriveKinds

        return DriveKinds.of(self.drive or ())

    @property
    def rate_text(self) -> str:
        """The rate with its unit, as a mapping file contains it; empty if it is not given."""
        return "" if self.rate is None else f"{self.rate:.12g} Hz"


def import_(
    wanted: ImportOptions, choice: RobotChoice, trust_data: TrustOption = False, json_file: JsonOption = None
) -> None:
    """Convert recordings in other formats to runs, and inspect them; a robot gives the names of the joints."""
    from pipeline.imports import read_foreign
    from pipeline.imports.conversion import single_recording_of_commands
    from pipeline.imports.mapping import check_table_sample_rate

    check_table_sample_rate(wanted.rate_text)
    check_outputs(json_file)
    with exit_on_wrong_recording(json_file), progress_display() as say:
        recordings: list[ForeignRecording] = []
        for file in wanted.files:
            say(f"reading {file}")
            recordings += read_foreign(file)
        commands = read_foreign(wanted.commands) if wanted.commands is not None else None
        if wanted.guess:
            told = single_recording_of_commands(commands, recordings) if commands is not None else None
            _propose(wanted, recordings, told, choice, json_file)
        else:
            say("looking at the recordings")
            _import(wanted, recordings, commands, choice, trust_data, json_file)


def _import(
    wanted: ImportOptions,
    recordings: "list[ForeignRecording]",
    commands: "list[ForeignRecording] | None",
    choice: RobotChoice,
    trust_data: bool,
    json_file: Path | None,
) -> None:
    from armdyn.arm.model import arm_model
    from armdyn.inspection.check import Inspection, sorted_by_severity
    from armdyn.inspection.inspect import inspect_runs, require_usable
    from pipeline.answers import recording_checks_json
    from pipeline.imports.conversion import runs_from_recordings
    from pipeline.imports.mapping import read_map
    from pipeline.report.inspection import inspection_document

    mappings = read_map(wanted.mapping) if wanted.mapping is not None else None
    if mappings is not None and wanted.confirm:
        mappings = {name: each.confirmed for name, each in mappings.items()}
    found = runs_from_recordings(recordings, mappings, _joints(choice), wanted.drives, commands, wanted.rate_text)
    looked = inspect_runs([each.run for each in found], arm_model(choice.urdf_file, choice.robot) if choice else None)
    checks = sorted_by_severity([*(c for each in found for c in each.checks), *looked.checks])
    if not trust_data:
        require_usable(Inspection(looked.runs, checks))
    written = _write([each.run for each in found], wanted)
    if write_json_if_file_given(
        json_file, lambda: {**_answer(found, written), "recording_checks": recording_checks_json(checks)}
    ):
        if checks:
            print_document(inspection_document(Inspection(looked.runs, checks)))
        _say(found, written, choice, wanted.drive or ())


def _joints(choice: RobotChoice) -> "RobotJoints | None":
    from armdyn.arm.arm import load_arm_description
    from pipeline.imports.joints import RobotJoints

    return RobotJoints.of(load_arm_description(choice.urdf_file, choice.robot).robot) if choice else None


def _write(runs: "list[Run]", wanted: ImportOptions) -> list[Path]:
    paths = [wanted.output / f"{run.name}.csv" for run in runs]
    twice = {path.name for path in paths if paths.count(path) > 1}
    if twice:
        raise InputError(f"several recordings would become {sorted(twice)[0]}: import them one by one, or rename them")
    given = {path.resolve() for path in (*wanted.files, wanted.mapping, wanted.commands) if path is not None}
    for path in paths:
        if not given.isdisjoint((path.resolve(), path.with_suffix(".toml").resolve())):
            raise InputError(f"{path} would take the place of what is imported: choose another --output")
    write_runs(dict(zip(paths, runs, strict=True)), wanted.force)
    return paths


def _propose(
    wanted: ImportOptions,
    recordings: "list[ForeignRecording]",
    commands: "ForeignRecording | None",
    choice: RobotChoice,
    json_file: Path | None,
) -> None:
    from armdyn.recording.channels import is_auxiliary
    from pipeline.imports.guess import guess_commands, guess_map
    from pipeline.imports.mapping import column_map_toml

    joints, target = _joints(choice), wanted.output / "map.toml"
    try:
        found = guess_map(recordings, joints, wanted.rate_text, wanted.drives)
    except InputError as error:
        _write_template(target, wanted, recordings[0], str(error), choice)
    if commands is not None:
        found = replace(found, commands=guess_commands(commands, recordings[0], found, joints, wanted.drives))
    check_overwrite(target, wanted.force)
    atomic.make_directory(wanted.output)
    comment = (
        f"Proposed by armdyn from {wanted.files[0].name}: read it, correct what is wrong, above all lines with "
        "'check',\nand take 'check' away where you have answered it: until then 'armdyn inspect' asks."
    )
    atomic.write_text(target, column_map_toml(found, comment, recordings[0].columns))
    answer = {"schema": "armdyn.map/1", "file": str(target), **column_map_json(found)}
    if found.commands is not None:
        answer["commands"] = column_map_json(found.commands)
    if write_json_if_file_given(json_file, lambda: answer):
        print_proposal(found, recordings)
        if found.commands is not None and commands is not None:
            typer.echo(f"commands, {wanted.commands}:")
            print_proposal(found.commands, [commands])
        typer.echo(f"written to {target}")
        if joints is None and any(entry.joint and not is_auxiliary(entry.channel) for entry in found.entries.values()):
            typer.echo("joints are called as the headers call them: --urdf ROBOT.urdf gives them the robot's names")
        own = _words(choice) if choice else []
        own += ["--commands", str(wanted.commands)] if wanted.commands is not None else []
        again = shell_quoted_command("import", *wanted.files, "--output", wanted.output, "--map", target, *own)
        typer.echo(f"read it, correct what is wrong, then: {again}")


def _write_template(
    target: Path, wanted: ImportOptions, foreign: "ForeignRecording", why: str, choice: RobotChoice
) -> NoReturn:
    """Write a mapping file that asks what every column is, because nothing could be guessed.

    Raises:
        InputError: always; it says why, and what to type when the file is filled in.
    """
    from pipeline.imports.mapping import ColumnMap, column_map_toml

    check_overwrite(target, wanted.force)
    atomic.make_directory(wanted.output)
    comment = "Take '#' away from the lines that you know, and write channel and unit in place of WHICH."
    atomic.write_text(target, column_map_toml(ColumnMap({}), comment, foreign.columns))
    again = shell_quoted_command(
        "import", *wanted.files, "--output", wanted.output, "--map", target, *(_words(choice) if choice else [])
    )
    raise InputError(f"{why}; {target} asks what every column is: fill it in, then: {again}")


def _words(choice: RobotChoice) -> list[str]:
    """Options of a command that name the robot; with a placeholder for its file if the user named none."""
    if choice.robot is not None:
        return ["--robot", choice.robot]
    return ["--urdf", str(choice.urdf_file) if choice.urdf_file is not None else "ROBOT.urdf"]


def _say(found: "list[ImportedRun]", written: list[Path], choice: RobotChoice, drives: Sequence[str]) -> None:
    from armdyn.arm.drives import law_of_commands
    from armdyn.arm.known_drives import KNOWN_DRIVES

    runs = [each.run for each in found]
    for each, path in zip(found, written, strict=True):
        run = each.run
        longest = max(run.all_channels.values(), key=len)
        rate = (len(longest) - 1) / max(float(longest.time[-1] - longest.time[0]), 1e-9)
        seconds = max(float(c.time[-1]) for c in run.all_channels.values())
        typer.echo(f"{path}: {run.summary}, {seconds:.1f} s, {rate:.4g} samples per second")
        for note in (*(a.sentence for a in each.accounts if not a.checks(run.name)), *run.warnings):
            typer.echo(f"  {note}")
    fitted, last = (written[:-1], ["--held-out", written[-1]]) if len(written) > 1 else (written, [])
    outputs = "--output repaired.toml --report repair.html"
    repair = f"then: {shell_quoted_command('repair', 'M.toml', *fitted, *last)} {outputs}"
    if runs[0].joints:
        law = law_of_commands(runs[0])
        known = bool(drives) and all(drive.partition("=")[0] in KNOWN_DRIVES for drive in drives)
        kinds = drives if known else [f"servo:{law}=all"]
        drive = [] if law is None else [word for kind in kinds for word in ("--drive", kind)]
        typer.echo(f"next: {shell_quoted_command('new', 'arm', 'M.toml', *_words(choice), *drive)}")
        if drive:
            typer.echo("no torque was recorded, but commands: the motion of the arm under its drives is compared")
            if not known:
                typer.echo(
                    f"  known servos, as in '--drive sts3215=all' for an SO-100 or SO-101: {', '.join(KNOWN_DRIVES)}"
                )
        silent = not drive and not runs[0].predictable_channels
        typer.echo("no torque was recorded: only what is measured can be compared" if silent else repair)
    else:
        typer.echo(f"next: armdyn new {'pendulum' if runs[0].channels else '--base FILE.py'} M.toml")
        typer.echo(repair)


def _answer(found: "list[ImportedRun]", written: list[Path]) -> dict[str, object]:
    from pipeline.fields import attributes_as_json

    return {
        "schema": "armdyn.import/1",
        "runs": [
            {
                "file": str(path),
                "channels": {
                    name: {"unit": c.unit, "samples": len(c), "from": float(c.time[0]), "to": float(c.time[-1])}
                    for name, c in each.run.all_channels.items()
                },
                "samples": [attributes_as_json(a, "source came kept left_out steps stamped") for a in each.accounts],
                "notes": list(each.run.warnings),
            }
            for each, path in zip(found, written, strict=True)
        ],
    }
