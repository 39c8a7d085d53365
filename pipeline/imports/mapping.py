"""Which column is which channel: a TOML file, and a run made by it.

```toml
time = { column = "t", unit = "ms" }          # where columns share rows, as in a table; or { rate = "100 Hz" }, or
                                              # { period = "4 s" }: from one row to the next

[columns]
"J1 pos" = { channel = "q.shoulder", unit = "deg", sign = -1, offset = "90 deg" }
"M1 cur" = { channel = "tau.shoulder", unit = "A", torque_constant = "0.12 N m/A", gear_ratio = 100 }
```

A channel is ``sign * scale * value * (unit) + offset``, and its stamps are ``late`` too large. With a gear ratio N, a
motor turns N times as far and as fast as the joint and gives an Nth of its torque: positions and speeds are divided,
torques multiplied. ``description``, ``[known]`` and ``[noise]`` are those of a run's sidecar and go there.

Where the columns of one file belong to several runs, ``[runs.NAME]`` holds what is a run's own, such as
``[runs.morning.columns]``; what stands outside of these tables holds for every run.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

from armdyn.errors import InputError, collect
from armdyn.inspection.correction import Correction
from armdyn.quoting import one_line, toml_string
from armdyn.recording.channels import channel_kind
from armdyn.recording.sidecar import Sidecar, sidecar_of
from armdyn.recording.units import parse_quantity
from armdyn.run import Run
from armdyn.toml_file import read_toml
from urdf.table_file import Check, TableFileError, join_problems, read_as

TIME_LINE = (
    'write time = { column = "t", unit = "ms" }, or of rows without stamps time = { rate = "100 Hz" } '
    'or { period = "4 s" }'
)
SLOWEST_RATE, FASTEST_RATE = 0.1, 1e5
"""Hz, of the rows of a recording."""
_NAME = re.compile(r"[A-Za-z0-9_-]+")
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
        scale: what its values are multiplied by besides.
        late: by which its stamps are too large, with its unit; empty for 0.
        fast: share of the time by which their clock runs fast.
        turn: after which it counts from the other end again, with its unit; empty for never.
        check: what is open of a guess; whoever has answered it takes it away.
        why: how it was guessed; for a person.
    """

    channel: str
    unit: str = ""
    sign: Annotated[float, Check(lambda sign: sign in (1, -1), "write 1 or -1")] = 1.0
    offset: str = ""
    gear_ratio: Annotated[
        float, Check(lambda ratio: 0 < ratio < 1e6, "write turns of the motor per turn of the joint")
    ] = 1.0
    torque_constant: str = ""
    scale: Annotated[float, Check(lambda scale: 0 < scale < 1e12, "write a positive number; 'sign' turns it round")] = (
        1.0
    )
    late: str = ""
    fast: Annotated[float, Check(lambda fast: -0.5 < fast < 0.5, "write a share, such as 0.015 for 1.5 %")] = 0.0
    turn: str = ""
    check: str = ""
    why: str = ""

    @property
    def quantity(self) -> str:
        """The channel's name before the dot, such as ``"q"``."""
        return self.channel.partition(".")[0]

    @property
    def joint(self) -> str:
        """Joint of the channel; empty for a channel of a pendulum."""
        return self.channel.partition(".")[2]


def reason(why: str, check: str) -> str:
    """A guess's reason, and what is open of it behind the word CHECK."""
    return f"{why}; CHECK: {check}" if check else why


@dataclass(frozen=True)
class ColumnMap:
    """A whole mapping.

    Attributes:
        entries: by column.
        time: column that holds the time of a table; empty where there is none.
        time_unit: that it is in.
        sidecar: what goes beside the run.
        why: how the time was guessed.
        check: what is open of that.
        rate: of the rows of a table without stamps, with its unit; empty where there are stamps.
        notes: sentences on what was understood without a person.
    """

    entries: Mapping[str, Entry]
    time: str = ""
    time_unit: str = ""
    sidecar: Sidecar = field(default_factory=Sidecar)
    why: str = ""
    check: str = ""
    rate: str = ""
    notes: tuple[str, ...] = ()

    @property
    def asked(self) -> dict[str, str]:
        """What nobody answered yet, by channel; of the time under its name."""
        of_columns = {e.channel: f"'{name}': {e.check}" for name, e in self.entries.items() if e.check}
        return ({"time": f"'{self.time}': {self.check}"} if self.check else {}) | of_columns


def read_map(path: Path) -> Mapping[str, ColumnMap]:
    """Read a mapping file.

    Returns:
        By the run's name; ``""`` where a recording becomes one run only.

    Raises:
        InputError: it cannot be read, or lists everything in it that cannot be used.
    """
    table = read_toml(path)
    runs = table.pop("runs", {"": {}})
    if not isinstance(runs, dict) or not runs or not all(isinstance(own, dict) for own in runs.values()):
        raise InputError(f"{path}: runs: write what is a run's own into tables such as [runs.morning.columns]")
    problems: list[str] = []
    found = {}
    for name, own in runs.items():
        with collect(problems, f"runs.{name}" if name else ""):
            if name and not _NAME.fullmatch(name):
                raise InputError(f"call a run by letters, digits, '_' and '-', not '{one_line(name)}'")
            found[name] = _map_of({**table, **own})
    if problems:
        raise InputError(f"{path}: {join_problems(problems)}")
    return found


