"""The mapping of columns to channels, and its TOML file.

```toml
time = { column = "t", unit = "ms" }          # where columns share rows, as in a table; or { rate = "100 Hz" }, or
                                              # { period = "4 s" }: from one row to the next

[columns]
"J1 pos" = { channel = "q.shoulder", unit = "deg", sign = -1, offset = "90 deg" }
"M1 cur" = { channel = "tau.shoulder", unit = "A", torque_constant = "0.12 N m/A", gear_ratio = 100 }
```

A channel is ``sign * scale * value * (unit) + offset``, and ``late`` is the delay of its stamps. With a gear ratio N, a
motor turns N times as far and as fast as the joint and gives 1/N of its torque: positions and speeds are divided by N,
torques are multiplied by it. ``negative`` is how the register of a drive writes negative numbers.
``"x" = { channel = "swing_angle", height = "y", pivot = "fit" }`` takes the swing from the load's place in a picture.
``description``, ``[known]`` and ``[noise]`` are those of a run's sidecar.

``[commands]`` with its ``time`` and ``[commands.columns]`` are the mapping of a second file, of what joints were told,
with stamps of its own.

Where the columns of one file belong to several runs, ``[runs.NAME]`` contains the keys of one run, such as
``[runs.morning.columns]``; keys outside these tables are those of every run.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from armdyn.errors import InputError, collect_errors
from armdyn.inspection.correction import Correction
from armdyn.quoting import one_line, toml_string
from armdyn.recording.channels import channel_kind
from armdyn.recording.sidecar import Sidecar, sidecar_of
from armdyn.recording.units import parse_quantity
from armdyn.run import Run
from armdyn.toml_file import read_toml
from pipeline.imports.foreign import ForeignColumn
from urdf.toml_tables import TomlFileError, TomlValueCheck, join_problems, table_to_dataclass

TIME_HINT = (
    'write time = { column = "t", unit = "ms" }, or of rows without stamps time = { rate = "100 Hz" } '
    'or { period = "4 s" }'
)
MIN_ROW_RATE, MAX_ROW_RATE = 0.1, 1e5
"""Possible rates of a recording's rows [Hz]."""
_NAME = re.compile(r"[A-Za-z0-9_-]+")
_NEGATIVE = re.compile(r"(?:(?:complement|bit) (?:[1-9]|[12]\d|3[012]))?")
SIDECAR_KEYS = ("description", "recorded", "known", "noise")
"""Keys of a mapping that are copied to the TOML file beside the run (its sidecar)."""


@dataclass(frozen=True)
class ColumnEntry:
    """Meaning of one column in a mapping.

    Attributes:
        channel: channel of armdyn's recordings, such as ``q.elbow``.
        unit: unit of the column; empty where the file states it.
        sign: +1 or -1.
        offset: offset that is added last, with its unit; empty for none.
        gear_ratio: turns of the motor per turn of the joint, where the values are the motor's.
        torque_constant: torque per current, with its unit; empty where the column is not a current.
        scale: further factor on the values.
        late: delay of the stamps, with its unit; empty for 0.
        fast: relative rate error of the stamps' clock; positive where it runs fast.
        turn: period, with its unit, after which the values wrap around; empty where they do not.
        negative: how a drive's register writes negative numbers, such as ``complement 16`` or ``bit 15``; empty where
            the values have signs.
        height: of a load that was tracked in a picture, the column with its other coordinate; else empty.
        pivot: of such a load, the place of its pivot in the columns' unit, as ``"X Y"``, or ``"fit"``.
        check: open question of a guess; whoever has answered it deletes it.
        why: reason for the guess, for a person.
    """

    channel: str
    unit: str = ""
    sign: Annotated[float, TomlValueCheck(lambda sign: sign in (1, -1), "write 1 or -1")] = 1.0
    offset: str = ""
    gear_ratio: Annotated[
        float, TomlValueCheck(lambda ratio: 0 < ratio < 1e6, "write turns of the motor per turn of the joint")
    ] = 1.0
    torque_constant: str = ""
    scale: Annotated[
        float, TomlValueCheck(lambda scale: 0 < scale < 1e12, "write a positive number; 'sign' turns it round")
    ] = 1.0
    late: str = ""
    fast: Annotated[float, TomlValueCheck(lambda fast: -0.5 < fast < 0.5, "write a share, such as 0.015 for 1.5 %")] = (
        0.0
    )
    turn: str = ""
    negative: Annotated[
        str, TomlValueCheck(_NEGATIVE.fullmatch, "write 'complement 16' for 16 bits, or 'bit 15' for the sign's bit")
    ] = ""
    height: str = ""
    pivot: str = ""
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


