"""An arm from a model file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from armdyn.arm.model import ArmModel, arm_model
from armdyn.errors import InputError

KEYS = ("urdf", "robot", "joints", "tool")


def read_base(table: Mapping[str, Any], folder: Path) -> tuple[ArmModel, dict[str, Any]]:
    """The model without effects, and the keys that say which arm it is.

    Args:
        table: of the file.
        folder: where a path in it begins.

    Raises:
        InputError: not exactly one of both is given, or the arm cannot be used.
    """
    description = {key: table[key] for key in KEYS if key in table}
    if ("urdf" in description) == ("robot" in description):
        raise InputError('an arm needs either urdf = "path" or robot = "baxter"')
    urdf = description.get("urdf")
    if urdf is not None and not Path(urdf).is_absolute():
        urdf = folder / urdf
    robot, joints, tool = (description.get(key) for key in ("robot", "joints", "tool"))
    return arm_model(urdf, robot, joints, tool=tool), description
