"""Errors in building and loading IK tables and volumes."""

from pathlib import Path
from typing import Any

from armdyn.errors import InputError, TaskFailedError
from urdf import Robot


class StaleTableError(InputError):
    """An IK table or volume was built for another robot or other settings, or its file is damaged."""


class UnreachableError(TaskFailedError):
    """The arm cannot follow a path with its tool; the message says at which point, why and what to do."""


def check_table_belongs_to_robot(source: Path, about: dict[str, Any], robot: Robot, remedy: str) -> None:
    """Check that the file of an IK table or volume was built for this robot with its present settings.

    Args:
        source: the file, for the message.
        about: description in the file, with the robot's name and fingerprint.
        robot: the robot.
        remedy: end of the message: what to do.

    Raises:
        StaleTableError: the file was built for another robot or for other settings.
    """
    if about["robot"] != robot.name:
        raise StaleTableError(f"{source}: it is of robot '{about['robot']}', not '{robot.name}'; {remedy}")
    if about["fingerprint"] != robot.fingerprint:
        raise StaleTableError(f"{source}: the URDF or the settings of '{robot.name}' have changed since; {remedy}")
