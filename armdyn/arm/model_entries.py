"""An arm's model in a model file: the entries that describe the arm, its drives and its sensors."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

from armdyn.arm.model import ArmModel, arm_model
from armdyn.errors import InputError, error_location
from urdf.toml_tables import TomlValueCheck, table_to_dataclass

_Name = Annotated[str, TomlValueCheck(bool, "write a name")]


@dataclass(frozen=True)
class Keys:
    """Entries of a model file that describe the arm; for their meaning see `arm_model`."""

    urdf: _Name | None = None
    robot: _Name | None = None
    joints: tuple[str, ...] | None = None
    tool: _Name | None = None
    drives: dict[str, Any] = field(default_factory=dict)
    wrench: dict[str, Any] = field(default_factory=dict)


KEYS = tuple(key.name for key in fields(Keys))


def read_base(table: Mapping[str, Any], folder: Path) -> tuple[ArmModel, dict[str, Any]]:
    """The arm's model without effects from a model file in `folder`, and the entries that describe the arm.

    Raises:
        InputError: not exactly one of URDF and known robot is given, or the arm cannot be used.
    """
    description = {key: table[key] for key in KEYS if key in table}
    with error_location("the arm"):
        keys = table_to_dataclass(Keys, description)
    if (keys.urdf is None) == (keys.robot is None):
        raise InputError('an arm needs either urdf = "path" or robot = "baxter"')
    # The path of the URDF depends on the place of the model file; see `ArmModel.file_entries`.
    rest = {key: value for key, value in description.items() if key not in ("urdf", "drives", "wrench")}
    urdf = None if keys.urdf is None else folder / keys.urdf
    model = arm_model(urdf, keys.robot, keys.joints, tool=keys.tool)
    return model.with_drives(keys.drives).with_sensors(keys.wrench), rest
