"""A user's own effects, from a Python file that defines them with `@effect`."""

import importlib.util
import sys
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from armdyn.effects.catalogue import CATALOGUE, STAGES
from armdyn.effects.effect import Effect
from armdyn.effects.tried import check_declared, check_tried, line_in
from armdyn.errors import ArmdynError, InputError
from armdyn.rehearsal import rehearse
from urdf.bounds import LARGEST_TEXT, MIB

if TYPE_CHECKING:
    from armdyn.model import Model


def load_effects(path: str | Path | None, stages: Collection[str] | None = STAGES) -> tuple[Effect, ...]:
    """The effects that a file defines, in their order there.

    The file is run as Python: it may do whatever a Python program may.

    Args:
        path: of the file; None for none.
        stages: what effects may act on; anything where it is None.

    Raises:
        InputError: it cannot be read or run, defines no effect, or one with a name of the catalogue or on no stage.
    """
    if path is None:
        return ()
    path = Path(path)
    rehearse(path, lambda: _try(_load(path, stages), path, stages is not None))
    return _load(path, stages)


def _load(path: Path, stages: Collection[str] | None) -> tuple[Effect, ...]:
    own = effects_of(path, vars(load_module(path, "effects")))
    if not own:
        raise InputError(f"{path}: defines no effect: write a function with @effect(...), see examples/my_effects.py")
    if stages is not None:
        _check_stages(own, stages, path)
    return own


def _try(effects: Sequence[Effect], path: Path, strictly: bool) -> None:
    """Try effects; where another base may mean something else by a stage, that they end is all that is asked."""
    for item in effects:
        with nullcontext() if strictly else suppress(InputError):
            check_tried(item, path)


def available(model: "Model", own: Sequence[Effect] = (), path: str | Path | None = None) -> tuple[Effect, ...]:
    """Effects that a model can have: of the catalogue, of its base, and of the user's file.

    Args:
        model: whose stages count.
        own: effects of a file, read with `stages` = None.
        path: of that file, for the message.

    Raises:
        InputError: an effect of the file acts on a stage that no model has.
    """
    _check_stages(own, (*STAGES, *model.stages), path)
    if path is not None and model.base in ("pendulum", "arm"):  # another base may call something else a load
        rehearse(Path(path), lambda: _try([item for item in own if item.acts_on in model.stages], Path(path), True))
    return tuple(e for e in (*CATALOGUE.values(), *model.own_effects, *own) if e.acts_on in model.stages)


def _check_stages(effects: Iterable[Effect], stages: Iterable[str], path: str | Path | None) -> None:
    known = dict.fromkeys(stages)
    for item in effects:
        if item.acts_on not in known:
            listed = ", ".join(known)
            raise InputError(f"{path}: effect '{item.name}' acts on '{item.acts_on}': choose one of {listed}")


def effects_of(path: Path, defined: Mapping[str, object]) -> tuple[Effect, ...]:
    """The effects among what a file defines, without those that it imports from the catalogue.

    Raises:
        InputError: one has a name of the catalogue or of another, or cannot be used as it is declared.
    """
    found = {n: item for n, item in defined.items() if isinstance(item, Effect) and item not in CATALOGUE.values()}
    own = {n: item for n, item in found.items() if all(item is not found[m] for m in list(found)[: [*found].index(n)])}
    clashing = [n for n, item in own.items() if item.name in CATALOGUE]
    if clashing:
        raise InputError(f"{path}: '{clashing[0]}' has the name of an effect of the catalogue: give it another")
    check_declared(tuple(own.values()), path)
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
    if path.stat().st_size > LARGEST_TEXT:
        raise InputError(f"{path}: is larger than {LARGEST_TEXT / MIB:g} MiB: give the Python file with your {holds}")
    spec = importlib.util.spec_from_file_location(f"armdyn_user_{holds}_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is not a Python file: give one that ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # Python's opinion of their style
            spec.loader.exec_module(module)
    except SystemExit as error:
        raise InputError(f"{path}, line {line_in(error, path)}: ends the program: remove sys.exit or exit") from error
    except ArmdynError as error:
        line = line_in(error, path)
        raise InputError(f"{path}{f', line {line}' if line else ''}: {error}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's program may raise, the remedy is in their file
        line = error.lineno if isinstance(error, SyntaxError) else line_in(error, path)
        where = f", line {line}" if line else ""
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{path}{where}: {said}") from error
    return module
