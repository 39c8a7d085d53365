"""Read TOML files: check their size and numbers, and convert their tables to dataclasses."""

import difflib
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from datetime import datetime
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from urdf.bounds import MAX_INPUT_MAGNITUDE, MAX_TEXT_FILE_BYTES, MAX_TOML_DEPTH, TOML_INTEGER_LIMIT, printable_excerpt

MAX_LISTED_PROBLEMS = 12
"""Largest number of problems of a file that its error message lists."""


class TomlFileError(ValueError):
    """A TOML file that cannot be used because of one or more problems.

    The message says what is wrong and what to do; the caller adds the file's name. `problems` has one text per wrong
    entry.
    """

    def __init__(self, *problems: str) -> None:
        self.problems = problems
        super().__init__(join_problems(problems))


def join_problems(problems: Sequence[str]) -> str:
    """Join the first `MAX_LISTED_PROBLEMS` problems to a numbered list in one line; a single problem is unchanged."""
    if len(problems) == 1:
        return problems[0]
    listed = "; ".join(f"({i}) {text}" for i, text in enumerate(problems[:MAX_LISTED_PROBLEMS], start=1))
    more = f"; and {len(problems) - MAX_LISTED_PROBLEMS} more" if len(problems) > MAX_LISTED_PROBLEMS else ""
    return f"{len(problems)} problems: {listed}{more}"


def read_toml_with_text(path: Path, *, finite: bool = False) -> tuple[str, dict[str, Any]]:
    """Read the text and the content of a TOML file; with `finite`, the numbers `nan` and `inf` are refused.

    Raises:
        FileNotFoundError: the file is missing.
        TomlFileError: the file cannot be read, is too large, or is not TOML.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_TEXT_FILE_BYTES + 1)
    except FileNotFoundError:
        raise
    except IsADirectoryError as error:
        raise TomlFileError("is a directory: give a file in it") from error
    except (OSError, ValueError) as error:  # a file name with a null character raises ValueError
        raise TomlFileError(f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > MAX_TEXT_FILE_BYTES:
        raise TomlFileError(f"is larger than {MAX_TEXT_FILE_BYTES / 2**20:g} MiB: give a file that a person can read")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = data.count(b"\n", 0, error.start) + 1
        raise TomlFileError(f"line {row} is not UTF-8 text: save the file as UTF-8") from error
    return text, parse_toml_text(text, finite=finite)


def parse_toml_text(text: str, *, finite: bool = False) -> dict[str, Any]:
    """Parse a TOML text; with `finite`, the numbers `nan` and `inf` are refused.

    Raises:
        TomlFileError: the text is not TOML, is nested too deeply, or contains a number that is not finite.
    """
    if _DOTTED.search(text):  # the time of the parser grows with the square of their number
        raise TomlFileError(_DEEP)
    try:
        table = tomllib.loads(text.replace("\r\n", "\n"), parse_float=_float)
    except RecursionError as error:
        raise TomlFileError(_DEEP) from error
    except ValueError as error:  # raised for a number of 5000 digits too
        raise TomlFileError(f"is not TOML: {' '.join(str(error).split())[:200]}: correct it") from error
    _check_spelling(text)
    for where, value in _leaves(table, ""):
        if isinstance(value, int) and not -TOML_INTEGER_LIMIT <= value < TOML_INTEGER_LIMIT:
            raise TomlFileError(f"{where}: a number of {len(str(abs(value)))} digits: write it shorter, such as 1e20")
        if finite and isinstance(value, float) and not math.isfinite(value):
            raise TomlFileError(f"{where} is {value}: write a finite number")
        if isinstance(value, float) and math.isfinite(value) and abs(value) > MAX_INPUT_MAGNITUDE:
            raise TomlFileError(f"{where} is {value:g}: nothing is larger than {MAX_INPUT_MAGNITUDE:g}; write SI units")
    return table


_DOTTED = re.compile(r"""(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){100}""")
"""Matches a key of a hundred names with dots between them."""


def _float(text: str) -> float:
    value = float(text)
    if math.isinf(value) and "inf" not in text:
        raise ValueError(f"'{printable_excerpt(text)}' is too large for a number")
    return value


_ODD = re.compile(r"\d_\d|0[xob][0-9a-fA-F]")
"""Matches numbers such as `1_000` and `0x10`, which TOML allows and `bounds.parse_number` refuses, but also names."""


def _check_spelling(text: str) -> None:
    """Refuse numbers such as `1_000` and `0x10`, which are probably mistakes."""
    if _ODD.search(text) is None:
        return
    import tomlkit
    from tomlkit.items import Float, Integer

    for where, value in _leaves(tomlkit.parse(text.replace("\r\n", "\n")), ""):
        if isinstance(value, Integer | Float) and _ODD.search(value.as_string()):
            raise TomlFileError(f"{where} = {value.as_string()[:60]} is not a number: write its decimal digits alone")


MIN_WORD_LENGTH = 4
"""Least length of a name that counts as a word of the valid names that contain it."""
MAX_SUGGESTED_NAMES = 4
"""Largest number of valid names that are suggested because they contain the given one."""
MAX_LISTED_NAMES = 60
"""Largest number of valid names that an error message lists."""


def name_suggestion(name: str, valid: Sequence[str]) -> str:
    """Advice for an unknown name, as the end of a message: the most similar valid name, or a list of the valid ones."""
    holding = [each for each in valid if len(name) >= MIN_WORD_LENGTH and name in each][:MAX_SUGGESTED_NAMES]
    if holding:
        return f"did you mean {' or '.join(map(repr, holding))}?"
    close = difflib.get_close_matches(name, valid, n=MAX_SUGGESTED_NAMES, cutoff=0.5)
    close = [each for each in close if sorted(each) == sorted(name)] or close  # two letters that are exchanged
    listed = ", ".join(valid[:MAX_LISTED_NAMES]) + (", ..." if len(valid) > MAX_LISTED_NAMES else "")
    return f"did you mean '{close[0]}'?" if close else f"choose one of: {listed}"


MAX_NAMED_FILES = 4
"""Largest number of files, those with the most similar names, that are named where a file is missing."""


def files_beside(path: Path) -> str:
    """Names of files of the same kind in a missing file's folder, as the end of a message; empty without any."""
    beside = difflib.get_close_matches(
        path.name, [p.name for p in path.parent.glob(f"*{path.suffix}")], MAX_NAMED_FILES, 0.0
    )
    return f" (its folder has {', '.join(beside)})" if beside else ""


