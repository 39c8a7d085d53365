"""A user's own effects, from a Python file that defines them like those of the catalogue."""

import importlib.util
from pathlib import Path

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import Effect
from armdyn.errors import InputError


def read_effects(file: Path | str) -> tuple[Effect, ...]:
    """Effects that a Python file defines, in the order in which it does.

    The file is run, so it should come from someone whom you trust.

    Raises:
        InputError: it cannot be read or run, defines no effect, or takes a name of the catalogue.
    """
    path = Path(file)
    if not path.is_file():
        raise InputError(f"{path}: no such file: give a Python file that defines effects")
    spec = importlib.util.spec_from_file_location(f"armdyn_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is no Python file: its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever a user's file raises is for the user to read
        raise InputError(f"{path}: {type(error).__name__}: {error}") from error
    found = tuple(item for item in vars(module).values() if isinstance(item, Effect) and item not in CATALOGUE.values())
    if not found:
        raise InputError(f"{path}: defines no effect: write a function under @effect(...), see examples")
    taken = [item.name for item in found if item.name in CATALOGUE]
    if taken:
        raise InputError(f"{path}: the catalogue has an effect '{taken[0]}' already: choose another name")
    return found
