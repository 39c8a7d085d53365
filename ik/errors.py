"""Errors of building and loading tables of postures."""

from pathlib import Path
from typing import Any

from armdyn.errors import InputError, TaskFailedError
from urdf import Robot


class StaleTableError(InputError):
    """A table or volume was built for another robot or other settings, or its file is damaged."""


class UnreachableError(TaskFailedError):
    """The arm cannot follow a path: the message says where, why and what to do."""


def check_owner(source: Path, about: dict[str, Any], robot: Robot, remedy: str) -> None:
    """Refuse the file of a table or a volume that was built for another robot or other settings of it.

    Raises:
        StaleTableError: the file belongs to another robot or other settings; the message has the remedy.
    """
    if about["robot"] != robot.name:
        raise StaleTableError(f"{source}: it is of robot '{about['robot']}', not '{robot.name}'; {remedy}")
    if about["fingerprint"] != robot.fingerprint:
        raise StaleTableError(f"{source}: the URDF or the settings of '{robot.name}' have changed since; {remedy}")