def _map_of(table: Mapping[str, Any]) -> ColumnMap:
    """The mapping of one run; see `read_map`."""
    problems = [
        f"unknown key '{key}': a mapping has time, columns, runs, {', '.join(SIDECAR_KEYS)}"
        for key in table
        if key not in ("time", "columns", *SIDECAR_KEYS)
    ]
    time = table.get("time", {})
    time = {"column": time} if isinstance(time, str) else time
    if not isinstance(time, dict) or not (
        set(time) <= {"column", "unit", "check"} or set(time) in ({"rate"}, {"period"})
    ):
        problems.append(f"time: {TIME_LINE}")
        time = {}
    rate = str(time.get("rate", ""))
    with collect(problems, "time"):
        if "period" in time:
            rate = _rate_of(str(time["period"]))
        check_rate(rate)
    columns = table.get("columns", {})
    if not isinstance(columns, dict) or not columns:
        problems.append('no [columns]: write lines such as "J1 pos" = { channel = "q.shoulder", unit = "deg" }')
        columns = {}
    entries = {}
    for name, column in columns.items():
        if not isinstance(column, dict) or "channel" not in column:
            problems.append(f'\'{name}\': write it as {{ channel = "q.shoulder", unit = "deg" }}')
            continue
        try:
            entries[name] = read_as(Entry, column)
        except TableFileError as error:
            problems += [f"'{name}': {problem}" for problem in error.problems]
        with collect(problems, f"'{name}'"):
            channel_kind(str(column["channel"]))
    sidecar = Sidecar()
    with collect(problems):
        sidecar = sidecar_of({key: table[key] for key in SIDECAR_KEYS if key in table})
    if problems:
        raise InputError(join_problems(problems))
    column, unit, check = (str(time.get(key, "")) for key in ("column", "unit", "check"))
    return ColumnMap(entries, column, unit, sidecar, check=check, rate=rate)


def _rate_of(period: str) -> str:
    """The rate of rows that follow each other after a time with its unit."""
    seconds = parse_quantity(period, "s").value
    if not seconds > 0.0:
        raise InputError(f"'{period}' is no time from one row to the next: write it as '4 s'")
    return f"{1.0 / seconds!r} Hz"


def check_rate(rate: str) -> None:
    """Refuse what is no rate of a table's rows; nothing is one.

    Raises:
        InputError: it is no frequency, or none that a recording has.
    """
    if rate and not SLOWEST_RATE <= parse_quantity(rate, "Hz").value <= FASTEST_RATE:
        raise InputError(f"'{rate}' is no rate of a recording: give rows per second, such as '100 Hz'")


def map_text(mapping: ColumnMap, comment: str = "") -> str:
    """A mapping as TOML, with the reasons of a guess as comments."""
    lines = [f"# {one_line(line)}" for line in comment.splitlines()]
    if mapping.rate:
        lines += [f"time = {{ rate = {toml_string(mapping.rate)} }}", ""]
    if mapping.time:
        why = f"  # {one_line(mapping.why)}" if mapping.why else ""
        check = f", check = {toml_string(mapping.check)}" if mapping.check else ""
        column, unit = toml_string(mapping.time), toml_string(mapping.time_unit)
        lines += [f"time = {{ column = {column}, unit = {unit}{check} }}{why}", ""]
    lines.append("[columns]")
    for column, entry in mapping.entries.items():
        values = {
            each.name: value
            for each in fields(entry)
            if each.name != "why" and (value := getattr(entry, each.name)) != each.default
        }
        parts = [
            f"{key} = {toml_string(value) if isinstance(value, str) else f'{value:.12g}'}"
            for key, value in values.items()
        ]
        why = f"  # {one_line(entry.why)}" if entry.why else ""
        lines.append(f"{toml_string(column)} = {{ {', '.join(parts)} }}{why}")
    return "\n".join(lines) + "\n"


def correction_text(run: Run, correction: Correction) -> str:
    """The mapping that reads a recording as a correction does, at import.

    Args:
        run: as recorded, with its columns.
        correction: of it.
    """
    entries = {}
    for channel, recorded in run.channels.items():
        reading = correction.reading(channel)
        if reading.source in run.channels:
            entries[reading.source] = Entry(
                channel,
                recorded.unit,
                sign=-1.0 if reading.factor < 0 else 1.0,
                scale=abs(reading.factor),
                offset=f"{reading.offset:.12g} {recorded.unit}" if reading.offset else "",
                late=f"{reading.late:.12g} s" if reading.late else "",
                fast=reading.pace,
                turn=f"{reading.turn:.12g} {run.channels[reading.source].unit}" if reading.turn else "",
            )
    comment = f"Made by armdyn inspect: armdyn import {run.name} --output DIR --map THIS"
    return map_text(ColumnMap(entries, "time", "s"), comment)
