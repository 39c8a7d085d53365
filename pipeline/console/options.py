"""Arguments and options that several commands share, and functions that parse their values."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.errors import InputError, error_location

if TYPE_CHECKING:
    from armdyn.recording.units import KnownQuantity
    from urdf import Robot

JsonOption = Annotated[Path | None, typer.Option("--json", help="File for the answer as JSON; '-' is standard output.")]
ModelArgument = Annotated[Path, typer.Argument(metavar="M.toml", help="Model file.")]
RunsArgument = Annotated[list[Path], typer.Argument(metavar="RUN...", help="Recordings to fit: CSV or MCAP.")]
HeldOutOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--held-out",
        help="A recording that helps to choose effects and is never fitted; may be repeated.",
    ),
]
ExamOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--exam",
        help="A recording that is neither fitted nor used to choose effects; its error is computed at the end. May be "
        "repeated.",
    ),
]
EffectsOption = Annotated[Path | None, typer.Option("--effects", help="Python file with effects of your own.")]
ReportOption = Annotated[
    Path | None, typer.Option("--report", help="HTML file for a report, which works without a network.")
]
TrustOption = Annotated[
    bool, typer.Option("--trust-data", help="Use recordings even if 'armdyn inspect' finds a mistake in them.")
]
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", "--out", help="File for the repaired model; by default it replaces the old model."),
]
NamedOnlyOption = Annotated[
    bool,
    typer.Option("--named-only", help="Leave the background, the force without a named effect, out of the file."),
]
RosOption = Annotated[str, typer.Option("--ros", metavar="ws://HOST:9090", help="Address of the rosbridge.")]
ArmOption = Annotated[
    str, typer.Option("--arm", help="The arm: name of a known robot, or a settings file with a table for ROS.")
]
WrenchTopicOption = Annotated[
    list[str] | None,
    typer.Option(
        "--wrench",
        metavar="SENSOR=TOPIC",
        help="Topic of a force/torque sensor (WrenchStamped): ft=/ft_sensor/wrench; may be repeated.",
    ),
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option(help="File that 'armdyn loadcell calibrate' wrote; by default that in your settings directory."),
]
SecondsOption = Annotated[
    float | None, typer.Option(min=0.1, help="Time after which the command ends [s]; by default Ctrl-C ends it.")
]
NoBrowserOption = Annotated[
    bool, typer.Option("--no-browser", help="Print the address of the page, without opening it in a browser.")
]
JointsOption = Annotated[str | None, typer.Option(help="The arm's joints from base to tool, separated by commas.")]
ToolOption = Annotated[str | None, typer.Option(help="The link that carries the tool.")]


ArmModelOption = Annotated[
    Path | None,
    typer.Option(
        "--model",
        metavar="M.toml",
        help="Model file of an arm, in place of --robot: the arm as it is, with its effects.",
    ),
]


@dataclass(frozen=True)
class ArmChoice:
    """Options that choose an arm and a chain of its joints."""

    robot: Annotated[
        str, typer.Option(help="Name of a known robot, or your own settings file (.toml), which names a URDF file.")
    ] = "baxter"
    urdf_file: Annotated[
        Path | None, typer.Option("--urdf", help="A URDF file, in place of --robot; its longest chain is the arm.")
    ] = None
    joints: JointsOption = None
    tool: ToolOption = None
    meshes: Annotated[
        bool,
        typer.Option(
            "--meshes/--no-meshes", help="Whether every mesh file must exist; otherwise missing shapes are left out."
        ),
    ] = True
    model: ArmModelOption = None
    effects: EffectsOption = None

    def load(self) -> "Robot":
        """Load the chosen arm.

        Raises:
            InputError: the robot is unknown, or its description cannot be used.
        """
        from urdf import UrdfError, load

        if self.model is not None:
            from armdyn.arm.model import required_arm
            from armdyn.effects.user import load_effects
            from armdyn.model_file import read_model
            from pipeline.motion.robot_of_model import robot_of_model

            if self.urdf_file is not None or self.joints is not None or self.tool is not None:
                raise InputError("--model holds robot, joints and tool: leave out --urdf, --joints and --tool")
            given = read_model(self.model, load_effects(self.effects))
            return robot_of_model(required_arm(given, "this is", "give an arm's"))
        try:
            chosen = self.robot if self.urdf_file is None else self.urdf_file
            return load(chosen, joints=split_names(self.joints), tool=self.tool, meshes=self.meshes)
        except UrdfError as error:
            remedy = str(error).replace("load the robot without its missing meshes", "add --no-meshes")
            raise InputError(remedy) from error


@dataclass(frozen=True)
class RobotChoice:
    """Options that choose a robot by its name or by its URDF file; it is False in a condition if neither is given.

    Raises:
        InputError: both options are given.
    """

    robot: Annotated[str | None, typer.Option(help="Name of a known robot, such as baxter.")] = None
    urdf_file: Annotated[Path | None, typer.Option("--urdf", help="A URDF file, in place of --robot.")] = None

    def __post_init__(self) -> None:
        if self.robot is not None and self.urdf_file is not None:
            raise InputError(ONE_ROBOT_MESSAGE)

    def __bool__(self) -> bool:
        return self.robot is not None or self.urdf_file is not None

    def require_robot(self) -> None:
        """Check that a robot was given.

        Raises:
            InputError: no robot was given.
        """
        if not self:
            raise InputError(ONE_ROBOT_MESSAGE)


ONE_ROBOT_MESSAGE = "a robot is known by its name or by its URDF: give one of --robot and --urdf"


def parse_option_quantity(text: str, unit: str, option: str) -> "KnownQuantity":
    """Parse the value of an option, such as ``"80 g +/- 0.4 g"``, and convert it to a unit.

    Args:
        text: the value.
        unit: unit of the result.
        option: name of the option, for the error message.

    Raises:
        InputError: the text is not a number with a unit that can be converted.
    """
    from armdyn.recording.units import parse_quantity

    with error_location(option):
        return parse_quantity(text, unit)


def split_names(text: str | None) -> list[str] | None:
    """Split a text with names separated by commas; None for None."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def parse_numbers(text: str, option: str) -> list[float]:
    """Parse a text with numbers separated by commas; `option` is the option's name for the error message.

    Raises:
        InputError: a part of the text is not a number, or has an impossible size.
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


def parse_number_list(count: int, text: str, option: str, names: Sequence[str] = ()) -> list[float]:
    """Parse a text with `count` numbers separated by commas.

    Args:
        count: required number of numbers.
        text: the text.
        option: name of the option, for the error message.
        names: what the numbers belong to, such as joints, for the error message.

    Raises:
        InputError: a part of the text is not a number, or there are more or fewer numbers.
    """
    values = parse_numbers(text, option)
    if len(values) != count:
        whose = f", for {', '.join(names)}" if names else ""
        raise InputError(
            f"{option}: '{text}' has {len(values)} numbers; give {count} numbers, separated by commas{whose}"
        )
    return values


def tool_rotation(rpy: str) -> Any:
    """Rotation matrix of the tool, (3, 3), from a text with its roll, pitch and yaw [rad], separated by commas."""
    from urdf.robot import rotation_from_rpy

    return rotation_from_rpy(*parse_number_list(3, rpy, "--tool-rpy"))


def parse_hidden_effects(given: list[str]) -> dict[str, float | None]:
    """Parse the values of ``--hidden``, effects that a simulated robot has: ``EFFECT`` or ``EFFECT=VALUE``.

    Returns:
        The value of each effect by name; None for the effect's typical value.

    Raises:
        InputError: a value is not a finite number, or an effect is named twice.
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
