"""A user's own effects, from a Python file that defines them with `@effect`."""

import importlib.util
import sys
from pathlib import Path

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import Effect
from armdyn.errors import ArmdynError, InputError


def load_effects(path: Path) -> tuple[Effect, ...]:
    """The effects that a file defines, in their order there.

    The file is run as Python: it may do whatever a Python program may.

    Raises:
        InputError: it cannot be read or run, defines no effect, or one with a name of the catalogue.
    """
    if path.is_dir():
        raise InputError(f"{path} is a directory: give the Python file with your effects")
    if not path.is_file():
        raise InputError(f"{path}: no such file: give the Python file with your effects")
    spec = importlib.util.spec_from_file_location(f"armdyn_user_effects_{path.stem}", path)
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
    found = tuple(item for item in vars(module).values() if isinstance(item, Effect) and item.name not in CATALOGUE)
    own = {n: item for n, item in vars(module).items() if isinstance(item, Effect) and item not in CATALOGUE.values()}
    clashing = [n for n, item in own.items() if item.name in CATALOGUE]
    if clashing:
        raise InputError(f"{path}: '{clashing[0]}' has the name of an effect of the catalogue: give it another")
    if not found:
        raise InputError(f"{path}: defines no effect: write a function with @effect(...), see examples/my_effects.py")
    return found


def _line(error: Exception, path: Path) -> int | None:
    trace, line = error.__traceback__, None
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path:
            line = trace.tb_lineno
        trace = trace.tb_next
    return line