def check_keys(table: Iterable[str], known: Iterable[str]) -> None:
    """Check that every key of a table is known.

    Raises:
        TomlFileError: a key is unknown; the message suggests the most similar known one.
    """
    valid = tuple(known)
    for key in table:
        if key not in valid:
            raise TomlFileError(f"unknown key '{key[:60]}': {name_suggestion(key.lower(), valid)}")


Declared = TypeVar("Declared")
_KINDS: dict[Any, tuple[Any, str]] = {
    str: (str, "is not a text: put it in quotes"),
    float: (int | float, "is not a number"),
    bool: (bool, "is neither true nor false"),
    datetime: (datetime, "is not a date with a time"),
}


@dataclass(frozen=True)
class TomlValueCheck:
    """A condition on a value in a TOML file besides its type; used as `Annotated[float, TomlValueCheck(...)]`.

    Attributes:
        fits: function of the value that returns whether it is valid.
        remedy: what to write instead, for the error message.
    """

    is_valid: Callable[[Any], bool]
    remedy: str


def table_to_dataclass(kind: type[Declared], table: Mapping[str, Any], where: str = "") -> Declared:
    """Convert a TOML table to a dataclass: each key is stored in the field of its name, if it has the field's type.

    A field's type may be `str`, `float`, `bool`, `datetime`, `Any`, an enum (in the file, the text of a member's
    value), a dataclass (a table), a tuple (a list, of fixed length if the tuple's length is declared), `dict` (a table
    with any keys), the union of a type with None, the union of a type with a list of it, and any of these `Annotated`
    with a `TomlValueCheck`. A key whose field has no default is required.

    Args:
        kind: the dataclass; the field of a key that is a Python keyword ends in ``_``, as in ``from_``.
        table: output of tomllib for the file, or for a table in it.
        where: place of the table for messages, such as ``"[limits]"``; empty for the file itself.

    Raises:
        TomlFileError: it is no table, or entries are missing, unknown or of the wrong kind; the message lists all of
            them.
    """
    if not isinstance(table, Mapping):
        named = f"'{where}' is" if where else "is"
        raise TomlFileError(f"{named} not a table: write {where or 'its [table]'} on a line of its own")
    declared = {field.name.rstrip("_"): field for field in fields(cast(Any, kind))}
    types, values, problems = get_type_hints(kind, include_extras=True), {}, list[str]()
    for name, value in table.items():
        try:
            check_keys([name], declared)
            values[declared[name].name] = _value(types[declared[name].name], value, name)
        except TomlFileError as error:
            problems += error.problems
    for name, field in declared.items():
        if name not in table and field.default is MISSING and field.default_factory is MISSING:
            problems.append(f"entry '{name}' is missing")
    if problems:
        raise TomlFileError(*(f"{where}: {problem}" if where else problem for problem in problems))
    return kind(**values)


