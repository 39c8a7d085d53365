"""The sidecar of a recording: a TOML file with the same stem, with known facts besides the samples.

```toml
description = "swing 3, 80 g ball"
recorded = 2026-05-04T14:30:00
[noise]                     # standard deviation per channel
load_force = "3 mN"
[known]                     # measured by hand: priors, not truth
mass = "80 g +/- 0.4 g"
[asked]                     # open questions of the import: remove a line when it is answered
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

from armdyn.errors import InputError, error_location
from armdyn.quoting import toml_string
from armdyn.recording.channels import channel_kind, is_auxiliary, is_channel_name, unit_conversion
from armdyn.recording.units import KnownQuantity, parse_quantity
from armdyn.toml_file import read_toml
from urdf.toml_tables import TomlFileError, parse_toml_text

KNOWN_POSITIVE_VALUE_UNITS = {"mass": "kg", "length": "m", "gravity": "m/s^2"}
"""Units of a pendulum's values that a sidecar may state under ``[known]`` and that must be positive."""


SIDECAR_KEYS = ("description", "recorded", "noise", "known", "asked",
        "source", "licence", "license", "published", "urdf", "notes")  # fmt: skip
"""Keys of a sidecar: those that armdyn uses, and further keys for human readers."""
MISSPELLING_SIMILARITY = 0.75
"""Least similarity (`difflib`) of an unknown key with a known one for a misspelling: 'nosie' and 'knwon' have 0.8."""


@dataclass(frozen=True)
class Sidecar:
    """Content of a sidecar: facts on a recording in SI units, its time in UTC, and open questions of its import."""

    description: str = ""
    noise: Mapping[str, KnownQuantity] = field(default_factory=dict)
    known: Mapping[str, KnownQuantity] = field(default_factory=dict)
    recorded: datetime | None = None
    asked: Mapping[str, str] = field(default_factory=dict)


def read_sidecar(path: Path) -> Sidecar:
    """Read the sidecar at `path`; an empty one if the file does not exist.

    Raises:
        InputError: it names the file, the field, what is wrong and what to do.
    """
    if not path.exists():
        return Sidecar()
    table = read_toml(path)
    with error_location(path):
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
    """Make a sidecar from its parsed TOML table.

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
    recorded = utc_time(table["recorded"], "recorded") if "recorded" in table else None
    return Sidecar(description, noise, known, recorded, asked)


def utc_time(value: object, where: str) -> datetime:
    """Convert a date or time, from TOML or as ISO 8601 text, to UTC; a time without a zone is UTC.

    Args:
        value: a value such as ``2026-05-04`` or ``2026-05-04T14:30:00+02:00``, or such a text.
        where: place of the value, for the message.

    Raises:
        InputError: the value is neither a date nor a time.
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
            raise InputError(f"{where}: is not the date of a recording: correct its year") from error
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day)
    raise InputError(f"{where}: is not a date: write it as 2026-05-04 or 2026-05-04T14:30:00")


def _check_keys(table: Mapping[str, object]) -> None:
    """Refuse a misspelt key and a value outside its table; other unknown keys are for readers."""
    for key in table:
        if key in SIDECAR_KEYS:
            continue
        if key in KNOWN_POSITIVE_VALUE_UNITS:
            raise InputError(f"'{key}' stands outside every table: put it below a line '[known]'")
        if is_channel_name(key):
            raise InputError(f"'{key}' stands outside every table: put it below a line '[noise]'")
        close = difflib.get_close_matches(key.lower(), SIDECAR_KEYS, n=1, cutoff=MISSPELLING_SIMILARITY)
        if close:
            raise InputError(f"unknown key '{key}': did you mean '{close[0]}'?")


def sidecar_text(sidecar: Sidecar) -> str:
    """Text of a sidecar: the TOML file beside a recording, with its known values, noise and date."""
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


def _quantity(where: str, value: object, unit: str | None) -> KnownQuantity:
    if not isinstance(value, str):
        example = f"{value} {unit or 'kg'}" if isinstance(value, int | float) else f"1 {unit or 'kg'}"
        raise InputError(f'{where}: {value!r} has no unit: write it as text, such as "{example}"')
    with error_location(where):
        return parse_quantity(value, unit)


def _noise(name: str, value: object) -> KnownQuantity:
    where = f"[noise] {name}"
    choices = channel_kind(name, "channel in [noise]").units
    parsed = _quantity(where, value, None if is_auxiliary(name) or len(choices) > 1 else choices[0])
    if parsed.value <= 0.0:
        raise InputError(f"{where}: '{value}' is not positive: give the standard deviation, or leave it out")
    with error_location(where):
        unit, factor, _ = unit_conversion(name, parsed.unit)
    return KnownQuantity(parsed.value * factor, None, unit)


def _known(name: str, value: object) -> KnownQuantity:
    where = f"[known] {name}"
    known = _quantity(where, value, KNOWN_POSITIVE_VALUE_UNITS.get(name))
    if name in KNOWN_POSITIVE_VALUE_UNITS and known.value <= 0.0:
        raise InputError(f"{where}: '{value}' is not positive: measure it again")
    return known
