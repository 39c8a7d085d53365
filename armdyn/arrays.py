"""Channels from arrays and data frames in memory; every problem is told at once."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from armdyn.channels import (
    JOINT_CHANNELS,
    Channel,
    FloatArray,
    channel_unit,
    channel_units,
    name_and_unit,
)
from armdyn.errors import InputError
from armdyn.units import si_factor


def channels_of(
    time: Any, values: Mapping[str, Any], units: Mapping[str, str], joints: Sequence[str] = ()
) -> dict[str, Channel]:
    """Channels that share their time stamps.

    Args:
        time: (n,) s, strictly increasing.
        values: by name, such as ``"load_force"`` or ``"q.elbow [deg]"``, (n,) with nan for missing samples; ``"q"``,
            ``"v"``, ``"a"`` and ``"tau"`` may hold (n, j), a column for each of `joints`.
        units: by name, where they are neither in the name nor SI.
        joints: names of the columns of two-dimensional values.

    Raises:
        InputError: lists everything that is wrong.
    """
    problems: list[str] = []
    stamps = _numbers("time", time, problems)
    if stamps is not None:
        problems += _clock_problems(stamps)
    columns, shapes = _columns(values, joints)
    problems += shapes
    found: dict[str, Channel] = {}
    for label, raw in columns.items():
        name, written = name_and_unit(label)
        value = _numbers(name, raw, problems)
        try:
            # Units that are not given are SI: what stands in memory has been read by somebody.
            unit, factor = channel_unit(name, written or _given(units, name) or channel_units(name)[0])
        except InputError as error:
            problems.append(f"'{name}': {error}")
            continue
        if name in found:
            problems.append(f"'{name}' is given twice")
        if value is None or stamps is None:
            continue
        if value.shape != stamps.shape:
            problems.append(f"'{name}' has shape {value.shape} where time has {stamps.shape}")
            continue
        present = np.isfinite(value)
        try:
            found[name] = Channel(stamps[present], value[present] * factor, unit)
        except InputError as error:
            problems.append(f"'{name}': {error}")
    for name in units:
        if not any(name in (known, known.partition(".")[0]) for known in (name_and_unit(k)[0] for k in columns)):
            problems.append(f"a unit is given for '{name}', which is not among the values")
    if not columns:
        problems.append("no values: give at least one channel, such as 'load_force'")
    if problems:
        raise InputError(listed(problems))
    return found


def frame_columns(frame: Any) -> tuple[Any, dict[str, Any]]:
    """Time and values of a data frame of pandas, polars or pyarrow, or of a mapping.

    Time is the column ``time`` (``time [ms]`` in another unit), else the index of a frame of pandas; durations and
    dates become seconds.

    Raises:
        InputError: there is no time.
    """
    # pyarrow has `column_names`, pandas and polars `columns`; those of pandas have no truth value.
    names = list(getattr(frame, "column_names", frame.columns if hasattr(frame, "columns") else frame.keys()))
    columns = {str(name): frame[name] for name in names}
    for label in columns:
        name, unit = name_and_unit(label)
        if name == "time":
            return seconds(columns.pop(label), unit or "s"), columns
    index = getattr(frame, "index", None)
    if index is None or callable(index):
        raise InputError("no 'time' column: add one, in seconds, or name it 'time [ms]'")
    return seconds(index, "s"), columns


def seconds(time: Any, unit: str) -> FloatArray:
    """(n,) stamps in s, of numbers in `unit`, of durations or of dates.

    Raises:
        InputError: the unit is none of time.
    """
    array = np.asarray(time)
    if array.dtype.kind in "mM":
        return np.asarray((array - array[0]) / np.timedelta64(1, "ns") * 1e-9)
    return np.asarray(array, dtype=float) * si_factor(unit, "s")


def listed(problems: Sequence[str]) -> str:
    """All problems in one line."""
    if len(problems) == 1:
        return problems[0]
    return f"{len(problems)} problems: " + "; ".join(f"({i}) {text}" for i, text in enumerate(problems, start=1))


def _columns(values: Mapping[str, Any], joints: Sequence[str]) -> tuple[dict[str, Any], list[str]]:
    """One column per channel, and what is wrong with the shapes."""
    found: dict[str, Any] = {}
    problems = []
    for label, raw in values.items():
        name, unit = name_and_unit(label)
        if name not in JOINT_CHANNELS:
            found[label] = raw
            continue
        table = np.asarray(raw)
        if table.ndim != 2 or table.shape[1] != len(joints):
            problems.append(
                f"'{name}' has shape {table.shape}: give one column for each of {len(joints)} joints, and their names "
                "as joints=['elbow', ...]"
            )
            continue
        for i, joint in enumerate(joints):
            found[f"{name}.{joint}" + (f" [{unit}]" if unit else "")] = table[:, i]
    return found, problems


def _given(units: Mapping[str, str], name: str) -> str:
    return units.get(name) or units.get(name.partition(".")[0]) or ""


def _numbers(name: str, raw: Any, problems: list[str]) -> FloatArray | None:
    try:
        return np.asarray(raw, dtype=float)
    except (TypeError, ValueError):
        problems.append(f"'{name}' does not hold numbers alone: leave a missing sample nan")
        return None


def _clock_problems(time: FloatArray) -> list[str]:
    if time.ndim != 1:
        return [f"time has shape {time.shape}: give one stamp per sample, (n,)"]
    if not np.isfinite(time).all():
        return [f"time is missing at sample {int(np.flatnonzero(~np.isfinite(time))[0])}"]
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        i = int(late[0])
        return [f"time does not increase at sample {i + 1}: {time[i]:.9g} s, then {time[i + 1]:.9g} s"]
    return []