def _value(kind: Any, value: Any, name: str) -> Any:
    """Convert a value of the key `name` to its declared type."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin is Annotated:
        read = _value(arguments[0], value, name)
        for check in arguments[1:]:
            if not check.is_valid(read):
                raise TomlFileError(f"{name} = {value!r:.60}: {check.remedy}")
        return read
    if origin in (Union, UnionType):
        choices = [choice for choice in arguments if choice is not NoneType]
        lists = [choice for choice in choices if get_origin(choice) is tuple]
        return _value(lists[0] if lists and isinstance(value, list) else choices[0], value, name)
    if is_dataclass(kind) or origin is dict:
        if not isinstance(value, dict):
            raise TomlFileError(f"'{name}' is not a table: write '[{name}]' on a line of its own")
        if origin is dict:
            return {key: _value(arguments[1], part, f"{name}.{key}") for key, part in value.items()}
        return table_to_dataclass(cast(Any, kind), value, f"[{name}]")
    if origin is tuple and is_dataclass(arguments[0]):
        if not isinstance(value, list) or not all(isinstance(part, dict) for part in value):
            raise TomlFileError(f"'{name}' is not a table: write '[[{name}]]' on a line of its own")
        return tuple(
            table_to_dataclass(cast(Any, arguments[0]), part, f"[[{name}]] {i}")
            for i, part in enumerate(value, start=1)
        )
    if origin is tuple:
        if not isinstance(value, list):
            what = {str: "names", float: "numbers"}.get(arguments[0], "lists")
            raise TomlFileError(f"{name} = {value!r:.60} is not a list of {what}")
        kinds = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else arguments
        if len(kinds) != len(value):
            raise TomlFileError(f"{name} = {value!r:.60} should be {len(kinds)} entries")
        return tuple(_value(entry, part, name) for entry, part in zip(kinds, value, strict=True))
    if issubclass(kind, Enum):
        known = {member.value: member for member in kind}
        if not isinstance(value, str) or value not in known:
            raise TomlFileError(f"{name} = {value!r:.60}: choose one of {', '.join(known)}")
        return known[value]
    accepted, otherwise = _KINDS[kind]
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        raise TomlFileError(f"{name} = {value!r:.60} {otherwise}")
    if isinstance(value, str) and "\0" in value:
        raise TomlFileError(f"{name} = {value!r:.60} holds a null character: take it out")
    return float(value) if kind is float else value


_DEEP = "is nested too deeply: write tables as '[name]' on a line of its own"


def _leaves(value: Any, where: str, depth: int = 0) -> Iterator[tuple[str, Any]]:
    if depth > MAX_TOML_DEPTH:
        raise TomlFileError(_DEEP)
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{where}.{key}" if where else key, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            yield from _leaves(inner, where, depth + 1)
    else:
        yield where, value
