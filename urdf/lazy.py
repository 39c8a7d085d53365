"""Packages whose modules are imported at first use (PEP 562), so that importing the package takes no time."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_getattr(package: str, files: Mapping[str, str]) -> Callable[[str], Any]:
    """Make the ``__getattr__`` function of a package that imports its public names at first use.

    Args:
        package: name of the package.
        files: for each public name, the module that defines it; for a public module, the module's own name.
    """

    def load(name: str) -> Any:
        if name not in files:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        module = import_module(files[name])
        return module if files[name] == f"{package}.{name}" else getattr(module, name)

    return load
