"""JSON of a result: a field of an answer is the attribute of the result that has its name, or that the answer names."""

import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any


def number(value: float | None) -> float | None:
    """A finite float, or null."""
    return float(value) if value is not None and math.isfinite(value) else None


def plain(value: Any) -> Any:
    """A value in JSON's types: null for a number that is not finite, enums by their key, tuples and arrays as lists."""
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
    """Attributes of an item as JSON, in the order of `names`.

    Args:
        item: any object.
        names: names of the entries, separated by spaces; ``name=attribute`` where the attribute has another name,
            ``name=`` where the value is one of `others`.
        others: values by name.
    """
    made = {}
    for name, equals, attribute in (each.partition("=") for each in names.split()):
        made[name] = plain(others[name] if equals and not attribute else getattr(item, attribute or name))
    return made
