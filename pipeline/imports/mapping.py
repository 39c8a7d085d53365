"""Which column is which channel: a TOML file, and a run made by it.

```toml
time = { column = "t", unit = "ms" }          # where columns share rows, as in a table

[columns]
"J1 pos" = { channel = "q.shoulder", unit = "deg", sign = -1, offset = "90 deg" }
"M1 cur" = { channel = "tau.shoulder", unit = "A", torque_constant = "0.12 N m/A", gear_ratio = 100 }
```

A channel is ``sign * scale * value * (unit) + offset``, and its stamps are ``late`` too large. With a gear ratio N, a
motor turns N times as far and as fast as the joint and gives an Nth of its torque: positions and speeds are divided,
torques multiplied. ``description``, ``[known]`` and ``[noise]`` are those of a run's sidecar and go there.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from armdyn.channels import channel_kind
from armdyn.errors import InputError
from armdyn.inspection.correction import Correction
from armdyn.quoting import one_line, toml_string
from armdyn.run import Run
from armdyn.sidecar import Sidecar, parse_sidecar
from pipeline.imports.foreign import Foreign, ImportProblemsError
from urdf.table_file import TableFileError, read_table

KEYS = ("channel", "unit", "sign", "offset", "gear_ratio", "torque_constant", "scale", "late")
SIDECAR_KEYS = ("description", "recorded", "known", "noise")


@dataclass(frozen=True)
class Entry:
    """What becomes of one column.

    Attributes:
        channel: of the contract.
        unit: that the column is in; empty where the file says it.
        sign: +1 or -1.
        offset: added in the end, with its unit; empty for none.
        gear_ratio: turns of the motor per turn of the joint, where the column is the motor's.
        torque_constant: torque per current, with its unit; empty where the column is no current.
        why: how it was guessed; for a person.
        scale: what its values are multiplied by besides.
        late: by which its stamps are too large, with its unit; empty for 0.
    """

    channel: str
    unit: str = ""
    sign: float = 1.0
    offset: str = ""
    gear_ratio: float = 1.0
    torque_constant: str = ""
    why: str = ""
    scale: float = 1.0
    late: str = ""


@dataclass(frozen=True)
class ColumnMap:
    """A whole mapping.

    Attributes:
        entries: by column.
        time: column that holds the time of a table; empty where there is none.
        time_unit: that it is in.
        sidecar: what goes beside the run.
        why: how the time was guessed.
    """

    entries: Mapping[str, Entry]
    time: str = ""
    time_unit: str = ""
    sidecar: Sidecar = field(default_factory=Sidecar)
    why: str = ""


def read_map(path: Path) -> ColumnMap:
    """Read a mapping file.

    Raises:
        InputError: it cannot be read, or lists everything in it that cannot be used.
    """
    try:
        table = read_table(path)[1]
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except TableFileError as error:
        raise InputError(f"{path}: {error}") from error
    problems: list[str] = []
    for key in table:
        if key not in ("time", "columns", *SIDECAR_KEYS):
            problems.append(f"unknown key '{key}': a mapping has time, columns, {', '.join(SIDECAR_KEYS)}")
    time = table.get("time", {})
    time = {"column": time} if isinstance(time, str) else time
    if not isinstance(time, dict) or not set(time) <= {"column", "unit"}:
        problems.append('time: write it as time = { column = "t", unit = "ms" }')
        time = {}
    columns = table.get("columns", {})
    if not isinstance(columns, dict) or not columns:
        problems.append('no [columns]: write lines such as "J1 pos" = { channel = "q.shoulder", unit = "deg" }')
        columns = {}
    entries = {name: entry for name, raw in columns.items() if (entry := _entry(name, raw, problems)) is not None}
    sidecar = Sidecar()
    try:
        import tomlkit

        sidecar = parse_sidecar(tomlkit.dumps({key: table[key] for key in SIDECAR_KEYS if key in table}))
    except InputError as error:
        problems.append(str(error))
    if problems:
        raise ImportProblemsError(str(path), problems)
    return ColumnMap(entries, str(time.get("column", "")), str(time.get("unit", "")), sidecar)


def _entry(name: str, raw: Any, problems: list[str]) -> Entry | None:
    where = f"'{name}'"
    if not isinstance(raw, dict) or "channel" not in raw:
        problems.append(f'{where}: write it as {{ channel = "q.shoulder", unit = "deg" }}')
        return None
    found = len(problems)
    unknown = [key for key in raw if key not in KEYS]
    if unknown:
        problems.append(f"{where}: unknown key '{unknown[0]}': choose among {', '.join(KEYS)}")
    try:
        channel_kind(str(raw["channel"]))
    except InputError as error:
        problems.append(f"{where}: {error}")
    for key in ("unit", "offset", "torque_constant", "late"):
        if not isinstance(raw.get(key, ""), str):
            problems.append(f"{where}: {key} = {raw[key]!r} is no text: put it in quotes, with its unit")
    sign, ratio = raw.get("sign", 1), raw.get("gear_ratio", 1)
    if sign not in (1, -1):
        problems.append(f"{where}: sign = {sign!r}: write 1 or -1")
    if isinstance(ratio, bool) or not isinstance(ratio, int | float) or not 0 < ratio < 1e6:
        problems.append(f"{where}: gear_ratio = {ratio!r}: write turns of the motor per turn of the joint")
    scale = raw.get("scale", 1)
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 < scale < 1e12:
        problems.append(f"{where}: scale = {scale!r}: write a positive number; 'sign' turns it round")
    if len(problems) > found:
        return None
    return Entry(
        str(raw["channel"]), raw.get("unit", ""), float(sign), raw.get("offset", ""), float(ratio),
        raw.get("torque_constant", ""), scale=float(scale), late=raw.get("late", ""),
    )  # fmt: skip


def map_text(mapping: ColumnMap, comment: str = "") -> str:
    """A mapping as TOML, with the reasons of a guess as comments."""
    lines = [f"# {one_line(line)}" for line in comment.splitlines()]
    if mapping.time:
        why = f"  # {one_line(mapping.why)}" if mapping.why else ""
        lines += [
            f"time = {{ column = {toml_string(mapping.time)}, unit = {toml_string(mapping.time_unit)} }}{why}",
            "",
        ]
    lines.append("[columns]")
    for column, entry in mapping.entries.items():
        parts = [f"channel = {toml_string(entry.channel)}"]
        for key in KEYS[1:]:
            value = getattr(entry, key)
            if value not in ("", 1.0):
                parts.append(f"{key} = {toml_string(value) if isinstance(value, str) else f'{value:.12g}'}")
        why = f"  # {one_line(entry.why)}" if entry.why else ""
        lines.append(f"{toml_string(column)} = {{ {', '.join(parts)} }}{why}")
    return "\n".join(lines) + "\n"


def known_columns(foreign: Foreign) -> ColumnMap:
    """The mapping that the recording's own names say: joint states, and channels of the contract.

    Raises:
        InputError: it says none.
    """
    entries = {}
    for name, column in foreign.columns.items():
        channel = column.channel or name
        try:
            channel_kind(channel)
        except InputError:
            continue
        entries[name] = Entry(channel)
    if not entries:
        shown = ", ".join(f"'{name}'" for name in list(foreign.columns)[:6])
        raise InputError(
            f"{foreign.name}: no column has the name of a channel (it has {shown}): let armdyn propose a mapping with "
            "--guess, or write one and give it with --map"
        )
    return ColumnMap(entries, "time" if foreign.is_table else "", "")


def correction_text(run: Run, correction: Correction) -> str:
    """The mapping that reads a recording as a correction does, at import.

    Args:
        run: as recorded, with its columns.
        correction: of it.
    """
    lines = [f"# Made by armdyn inspect: armdyn import {run.name} --output DIR --map THIS", "[columns]"]
    lines = [lines[0], 'time = { column = "time", unit = "s" }', "", lines[1]]
    for channel in run.channels:
        reading = correction.reading(channel)
        if reading.source not in run.channels:
            continue
        parts = [f"channel = {toml_string(channel)}", f"unit = {toml_string(run.channels[channel].unit)}"]
        if reading.factor < 0:
            parts.append("sign = -1")
        if abs(reading.factor) != 1.0:
            parts.append(f"scale = {abs(reading.factor):.12g}")
        if reading.offset:
            parts.append(f'offset = "{reading.offset:.12g} {run.channels[channel].unit}"')
        if reading.late:
            parts.append(f'late = "{reading.late:.12g} s"')
        lines.append(f"{toml_string(reading.source)} = {{ {', '.join(parts)} }}")
    return "\n".join(lines) + "\n"