def reason_comment(why: str, check: str) -> str:
    """Comment in a mapping file: the reason for a guess, and its open question after the word CHECK.

    Args:
        why: the reason.
        check: the open question; empty for none.
    """
    return f"{why}; CHECK: {check}" if check else why


@dataclass(frozen=True)
class ColumnMap:
    """Mapping of the columns of a recording to channels.

    Attributes:
        entries: entries by column.
        time: column with the time of a table; empty where there is none.
        time_unit: unit of that column; empty where the file states it.
        sidecar: content of the run's sidecar.
        why: reason for the guess of the time.
        check: open question of that guess.
        rate: rate of the rows of a table without stamps, with its unit; empty where there are stamps.
        notes: sentences on meanings that were recognised without a person.
        commands: mapping of the columns of a second file, with what joints were told; None without such a file.
    """

    entries: Mapping[str, ColumnEntry]
    time: str = ""
    time_unit: str = ""
    sidecar: Sidecar = field(default_factory=Sidecar)
    why: str = ""
    check: str = ""
    rate: str = ""
    notes: tuple[str, ...] = ()
    commands: "ColumnMap | None" = None

    @property
    def asked(self) -> dict[str, str]:
        """Open questions of a guessed mapping, by channel; ``"time"`` is the key of the time column."""
        of_columns = {e.channel: f"'{name}': {e.check}" for name, e in self.entries.items() if e.check}
        own = ({"time": f"'{self.time}': {self.check}"} if self.check else {}) | of_columns
        return own if self.commands is None else self.commands.asked | own

    @property
    def confirmed(self) -> "ColumnMap":
        """The mapping without open questions: every guess is taken as right."""
        entries = {name: replace(entry, check="") for name, entry in self.entries.items()}
        commands = None if self.commands is None else self.commands.confirmed
        return replace(self, entries=entries, check="", commands=commands)


def read_map(path: Path) -> Mapping[str, ColumnMap]:
    """Read a mapping file.

    Returns:
        Mappings by the name of the run; the name is ``""`` if a recording becomes a single run.

    Raises:
        InputError: it cannot be read; the message lists every mistake.
    """
    table = read_toml(path)
    runs = table.pop("runs", {"": {}})
    if not isinstance(runs, dict) or not runs or not all(isinstance(own, dict) for own in runs.values()):
        raise InputError(
            f"{path}: runs: write what belongs to one run into a table with its name, such as [runs.morning.columns]"
        )
    problems: list[str] = []
    found = {}
    for name, own in runs.items():
        with collect_errors(problems, f"runs.{name}" if name else ""):
            if name and not _NAME.fullmatch(name):
                raise InputError(f"call a run by letters, digits, '_' and '-', not '{one_line(name)}'")
            found[name] = _map_of({**table, **own})
    if problems:
        raise InputError(f"{path}: {join_problems(problems)}")
    return found


def _map_of(table: Mapping[str, Any]) -> ColumnMap:
    problems = [
        f"unknown key '{key}': a mapping has time, columns, commands, runs, {', '.join(SIDECAR_KEYS)}"
        for key in table
        if key not in ("time", "columns", "commands", *SIDECAR_KEYS)
    ]
    time = table.get("time", {})
    time = {"column": time} if isinstance(time, str) else time
    if not isinstance(time, dict) or not (
        set(time) <= {"column", "unit", "check"} or set(time) in ({"rate"}, {"period"})
    ):
        problems.append(f"time: {TIME_HINT}")
        time = {}
    rate = str(time.get("rate", ""))
    with collect_errors(problems, "time"):
        if "period" in time:
            seconds = parse_quantity(str(time["period"]), "s").value
            if not seconds > 0.0:
                raise InputError(f"'{time['period']}' is not a time from one row to the next: write it as '4 s'")
            rate = f"{1.0 / seconds!r} Hz"
        check_table_sample_rate(rate)
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
            entries[name] = table_to_dataclass(ColumnEntry, column)
        except TomlFileError as error:
            problems += [f"'{name}': {problem}" for problem in error.problems]
        with collect_errors(problems, f"'{name}'"):
            channel_kind(str(column["channel"]))
    told = None
    if "commands" in table:
        with collect_errors(problems, "commands"):
            told = _map_of_commands(table["commands"])
    sidecar = Sidecar()
    with collect_errors(problems):
        sidecar = sidecar_of({key: table[key] for key in SIDECAR_KEYS if key in table})
    if problems:
        raise InputError(join_problems(problems))
    column, unit, check = (str(time.get(key, "")) for key in ("column", "unit", "check"))
    return ColumnMap(entries, column, unit, sidecar, check=check, rate=rate, commands=told)


