"""Make the channels of a recording from arrays or data frames in memory; one error lists all faults."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from armdyn.errors import InputError, collect_errors, error_location
from armdyn.recording.channels import (
    JOINT_CHANNELS,
    Channel,
    FloatArray,
    channel_units,
    check_clock,
    is_auxiliary,
    name_and_unit,
    unit_conversion,
)
from armdyn.recording.units import si_factor
from urdf.toml_tables import join_problems


def channels_from_arrays(
    time: Any, values: Mapping[str, Any], units: Mapping[str, str], joints: Sequence[str] = ()
) -> dict[str, Channel]:
    """Make the channels of a recording from arrays that share their time stamps.

    Args:
        time: (n,) time stamps, s, strictly increasing.
        values: (n,) samples by name, such as ``"load_force"`` or ``"q.elbow [deg]"``, with nan for missing samples;
            ``"q"``, ``"v"``, ``"a"`` and ``"tau"`` may have (n, j), a column for each of `joints`.
        units: units by name, where they are neither in the name nor SI.
        joints: names of the columns of two-dimensional values.

    Raises:
        InputError: the arrays cannot be used; the message lists all faults.
    """
    problems: list[str] = []
    stamps: FloatArray | None = None
    with collect_errors(problems):
        stamps = _numbers("time", time)
        check_clock(stamps)
    sound = not problems
    columns, shapes = _columns(values, joints)
    problems += shapes
    found: dict[str, Channel] = {}
    for label, raw in columns.items():
        name, written = name_and_unit(label)
        with collect_errors(problems):
            value = _numbers(name, raw)
            with error_location(f"'{name}'"):
                # Units that are not given are SI.
                usual = "" if is_auxiliary(name) else channel_units(name)[0]
                to_si = unit_conversion(name, written or units.get(name) or units.get(name.partition(".")[0]) or usual)
                if name in found:
                    raise InputError("is given twice")
                if stamps is not None and value.shape != stamps.shape:
                    raise InputError(f"has shape {value.shape} where time has {stamps.shape}")
                present = np.isfinite(value)
                clock = stamps if sound and stamps is not None else np.arange(len(value), dtype=float)
                found[name] = Channel(clock[present], to_si(value[present]), to_si.unit)
    for name in units:
        if not any(name in (known, known.partition(".")[0]) for known in (name_and_unit(k)[0] for k in columns)):
            problems.append(f"a unit is given for '{name}', which is not among the values")
    if not columns:
        problems.append("no values: give at least one channel, such as 'load_force'")
    if problems:
        raise InputError(join_problems(problems))
    return found


def time_and_columns_of_frame(frame: Any) -> tuple[Any, dict[str, Any]]:
    """Split a data frame (pandas, polars, pyarrow or a mapping) into its time, (n,) s, and its other columns by name.

    The time is the column ``time`` (``time [ms]`` in another unit), else the index of a pandas frame; durations and
    dates become seconds.

    Raises:
        InputError: there is no time column.
    """
    # pyarrow has `column_names`, pandas and polars `columns`; those of pandas have no truth value.
    names = list(getattr(frame, "column_names", frame.columns if hasattr(frame, "columns") else frame.keys()))
    columns = {str(name): frame[name] for name in names}
    for label in columns:
        name, unit = name_and_unit(label)
        if name == "time":
            return time_in_seconds(columns.pop(label), unit or "s"), columns
    index = getattr(frame, "index", None)
    if index is None or callable(index):
        raise InputError("no 'time' column: add one, in seconds, or name it 'time [ms]'")
    return time_in_seconds(index, "s"), columns


def time_in_seconds(time: Any, unit: str) -> FloatArray:
    """Convert time stamps to s, (n,), from numbers in `unit`, durations or dates.

    Raises:
        InputError: the unit is not a unit of time.
    """
    array = np.asarray(time)
    if array.dtype.kind in "mM":
        return np.asarray((array - array[0]) / np.timedelta64(1, "ns") * 1e-9)
    return np.asarray(array, dtype=float) * si_factor(unit, "s")


def _columns(values: Mapping[str, Any], joints: Sequence[str]) -> tuple[dict[str, Any], list[str]]:
    """One column per channel, and a sentence on each value of a wrong shape."""
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


def _numbers(name: str, raw: Any) -> FloatArray:
    try:
        return np.asarray(raw, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"'{name}' does not hold numbers alone: leave a missing sample nan") from error
