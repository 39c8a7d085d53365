"""The catalogue of physical effects: one small definition each, in a file per place where it acts."""

from typing import Any

__all__ = ["CATALOGUE", "find", "load_effects"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'armdyn.effects' has no attribute '{name}'")
    from armdyn.effects import catalogue, user

    return getattr(user if name == "load_effects" else catalogue, name)