def _map_of_commands(table: object) -> ColumnMap:
    if not isinstance(table, dict) or not set(table) <= {"time", "columns"}:
        raise InputError("write [commands.columns], and what time the file of commands has: [commands] time = ...")
    return _map_of(table)


def check_table_sample_rate(rate: str) -> None:
    """Refuse an impossible sampling rate of rows, such as ``"1 mHz"``; an empty text is accepted.

    Raises:
        InputError: the text is not a frequency, or the rate is impossible.
    """
    if rate and not MIN_ROW_RATE <= parse_quantity(rate, "Hz").value <= MAX_ROW_RATE:
        raise InputError(f"'{rate}' is not a rate of a recording: give rows per second, such as '100 Hz'")


LISTED_CHANNELS = (
    "q.JOINT [rad]", "v.JOINT [rad/s]", "tau.JOINT [N m]", "q_cmd.JOINT", "v_cmd.JOINT", "tau_ff.JOINT",
    "current.JOINT [A]",
    "duty.JOINT [1]", "voltage.JOINT [V]", "enabled.JOINT [1]", "gripper_x [m]", "load_force [N]", "swing_angle [rad]",
    "extra.NAME",
)  # fmt: skip
"""Channels that a column may be, for a person who fills in a mapping."""
TIME_QUESTION = '# time = { column = "WHICH", unit = "s" }  # or the rows per second: time = { rate = "100 Hz" }\n'


def column_map_toml(mapping: ColumnMap, comment: str = "", unknown: Mapping[str, ForeignColumn] | None = None) -> str:
    """Text of a mapping file in TOML: `comment` at its head, and beside each guessed column a comment why.

    Columns of the recording in `unknown`, that are not mapped, are lines of comment for a person to fill in.
    """

    def line(name: str, values: Mapping[str, object], why: str) -> str:
        parts = (f"{k} = {toml_string(v) if isinstance(v, str) else f'{v:.12g}'}" for k, v in values.items())
        return f"{name} = {{ {', '.join(parts)} }}" + (f"  # {one_line(why)}" if why else "")

    def section(own: ColumnMap, prefix: str) -> list[str]:
        lines = []
        if own.rate:
            lines += [line("time", {"rate": own.rate}, ""), ""]
        if own.time:
            check = {"check": own.check} if own.check else {}
            lines += [line("time", {"column": own.time, "unit": own.time_unit, **check}, own.why), ""]
        lines.append(f"[{prefix}columns]")
        for column, entry in own.entries.items():
            given = {f.name: getattr(entry, f.name) for f in fields(entry) if getattr(entry, f.name) != f.default}
            given.pop("why", None)
            lines.append(line(toml_string(column), given, entry.why))
        return lines

    def question(name: str, column: ForeignColumn) -> str:
        present = column.value[np.isfinite(column.value)]
        between = f"from {present.min():.3g} to {present.max():.3g}" if present.size else "empty"
        asked = {"channel": "WHICH", "unit": column.unit or "WHICH"}
        return "# " + line(toml_string(name), asked, f"{between}: which channel is it, in which unit?")

    lines = [*(f"# {one_line(line)}" for line in comment.splitlines()), *section(mapping, "")]
    known = {*mapping.entries, mapping.time, *(entry.height for entry in mapping.entries.values())}
    left = {name: column for name, column in (unknown or {}).items() if name not in known}
    if left and not (mapping.time or mapping.rate):
        lines.insert(len(lines) - 1 - len(mapping.entries), TIME_QUESTION)
    if left:
        lines += [f"# Channels: {', '.join(LISTED_CHANNELS)}.", *(question(*each) for each in left.items())]
    if mapping.commands is not None:
        lines += ["", "[commands]", *section(mapping.commands, "commands.")]
    return "\n".join(lines) + "\n"


def correction_toml(run: Run, correction: Correction) -> str:
    """Text of a mapping file that applies the correction of a recorded run during an import."""
    entries = {}
    for channel, recorded in run.channels.items():
        reading = correction.reading(channel)
        if reading.source in run.channels:
            entries[reading.source] = ColumnEntry(
                channel,
                recorded.unit,
                sign=-1.0 if reading.factor < 0 else 1.0,
                scale=abs(reading.factor),
                offset=f"{reading.offset:.12g} {recorded.unit}" if reading.offset else "",
                late=f"{reading.delay:.12g} s" if reading.delay else "",
                fast=reading.clock_rate_error,
                turn=f"{reading.wrap_period:.12g} {run.channels[reading.source].unit}" if reading.wrap_period else "",
            )
    comment = f"Made by armdyn inspect: armdyn import {run.name} --output DIR --map THIS"
    return column_map_toml(ColumnMap(entries, "time", "s"), comment)
