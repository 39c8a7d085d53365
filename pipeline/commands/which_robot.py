"""Options that say which robot a command is about."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from urdf import Robot

RobotOption = Annotated[
    str, typer.Option(help="Name of a known robot, or a settings file of one's own (.toml) that names its URDF.")
]
UrdfOption = Annotated[
    Path | None, typer.Option("--urdf", help="A URDF file, in place of --robot; its longest chain is the arm.")
]
JointsOption = Annotated[str | None, typer.Option(help="The arm's joints from base to tool, separated by commas.")]
ToolOption = Annotated[str | None, typer.Option(help="The link that carries the tool.")]
MeshesOption = Annotated[
    bool,
    typer.Option(
        "--meshes/--no-meshes", help="Whether every mesh must be there; without, missing shapes are left out."
    ),
]


def which_robot(robot: str, urdf_file: Path | None, joints: str | None, tool: str | None, meshes: bool) -> "Robot":
    """The robot that the options choose.

    Raises:
        InputError: its description is unknown or cannot be used.
    """
    from armdyn.errors import InputError
    from urdf import UrdfError, load

    try:
        return load(robot if urdf_file is None else urdf_file, joints=names_in(joints), tool=tool, meshes=meshes)
    except UrdfError as error:
        raise InputError(str(error).replace("load the robot without its missing meshes", "add --no-meshes")) from error


def names_in(text: str | None) -> list[str] | None:
    """Names separated by commas; None where there is no text."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def say_missing_meshes(robot: "Robot") -> None:
    """Print which shapes an arm was loaded without; nothing where it has all of them."""
    if missing := [defect for defect in robot.defects if defect.startswith("mesh ")]:
        typer.echo(missing[0] + (f"; and {len(missing) - 1} more" if missing[1:] else ""))


def choices(robot: "Robot") -> list[str]:
    """Sentences on the gripper's joints that an arm was taken without, and on what an MJCF did not say."""
    from urdf.infer import LEFT_OUT
    from urdf.mjcf import ASSUMED

    return [sentence for sentence in robot.defects if sentence.startswith((LEFT_OUT, ASSUMED))]


def numbers(text: str, option: str) -> list[float]:
    """Numbers separated by commas.

    Raises:
        InputError: one of them is not a number.
    """
    from armdyn.errors import InputError
    from urdf.bounds import is_sane, number, shown

    values = []
    for part in text.split(","):
        try:
            value = number(part)
        except ValueError as error:
            raise InputError(f"{option}: {error}; give numbers separated by commas") from error
        if not is_sane(value):
            raise InputError(f"{option}: {shown(part.strip())} is of no size that anything has; write SI units")
        values.append(value)
    return values


def exactly(count: int, text: str, option: str) -> list[float]:
    """So many numbers separated by commas.

    Raises:
        InputError: one of them is not a number, or there are more or fewer.
    """
    from armdyn.errors import InputError

    values = numbers(text, option)
    if len(values) != count:
        raise InputError(f"{option}: '{text}' has {len(values)} numbers; give {count}, separated by commas")
    return values


def tool_rotation(rpy: str) -> Any:
    """Orientation of the tool, (3, 3), from its roll, pitch and yaw [rad]."""
    from urdf.robot import rotation_of

    return rotation_of(*exactly(3, rpy, "--tool-rpy"))
