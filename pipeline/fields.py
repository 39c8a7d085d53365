"""JSON of a result: a field of an answer is the attribute of the result that has its name.

Where the two differ, the answer says so.
"""

import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any


def number(value: float | None) -> float | None:
    """A finite float, or null."""
    return float(value) if value is not None and math.isfinite(value) else None


def plain(value: Any) -> Any:
    """A value as JSON knows it: no number that is none, enums by their key, tuples and arrays as lists."""
    if hasattr(value, "tolist"):  # numpy's arrays and scalars; without its import, `armdyn --help` is a fifth faster
        value = value.tolist()
    if isinstance(value, Mapping):
        return {name: plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, Enum):
        return getattr(value, "key", value.value)
    if isinstance(value, float):
        return number(value)
    return str(value) if isinstance(value, Path) else value


def fields(item: Any, names: str, **others: Any) -> dict[str, Any]:
    """Attributes of an item by their names, separated by spaces, in order; ``name=`` stands for one of `others`."""
    return {
        name.removesuffix("="): plain(others[name[:-1]] if name.endswith("=") else getattr(item, name))
        for name in names.split()
    }
