"""A user's own effects, from a Python file that defines them with `@effect`."""

import importlib.util
import sys
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from types import ModuleType

from armdyn.effects.catalogue import CATALOGUE, STAGES
from armdyn.effects.effect import Effect
from armdyn.errors import ArmdynError, InputError


def load_effects(path: str | Path, stages: Collection[str] | None = STAGES) -> tuple[Effect, ...]:
    """The effects that a file defines, in their order there.

    The file is run as Python: it may do whatever a Python program may.

    Args:
        path: of the file.
        stages: what effects may act on; anything where it is None.

    Raises:
        InputError: it cannot be read or run, defines no effect, or one with a name of the catalogue or on no stage.
    """
    path = Path(path)
    own = effects_of(path, vars(load_module(path, "effects")))
    if not own:
        raise InputError(f"{path}: defines no effect: write a function with @effect(...), see examples/my_effects.py")
    if stages is not None:
        check_stages(own, stages, path)
    return own


def check_stages(effects: Iterable[Effect], stages: Collection[str], path: Path | None) -> None:
    """Refuse effects of a file on stages that there are not.

    Raises:
        InputError: an effect acts on nothing.
    """
    for item in effects:
        if item.acts_on not in stages:
            listed = ", ".join(dict.fromkeys(stages))
            raise InputError(f"{path}: effect '{item.name}' acts on '{item.acts_on}': choose one of {listed}")


def effects_of(path: Path, defined: Mapping[str, object]) -> tuple[Effect, ...]:
    """The effects among what a file defines, without those that it imports from the catalogue.

    Raises:
        InputError: one has a name of the catalogue.
    """
    own = {n: item for n, item in defined.items() if isinstance(item, Effect) and item not in CATALOGUE.values()}
    clashing = [n for n, item in own.items() if item.name in CATALOGUE]
    if clashing:
        raise InputError(f"{path}: '{clashing[0]}' has the name of an effect of the catalogue: give it another")
    return tuple(own.values())


def load_module(path: Path, holds: str) -> ModuleType:
    """A user's Python file, run.

    Args:
        path: of the file.
        holds: what it should hold, such as ``"effects"``.

    Raises:
        InputError: it cannot be read or run.
    """
    if path.is_dir():
        raise InputError(f"{path} is a directory: give the Python file with your {holds}")
    if not path.is_file():
        raise InputError(f"{path}: no such file: give the Python file with your {holds}")
    spec = importlib.util.spec_from_file_location(f"armdyn_user_{holds}_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is not a Python file: give one that ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except ArmdynError as error:
        raise InputError(f"{path}: {error}") from error
    except Exception as error:  # whatever a user's program may raise, the remedy is in their file
        line = error.lineno if isinstance(error, SyntaxError) else _line(error, path)
        where = f", line {line}" if line else ""
        raise InputError(f"{path}{where}: {type(error).__name__}: {error}") from error
    return module


def _line(error: Exception, path: Path) -> int | None:
    trace, line = error.__traceback__, None
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path:
            line = trace.tb_lineno
        trace = trace.tb_next
    return line
