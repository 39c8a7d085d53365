"""One root error; its kinds carry what was wrong and what to do next."""

import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from urdf.table_file import TableFileError, hint

LONGEST_NAME = 60
"""Characters of a name that a message shows."""


class ArmdynError(Exception):
    """Something a user can mend: the message is one line that says what, where and what to do."""

    def __reduce__(self) -> tuple[Any, ...]:
        """For its way out of a worker process: as it is, not made anew by a constructor that wants more than a line."""
        return _as_it_was, (type(self), self.args, self.__dict__)


def _as_it_was(kind: type[ArmdynError], args: tuple[Any, ...], state: dict[str, Any]) -> ArmdynError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


class InputError(ArmdynError):
    """A value, file or argument that cannot be used."""


@contextmanager
def at(where: object) -> Iterator[None]:
    """Tell the place of what is wrong in the block, such as a file or one of its entries, before the message.

    A message that begins with the place already is left as it is.
    """
    try:
        yield
    except (InputError, TableFileError) as error:
        told = str(error)
        raise InputError(told if told.startswith((f"{where}:", f"{where} ")) else f"{where}: {told}") from error


@contextmanager
def collect(problems: list[str], where: str = "") -> Iterator[None]:
    """Add what is wrong in the block to a list, with its place before it, and go on: all problems are told at once."""
    try:
        yield
    except InputError as error:
        problems.append(f"{where}: {error}" if where else str(error))


class UnknownNameError(InputError):
    """A name that is not in a list of valid names.

    Args:
        kind: what was looked up, such as ``"effect"``.
        name: the name that was given.
        valid: the names that exist.
        besides: what else may be written, for a message that knows no name like the given one.
    """

    def __init__(self, kind: str, name: str, valid: Iterable[str], besides: str = "") -> None:
        self.kind, self.name, self.valid = kind, name, tuple(valid)
        shown = name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME]}..."
        told = hint(shown, self.valid)
        super().__init__(f"unknown {kind} '{shown}': {told if told.endswith('?') else told + besides}")


class TaskFailedError(ArmdynError):
    """The input is sound but the answer is no: infeasible, unreachable, stopped for safety."""


LONGEST_MESSAGE = 300
"""Characters of a foreign message that are shown; some hold whole matrices."""


def sentence_of(error: BaseException, failed: str) -> str:
    """What happened, in one line.

    Our own errors already say what to do. Of any other, the kind, its message and the place in the code are given:
    that is what whoever mends it needs.

    Args:
        error: what was raised.
        failed: such as ``"the estimator node failed at 1.20 s"``.
    """
    said = " ".join(str(error).split())
    said = said if len(said) <= LONGEST_MESSAGE else said[:LONGEST_MESSAGE] + " ..."
    if isinstance(error, ArmdynError):
        return said
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({frames[-1].filename.rpartition('/')[2]}, line {frames[-1].lineno})" if frames else ""
    return f"{failed}: {type(error).__name__}{': ' if said else ''}{said}{place}"
