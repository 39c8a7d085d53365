"""The sidecar: a small TOML file with the same stem, which contains what is known of a recording besides its samples.

```toml
description = "swing 3, 80 g ball"
recorded = 2026-05-04T14:30:00
[noise]                     # standard deviation per channel
load_force = "3 mN"
[known]                     # measured by hand: priors, not truth
mass = "80 g +/- 0.4 g"
[asked]                     # what nobody has answered of how it was read: a line goes where it is answered
"q.elbow" = "'J2 pos': or deg?"
```

Other keys and tables, such as ``source``, ``licence`` or ``[published]``, are for the reader and are not used; one that
resembles a key above is refused as misspelt.
"""

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path

from armdyn.errors import InputError, at
from armdyn.quoting import toml_string
from armdyn.recording.channels import channel_kind, channel_unit, in_contract, is_auxiliary
from armdyn.recording.units import Known, parse_quantity
from armdyn.toml_file import read_toml
from urdf.toml_tables import TomlFileError, parse_toml_text

POSITIVE_VALUES = {"mass": "kg", "length": "m", "gravity": "m/s^2"}
"""Known values of the base pendulum that have a fixed unit and cannot be zero or less."""


SIDECAR_KEYS = ("description", "recorded", "noise", "known", "asked",
        "source", "licence", "license", "published", "urdf", "notes")  # fmt: skip
"""Keys that are used, and further keys for readers of the file."""
MISSPELLING_SIMILARITY = 0.75
"""Similarity (`difflib`) from which a key is a misspelling: 'nosie' and 'knwon' have 0.8."""


@dataclass(frozen=True)
class Sidecar:
    """Known facts on a recording, in SI units; the time of the recording, UTC; and open questions on its import."""

    description: str = ""
    noise: Mapping[str, Known] = field(default_factory=dict)
    known: Mapping[str, Known] = field(default_factory=dict)
    recorded: datetime | None = None
    asked: Mapping[str, str] = field(default_factory=dict)


def read_sidecar(path: Path) -> Sidecar:
    """Read the sidecar at `path`; without a file nothing is known.

    Raises:
        InputError: it names the file, the field, what is wrong and what to do.
    """
    if not path.exists():
        return Sidecar()
    table = read_toml(path)
    with at(path):
        return sidecar_of(table)


def parse_sidecar(text: str) -> Sidecar:
    """Read the text of a sidecar.

    Raises:
        InputError: it is not TOML, or a field cannot be used.
    """
    try:
        return sidecar_of(parse_toml_text(text))
    except TomlFileError as error:
        raise InputError(str(error)) from error


def sidecar_of(table: Mapping[str, object]) -> Sidecar:
    """Read the entries of a sidecar's table.

    Raises:
        InputError: a field cannot be used.
    """
    _check_keys(table)
    description = table.get("description", "")
    if not isinstance(description, str):
        raise InputError(f"description: {description!r} is not a text: put it in quotes")
    noise = {name: _noise(name, value) for name, value in _entries(table, "noise").items()}
    known = {name: _known(name, value) for name, value in _entries(table, "known").items()}
    asked = {name: str(value) for name, value in _entries(table, "asked").items()}
    recorded = utc(table["recorded"], "recorded") if "recorded" in table else None
    return Sidecar(description, noise, known, recorded, asked)


def utc(value: object, where: str) -> datetime:
    """Convert a day or time, in TOML or ISO 8601, to UTC; without a zone it is UTC, and a day is its beginning.

    Args:
        value: a value such as ``2026-05-04`` or ``2026-05-04T14:30:00+02:00``, or such a text.
        where: place of the value, for the message.

    Raises:
        InputError: the value is neither.
    """
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value)
        except ValueError:
            value = None
    if isinstance(value, datetime):
        try:
            return value if value.tzinfo is None else value.astimezone(UTC).replace(tzinfo=None)
        except OverflowError as error:  # for the first and last possible day
            raise InputError(f"{where}: is no time of a recording: correct its year") from error
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day)
    raise InputError(f"{where}: is no time: write it as 2026-05-04 or 2026-05-04T14:30:00")


def _check_keys(table: Mapping[str, object]) -> None:
    """Refuse a misspelt key and a value outside its table; other unknown keys are for readers."""
    for key in table:
        if key in SIDECAR_KEYS:
            continue
        if key in POSITIVE_VALUES:
            raise InputError(f"'{key}' stands outside every table: put it below a line '[known]'")
        if in_contract(key):
            raise InputError(f"'{key}' stands outside every table: put it below a line '[noise]'")
        close = difflib.get_close_matches(key.lower(), SIDECAR_KEYS, n=1, cutoff=MISSPELLING_SIMILARITY)
        if close:
            raise InputError(f"unknown key '{key}': did you mean '{close[0]}'?")


def sidecar_text(sidecar: Sidecar) -> str:
    """The sidecar as TOML."""
    lines = [f"description = {toml_string(sidecar.description)}"]
    if sidecar.recorded is not None:
        lines.append(f"recorded = {sidecar.recorded.isoformat()}Z")
    for title, entries in (("noise", sidecar.noise), ("known", sidecar.known), ("asked", sidecar.asked)):
        if entries:
            lines += [
                "",
                f"[{title}]",
                *(f"{toml_string(name)} = {toml_string(str(value))}" for name, value in entries.items()),
            ]
    return "\n".join(lines) + "\n"


def _entries(table: Mapping[str, object], key: str) -> dict[str, object]:
    """Entries of the table `key`; ``tau.slide = ...`` without quotes is a nested table with the same meaning."""
    entries = table.get(key, {})
    if not isinstance(entries, dict):
        raise InputError(f"[{key}]: {entries!r} is not a table: write '[{key}]' on a line of its own")
    return dict(_flat(entries))


def _flat(table: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _quantity(where: str, value: object, unit: str | None) -> Known:
    if not isinstance(value, str):
        example = f"{value} {unit or 'kg'}" if isinstance(value, int | float) else f"1 {unit or 'kg'}"
        raise InputError(f'{where}: {value!r} has no unit: write it as text, such as "{example}"')
    with at(where):
        return parse_quantity(value, unit)


def _noise(name: str, value: object) -> Known:
    where = f"[noise] {name}"
    choices = channel_kind(name, "channel in [noise]").units
    parsed = _quantity(where, value, None if is_auxiliary(name) or len(choices) > 1 else choices[0])
    if parsed.value <= 0.0:
        raise InputError(f"{where}: '{value}' is not positive: give the standard deviation, or leave it out")
    with at(where):
        unit, factor, _ = channel_unit(name, parsed.unit)
    return Known(parsed.value * factor, None, unit)


def _known(name: str, value: object) -> Known:
    where = f"[known] {name}"
    known = _quantity(where, value, POSITIVE_VALUES.get(name))
    if name in POSITIVE_VALUES and known.value <= 0.0:
        raise InputError(f"{where}: '{value}' is not positive: measure it again")
    return known
