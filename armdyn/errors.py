"""The errors that a user can correct: each message says what is wrong, where, and what to do."""

import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from urdf.toml_tables import TomlFileError, name_suggestion

MAX_SHOWN_NAME_LENGTH = 60
"""Largest number of characters of a name in a message."""


class ArmdynError(Exception):
    """An error that a user can correct: the message is one line that says what, where and what to do."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the error as it is, for its way out of a worker process, without calling its constructor."""
        return _as_it_was, (type(self), self.args, self.__dict__)


def _as_it_was(kind: type[ArmdynError], args: tuple[Any, ...], state: dict[str, Any]) -> ArmdynError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


class InputError(ArmdynError):
    """A value, file or argument cannot be used."""


@contextmanager
def error_location(where: object) -> Iterator[None]:
    """Context manager: put a location, such as a file or an entry, before the message of an input error in the block.

    A message that already begins with the location is not changed.
    """
    try:
        yield
    except (InputError, TomlFileError) as error:
        told = str(error)
        raise InputError(told if told.startswith((f"{where}:", f"{where} ")) else f"{where}: {told}") from error


@contextmanager
def collect_errors(problems: list[str], where: str = "") -> Iterator[None]:
    """Context manager: append the message of an input error in the block to a list, instead of raising the error.

    The location `where`, if given, is put before the message.
    """
    try:
        yield
    except InputError as error:
        problems.append(f"{where}: {error}" if where else str(error))


class UnknownNameError(InputError):
    """A name is not in a list of valid names.

    Args:
        kind: kind of thing that is named, such as ``"effect"``.
        name: the name that was given.
        valid: the names that exist.
        besides: text that is added to the message where no valid name is similar.
    """

    def __init__(self, kind: str, name: str, valid: Iterable[str], besides: str = "") -> None:
        self.kind, self.name, self.valid = kind, name, tuple(valid)
        shown = name if len(name) <= MAX_SHOWN_NAME_LENGTH else f"{name[:MAX_SHOWN_NAME_LENGTH]}..."
        told = name_suggestion(shown, self.valid)
        super().__init__(f"unknown {kind} '{shown}': {told if told.endswith('?') else told + besides}")


class TaskFailedError(ArmdynError):
    """The input is valid but the answer is negative: infeasible, unreachable, stopped for safety."""


MAX_SHOWN_MESSAGE_LENGTH = 300
"""Largest number of characters shown of a message from another library; some contain whole matrices."""


def error_sentence(error: BaseException, failed: str) -> str:
    """Describe an exception in one line.

    An error of armdyn is described by its message. For any other, a developer needs its type, its message and the line
    of code that raised it.

    Args:
        error: the exception.
        failed: what failed, such as ``"the estimator node failed at 1.20 s"``.
    """
    said = " ".join(str(error).split())
    said = said if len(said) <= MAX_SHOWN_MESSAGE_LENGTH else said[:MAX_SHOWN_MESSAGE_LENGTH] + " ..."
    if isinstance(error, ArmdynError):
        return said
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({frames[-1].filename.rpartition('/')[2]}, line {frames[-1].lineno})" if frames else ""
    return f"{failed}: {type(error).__name__}{': ' if said else ''}{said}{place}"
