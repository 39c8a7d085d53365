"""Arguments and options that several commands have, and functions that parse their texts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.errors import InputError, at

if TYPE_CHECKING:
    from armdyn.recording.units import Known
    from urdf import Robot

JsonOption = Annotated[Path | None, typer.Option("--json", help="The answer as JSON; '-' is standard output.")]
ModelArgument = Annotated[Path, typer.Argument(metavar="M.toml", help="Model file.")]
RunsArgument = Annotated[list[Path], typer.Argument(metavar="RUN...", help="Recordings to fit: CSV or MCAP.")]
HeldOutOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--held-out",
        help="A recording that takes part in choosing effects and never in a fit; give the option once for each.",
    ),
]
ExamOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--exam",
        help="A recording that takes part in nothing: its error is computed at the very end. Give the option once for "
        "each.",
    ),
]
EffectsOption = Annotated[Path | None, typer.Option("--effects", help="Python file with effects of your own.")]
ReportOption = Annotated[Path | None, typer.Option("--report", help="Write one offline HTML file.")]
TrustOption = Annotated[
    bool, typer.Option("--trust-data", help="Go on where 'armdyn inspect' finds a recording wrong.")
]
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", "--out", help="Where the repaired model goes; over the old one when not given."),
]
NamedOnlyOption = Annotated[
    bool, typer.Option("--named-only", help="Leave the model's background out of what is written.")
]
RosOption = Annotated[str, typer.Option("--ros", help="Address of the rosbridge, ws://HOST:9090.")]
ArmOption = Annotated[
    str, typer.Option("--arm", help="The arm behind it: a known robot, or a settings file with a table for ROS.")
]
CalibrationOption = Annotated[
    Path | None, typer.Option(help="What 'armdyn loadcell calibrate' wrote; your settings if not given.")
]
SecondsOption = Annotated[float | None, typer.Option(min=0.1, help="End after this long; else with Ctrl-C.")]
NoBrowserOption = Annotated[bool, typer.Option("--no-browser", help="Only say where the page is.")]
JointsOption = Annotated[str | None, typer.Option(help="The arm's joints from base to tool, separated by commas.")]
ToolOption = Annotated[str | None, typer.Option(help="The link that carries the tool.")]


@dataclass(frozen=True)
class ArmChoice:
    """Options that choose an arm and a chain of its joints."""

    robot: Annotated[
        str, typer.Option(help="Name of a known robot, or a settings file of one's own (.toml) that names its URDF.")
    ] = "baxter"
    urdf_file: Annotated[
        Path | None, typer.Option("--urdf", help="A URDF file, in place of --robot; its longest chain is the arm.")
    ] = None
    joints: JointsOption = None
    tool: ToolOption = None
    meshes: Annotated[
        bool,
        typer.Option(
            "--meshes/--no-meshes", help="Whether every mesh must be there; without, missing shapes are left out."
        ),
    ] = True

    def load(self) -> "Robot":
        """Load the chosen arm.

        Raises:
            InputError: its description is unknown or cannot be used.
        """
        from urdf import UrdfError, load

        try:
            chosen = self.robot if self.urdf_file is None else self.urdf_file
            return load(chosen, joints=names_in(self.joints), tool=self.tool, meshes=self.meshes)
        except UrdfError as error:
            remedy = str(error).replace("load the robot without its missing meshes", "add --no-meshes")
            raise InputError(remedy) from error


@dataclass(frozen=True)
class RobotChoice:
    """Options that choose a robot by its name or by its URDF; both may be absent.

    Raises:
        InputError: both are given.
    """

    robot: Annotated[str | None, typer.Option(help="Name of a known robot, such as baxter.")] = None
    urdf_file: Annotated[Path | None, typer.Option("--urdf", help="A URDF file, in place of --robot.")] = None

    def __post_init__(self) -> None:
        if self.robot is not None and self.urdf_file is not None:
            raise InputError(ONE_ROBOT)

    def __bool__(self) -> bool:
        return self.robot is not None or self.urdf_file is not None

    def needed(self) -> None:
        """Refuse to continue without a robot.

        Raises:
            InputError: none is given.
        """
        if not self:
            raise InputError(ONE_ROBOT)


ONE_ROBOT = "a robot is known by its name or by its URDF: give one of --robot and --urdf"


def quantity(text: str, unit: str, option: str) -> "Known":
    """Value of an option with a unit, such as ``"80 g +/- 0.4 g"``, converted to `unit`.

    Raises:
        InputError: it cannot be read.
    """
    from armdyn.recording.units import parse_quantity

    with at(option):
        return parse_quantity(text, unit)


def names_in(text: str | None) -> list[str] | None:
    """Names from a text that separates them by commas; None where there is no text."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def missing_meshes(robot: "Robot") -> list[str]:
    """One line about the shapes whose files an arm lacks; empty where it has all of them."""
    missing = [defect for defect in robot.defects if defect.startswith("mesh ")]
    return [missing[0] + (f"; and {len(missing) - 1} more" if missing[1:] else "")] if missing else []


def numbers(text: str, option: str) -> list[float]:
    """Numbers from a text that separates them by commas.

    Raises:
        InputError: one of them is not a number.
    """
    from urdf.bounds import has_plausible_magnitude, parse_number, printable_excerpt

    values = []
    for part in text.split(","):
        try:
            value = parse_number(part)
        except ValueError as error:
            raise InputError(f"{option}: {error}; give numbers separated by commas") from error
        if not has_plausible_magnitude(value):
            raise InputError(
                f"{option}: {printable_excerpt(part.strip())} is of no size that anything has; write SI units"
            )
        values.append(value)
    return values


def exactly(count: int, text: str, option: str, names: Sequence[str] = ()) -> list[float]:
    """A given number of numbers from a text that separates them by commas; `names` are for the error's text.

    Raises:
        InputError: one of them is not a number, or there are more or fewer.
    """
    values = numbers(text, option)
    if len(values) != count:
        whose = f", for {', '.join(names)}" if names else ""
        raise InputError(
            f"{option}: '{text}' has {len(values)} numbers; give {count} numbers, separated by commas{whose}"
        )
    return values


def tool_rotation(rpy: str) -> Any:
    """Orientation of the tool, (3, 3), from its roll, pitch and yaw [rad]."""
    from urdf.robot import rotation_from_rpy

    return rotation_from_rpy(*exactly(3, rpy, "--tool-rpy"))


def parse_hidden(given: list[str]) -> dict[str, float | None]:
    """Sizes of hidden effects by name; None means the typical size.

    Raises:
        InputError: a value that is not a finite number, or an effect that is named twice.
    """
    from urdf.bounds import has_plausible_magnitude, parse_number

    hidden: dict[str, float | None] = {}
    for entry in given:
        name, equals, text = entry.partition("=")
        if name in hidden:
            raise InputError(f"--hidden {entry}: '{name}' is given twice: give each effect once")
        try:
            value = parse_number(text) if equals else None
        except ValueError:
            value = math.nan
        if value is not None and not has_plausible_magnitude(value):
            raise InputError(
                f"--hidden {entry}: '{text}' is not a number: write {name}=0.01, or {name} for its typical size"
            )
        hidden[name] = value
    return hidden
