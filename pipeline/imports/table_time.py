"""Find the column of a table that is its time, and the column's unit."""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from armdyn.errors import InputError
from pipeline.imports.foreign import ForeignRecording
from pipeline.imports.mapping import ColumnMap
from pipeline.imports.units import joined_doubts
from pipeline.imports.words import is_unit_like, name_words, split_column_header, word_set

TIME_WORDS = word_set("time t timestamp timestamps stamp clock seconds secs sec zeit duration elapsed utime ts epoch")
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds per unit of time that a header may leave out, the most likely unit first."""
SHORTEST_SAMPLE_STEP_SECONDS, LONGEST_SAMPLE_STEP_SECONDS = 5e-5, 0.5
"""Shortest and longest possible time between two samples of a robot's recording [s]."""
AS_WRITTEN = "as written"
"""Why a unit is believed that the header states."""
MIN_ROW_SHARE_WITH_RISING_TIME = 0.9
"""Smallest share of rows in which a time column must increase; single stamps may be wrong."""


def unambiguous_time(foreign: ForeignRecording) -> ColumnMap:
    """A mapping with the time of a table: ``time``, or a column about which there is no doubt."""
    with suppress(InputError):
        if "time" not in foreign.columns and not (found := guess_time(foreign)).check:
            return replace(found, why="")
    return ColumnMap({}, "time")


def guess_time(foreign: ForeignRecording) -> ColumnMap:
    """A mapping with the most likely time of a table only.

    Raises:
        InputError: no column can be the time.
    """
    called = [
        name
        for name in foreign.columns
        if TIME_WORDS & set(name_words(name)) or is_unit_like(split_column_header(name).unit, "s")
    ]
    named, rising = (
        {name: count for name in names if (count := _count_stamps(foreign.columns[name].value, share))}
        for names, share in ((called, MIN_ROW_SHARE_WITH_RISING_TIME), (foreign.columns, 1.0))
    )
    if not (named or rising):
        raise InputError(
            f"{foreign.name}: no column rises all the time, so none is the time: give --rate, the rows per second"
        )
    counts = named or rising
    name = max(counts, key=counts.__getitem__)
    column, doubts, words = foreign.columns[name], [], name_words(name)
    if not named:
        doubts.append("no header says that it is the time")
    elif counts[name] < len(column.value):
        doubts.append(f"{len(column.value) - counts[name]} stamps are those of the row before")
    last = "s" if len(words) > 1 and words[-1] == "s" else ""  # elsewhere a single letter is hardly a unit
    unit, why = column.unit or split_column_header(name).unit or last, AS_WRITTEN
    if not is_unit_like(unit, "s"):
        step = float(np.median(np.diff(np.unique(column.value[np.isfinite(column.value)]))))
        likely = [
            u
            for u, factor in TIME_UNITS.items()
            if SHORTEST_SAMPLE_STEP_SECONDS <= step * factor <= LONGEST_SAMPLE_STEP_SECONDS
        ]
        unit, why = (likely or ["s"])[0], f"a sample every {step:.4g}" + (f" {likely[0]}" if likely else "")
        doubts += [] if likely else ["of no unit that a recording has"]
    return ColumnMap({}, name, unit, why=why, check=joined_doubts(doubts))


def in_seconds(time: ColumnMap) -> ColumnMap:
    """The time of a process, whose samples may be any time apart: in seconds, if the header states no unit; it asks."""
    if not time.time or time.why == AS_WRITTEN:
        return time
    return replace(time, time_unit="s", why="", check=joined_doubts([time.check, "no unit is written: seconds?"]))


def _count_stamps(value: np.ndarray, share: float) -> int:
    """Number of different stamps (n,) of a column; 0 where it does not rise in this share of its rows."""
    known = value[np.isfinite(value)]
    if len(known) < max(2, share * len(value)) or np.mean(np.diff(known) >= 0.0) < share or np.ptp(known) == 0.0:
        return 0
    return len(np.unique(known))
