"""Convert results to values that JSON can contain, and choose attributes of a result for a JSON object."""

import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any


def finite_or_none(value: float | None) -> float | None:
    """The value as a float, or None if it is None, infinite or nan."""
    return float(value) if value is not None and math.isfinite(value) else None


def json_value(value: Any) -> Any:
    """Convert a value to JSON's types.

    Numbers that are not finite become None, enums their `key` or value, tuples and arrays lists, paths texts.
    """
    if hasattr(value, "tolist"):  # numpy's arrays and scalars; without its import, `armdyn --help` is a fifth faster
        value = value.tolist()
    if isinstance(value, Mapping):
        return {name: json_value(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(entry) for entry in value]
    if isinstance(value, Enum):
        return getattr(value, "key", value.value)
    if isinstance(value, float):
        return finite_or_none(value)
    return str(value) if isinstance(value, Path) else value


def attributes_as_json(item: Any, names: str, **others: Any) -> dict[str, Any]:
    """Choose attributes of an object for a JSON object, in the order of `names`.

    Args:
        item: the object.
        names: keys of the JSON object, separated by spaces; ``key`` for the attribute of this name, ``key=attribute``
            for an attribute of another name, ``key=`` for a value in `others`.
        others: values that are not attributes, by key.
    """
    made = {}
    for name, equals, attribute in (each.partition("=") for each in names.split()):
        made[name] = json_value(others[name] if equals and not attribute else getattr(item, attribute or name))
    return made
