"""Load the physics that a user wrote in a Python file with the decorator `@physics`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from armdyn.effects.user import effects_defined_in
from armdyn.errors import InputError
from armdyn.physics.definition import Physics
from armdyn.physics.model import PhysicsModel, physics_model
from armdyn.user_code import allow_code, check_code, load_module, user_code_errors

KEYS = ()


def read_base(table: Mapping[str, Any], folder: Path) -> tuple[PhysicsModel, dict[str, Any]]:
    """The model whose base is the Python file that a model file names, relative to the model file's `folder`."""
    check_code(folder / table["base"], folder)
    return load_base(folder / table["base"]), {}


def load_base(path: str | Path) -> PhysicsModel:
    """Load the model that a Python file defines: its physics without effects, and the effects that the file defines.

    The file is run as Python: it may do anything that a Python program may do.

    Raises:
        InputError: the file cannot be read or run, or it does not define exactly one usable physics.
    """
    path = Path(path)
    defined = vars(load_module(path, "base"))
    allow_code(path)
    found = [item for item in defined.values() if isinstance(item, Physics)]
    if len(found) != 1:
        raise InputError(
            f"{path}: defines {len(found)} bases: write one function with @physics(...), see examples/crane.py"
        )
    with user_code_errors(path):
        return physics_model(found[0], own_effects=effects_defined_in(path, defined), file=path.resolve())
