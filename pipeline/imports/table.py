"""Tables from elsewhere: CSV of any dialect, Parquet, and LeRobot data sets.

A LeRobot data set is Parquet files beside ``meta/info.json``; it becomes a run per episode.
"""

import json
import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armdyn.arrays import seconds
from armdyn.errors import InputError, at
from armdyn.recording.bytes_in import read_bytes
from armdyn.recording.delimited import CutOffError, header_of, parse_delimited, read_text, separator_of
from pipeline.imports.foreign import Column, Foreign, Reader, split_label
from pipeline.imports.head import plain_table
from urdf.bounds import (
    LARGEST_CONTENT,
    LARGEST_COUNT,
    LARGEST_RECORDING,
    LARGEST_TEXT,
    LONGEST_NAME,
    MIB,
    MOST_COLUMNS,
    MOST_ROWS,
    shown,
)

if TYPE_CHECKING:
    import pyarrow as pa


MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", ".", "?", "inf", "-inf"})
_WORD = re.compile(r"[^\W\d_]+(?:[ ./-]+[^\W\d_]+)*")
"""What a device writes in place of a number, such as ``overflow`` or ``no signal``: it is missing, and told."""
SHOWN = 3
"""Cells that are named where many are wrong."""


def read_csv_of_any_dialect(path: Path) -> Foreign:
    """Columns of a CSV with commas, semicolons, tabs or blanks, and decimal points or commas.

    Comments and lines above the header are left out, as are columns that hold text and a last row that may be cut off;
    all is told.

    Raises:
        InputError: it is no text, or its rows have different numbers of cells.
    """
    with at(path):
        return of_text(path.stem, read_text(path, ("utf-8-sig", "cp1252")))  # cp1252 is what spreadsheets save


def of_text(name: str, text: str) -> Foreign:
    """The columns of a table's text; see `read_csv_of_any_dialect`."""
    text, headed, notes = plain_table(text)
    separator = separator_of(header_of(text))
    try:
        table = parse_delimited(text, separator, MISSING, decimal_comma=True)
    except CutOffError as error:
        table = parse_delimited(text[: text.rfind("\n") + 1], separator, MISSING, decimal_comma=True)
        notes.append(
            f"{str(error).partition(':')[0]}: the file ends without a newline and may be cut off: row left out"
        )
    if not len(table.rows):
        raise InputError("holds a header and no row: give a recording")
    called = name
    columns: dict[str, Column] = {}
    texts = {}
    for i, label in enumerate(table.labels):
        name, unit = split_label(label)
        if name in columns:
            notes.append(f"'{name}' stands in the header again: that column is called '{name}#{i + 1}'")
        name = name if name and name not in columns else f"{name or 'column'}#{i + 1}"
        value, strange = table.values[:, i], table.texts.get(i, {})
        if len(strange) > len(value) / 2:
            said = dict.fromkeys(strange.values())
            moments = _moments(list(strange.values())) if len(strange) == len(value) else None
            if moments is not None:
                columns[name] = Column(moments, "s")
                continue
            if len(strange) == len(value) and len(said) == 1:
                texts[name] = next(iter(said))
            notes.append(f"'{name}' holds text, such as {next(iter(said))!r}: left out")
            continue
        odd = {row: cell for row, cell in strange.items() if not _WORD.fullmatch(cell)}
        odd |= {int(row): f"{value[row]:g}" for row in np.flatnonzero(np.abs(value) > LARGEST_COUNT)}
        if odd:
            row, cell = next(iter(odd.items()))
            raise InputError(
                f"row {table.rows[row]}, column '{shown(name)}': '{shown(cell, 40)}' is no number that anything has: "
                "mend it, or empty the cell"
            )
        if strange:
            some = ", ".join(repr(cell) for cell in list(strange.values())[:SHOWN])
            notes.append(f"'{name}': {len(strange)} cells are no numbers ({some}): taken as missing")
        columns[name] = Column(value, unit)
    if not columns:
        raise InputError("no column holds numbers: give a recording")
    return Foreign(called, columns, tuple(notes), texts, headed=headed)


def _moments(cells: Sequence[str]) -> np.ndarray | None:
    """(n,) s of dates, since 1970, UTC where they name no zone, or of times of the day; None where they are neither."""
    for read in (_since_1970, _since_midnight):
        with suppress(ValueError):
            return np.array([read(cell.strip()) for cell in cells])
    return None


def _since_1970(cell: str) -> float:
    when = datetime.fromisoformat(cell)
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def _since_midnight(cell: str) -> float:
    when = time.fromisoformat(cell)
    return 3600.0 * when.hour + 60.0 * when.minute + when.second + 1e-6 * when.microsecond


