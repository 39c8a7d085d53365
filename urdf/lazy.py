"""Lazy packages: their names are loaded at the first use (PEP 562), so that importing them takes no time."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, files: Mapping[str, str]) -> Callable[[str], Any]:
    """The ``__getattr__`` of a package whose names are loaded at the first use.

    `files` has the module that defines each name; for a module that is public itself, its own name.
    """

    def load(name: str) -> Any:
        if name not in files:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        module = import_module(files[name])
        return module if files[name] == f"{package}.{name}" else getattr(module, name)

    return load
