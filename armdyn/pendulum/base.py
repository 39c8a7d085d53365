"""A pendulum from a model file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from armdyn.effects.tension import printed_tension
from armdyn.errors import UnknownNameError
from armdyn.pendulum.model import PendulumModel, pendulum_model

KEYS = ("tension",)


def read_base(table: Mapping[str, Any], folder: Path) -> tuple[PendulumModel, dict[str, Any]]:
    """The model without effects, and what else of the file belongs to the base.

    Raises:
        UnknownNameError: there is no such formula of the tension.
    """
    del folder
    tension = table.get("tension", "exact")
    if tension not in ("exact", "printed"):
        raise UnknownNameError("tension formula", str(tension), ("exact", "printed"))
    return pendulum_model(0.35, 0.1, [printed_tension] if tension == "printed" else []), {}