def read_parquet(path: Path) -> Foreign:
    """Columns of a Parquet file; a column of lists becomes a column per entry.

    Raises:
        InputError: pyarrow is not installed, or the file cannot be read.
    """
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise InputError("Parquet files need pyarrow: pip install 'armdyn[import]'") from error
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with parquet.ParquetFile(path, pre_buffer=False) as file:
            _check_parquet(file, path)
            table = file.read()
    except (ArrowException, OSError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: is no Parquet file that can be read: {' '.join(str(error).split())}") from error
    if table.num_rows == 0:
        raise InputError(f"{path}: holds no row: give a recording")
    columns: dict[str, Column] = {}
    notes = []
    for label in table.column_names:
        name, unit = split_label(label)
        found = _arrow_columns(name, table[label])
        if not found:
            notes.append(f"'{name}' holds no numbers: left out")
        is_date = "timestamp[" in str(table[label].type) or "duration" in str(table[label].type)
        columns |= {part: Column(value, "s" if is_date else unit) for part, value in found.items()}
    return Foreign(path.stem, columns, tuple(notes))


def _check_parquet(file: Any, path: Path) -> None:
    """Refuse what would take more memory than fits, before it is unpacked: repeated values take next to no place."""
    about, size = file.metadata, path.stat().st_size
    groups = [about.row_group(i) for i in range(about.num_row_groups)]
    parts = [group.column(i) for group in groups for i in range(group.num_columns)]
    unpacked = sum(max(8 * part.num_values, part.total_uncompressed_size) for part in parts)
    if size > LARGEST_RECORDING or unpacked > LARGEST_CONTENT or about.num_rows > MOST_ROWS:
        raise InputError(
            f"{path}: {about.num_rows} rows, {size / MIB:.0f} MiB that become {unpacked / MIB:.0f} MiB or more, where "
            f"{MOST_ROWS} rows, {LARGEST_RECORDING / MIB:.0f} and {LARGEST_CONTENT / MIB:.0f} MiB are the most: cut it"
        )
    if about.num_columns > MOST_COLUMNS or any(len(name) > LONGEST_NAME for name in file.schema_arrow.names):
        raise InputError(
            f"{path}: {about.num_columns} columns, where {MOST_COLUMNS} with names of {LONGEST_NAME} letters are the "
            "most: leave some out"
        )


def _arrow_columns(name: str, values: "pa.ChunkedArray") -> dict[str, np.ndarray]:
    import pyarrow as pa

    kind = values.type
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind):
        rows = values.to_pylist()
        width = {len(row) for row in rows if row is not None}
        if len(width) != 1 or not (pa.types.is_floating(kind.value_type) or pa.types.is_integer(kind.value_type)):
            return {}
        count = width.pop()
        table = np.array([row if row is not None else [np.nan] * count for row in rows], dtype=float)
        return {f"{name}/{i}": table[:, i] for i in range(count)}
    array = values.to_numpy()
    return {name: seconds(array, "s")} if array.dtype.kind in "mMbiuf" else {}


INFO = Path("meta/info.json")
LARGEST_RATE = 1e5
"""Frames per second."""
_INDEX = re.compile(r"(?P<feature>.+)/(?P<index>\d+)")


def read_lerobot(path: Path) -> list[Foreign]:
    """Every episode of a data set of version 2 (a file per episode) or 3 (many episodes in a file).

    Entries of a feature get the names that ``info.json`` gives them: ``observation.state/elbow_flex.pos``.

    Raises:
        InputError: the description or a file cannot be read, or there is no episode.
    """
    info = _info(path)
    names = {feature: _names(about) for feature, about in info.get("features", {}).items()}
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"{path}: holds no Parquet file under data/: download the data set's data too")
    rate = info.get("fps")
    found = []
    for file in files:
        table = read_parquet(file)
        named = {_named(label, names): column for label, column in table.columns.items()}
        if "timestamp" not in named and rate is not None and "frame_index" in named:
            named["timestamp"] = Column(named["frame_index"].value / rate, "s")
        episodes = named["episode_index"].value if "episode_index" in named else None
        if episodes is not None and not np.isfinite(episodes).all():
            raise InputError(f"{file}: a row has no episode_index: give a LeRobot data set")
        for episode in [None] if episodes is None else np.unique(episodes):
            rows = slice(None) if episode is None else episodes == episode
            of_episode = {
                label: Column(column.value[rows], "s" if label == "timestamp" else column.unit)
                for label, column in named.items()
                if label.rpartition("_")[2] != "index"
            }
            name = file.stem if episode is None else f"{path.name}_episode_{int(episode):06d}"
            found.append(Foreign(name, of_episode, table.notes))
    return found


def _info(path: Path) -> dict[str, Any]:
    try:
        info = json.loads(read_bytes(path / INFO, LARGEST_TEXT))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path / INFO}: cannot be read as JSON: {error}") from error
    if not isinstance(info, dict) or not isinstance(info.get("features", {}), dict):
        raise InputError(f"{path / INFO}: does not hold an object with features: give a LeRobot data set")
    rate = info.get("fps")
    if rate is not None and not (isinstance(rate, int | float) and 0.0 < rate <= LARGEST_RATE):
        raise InputError(f"{path / INFO}: fps is {shown(str(rate))}: write frames per second, at most {LARGEST_RATE:g}")
    return info


def _names(about: Any) -> list[str]:
    """Names of a feature's entries: a list, or a list under one key such as ``motors``."""
    names = about.get("names") if isinstance(about, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    return [str(name) for name in names] if isinstance(names, list) else []


def _named(label: str, names: dict[str, list[str]]) -> str:
    match = _INDEX.fullmatch(label)
    if match is None or match["feature"] not in names:
        return label
    known, index = names[match["feature"]], int(match["index"])
    return f"{match['feature']}/{known[index]}" if index < len(known) else label


READERS = (
    Reader(lambda path: [read_csv_of_any_dialect(path)], (".csv", ".tsv", ".txt", ".dat")),
    Reader(lambda path: [read_parquet(path)], (".parquet", ".pq")),
    Reader(read_lerobot, (), "LeRobot data set", "meta/info.json"),
)
