"""Tables from elsewhere: CSV of any dialect, Parquet, and LeRobot data sets.

A LeRobot data set is Parquet files beside ``meta/info.json``; it becomes a run per episode.
"""

import io
import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armdyn.arrays import time_in_seconds
from armdyn.errors import InputError, error_location
from armdyn.recording.bytes_in import read_bytes
from armdyn.recording.delimited import CutOffError, header_of, parse_delimited, read_text, separator_of
from pipeline.imports.foreign import ForeignColumn, ForeignReader, ForeignRecording, split_name_and_unit
from pipeline.imports.head import single_header_table
from pipeline.imports.lists import NAME_WORDS, columns_of_lists, lists_in, quoted_lists
from pipeline.imports.words import name_words
from urdf.bounds import (
    MAX_NAME_CHARACTERS,
    MAX_RECORDING_ROWS,
    MAX_TABLE_CELLS,
    MAX_TABLE_COLUMNS,
    MAX_TEXT_FILE_BYTES,
    MAX_VALUE_BEFORE_UNIT_CONVERSION,
    MIB,
    printable_excerpt,
)

if TYPE_CHECKING:
    import pyarrow as pa


MISSING_VALUE_TEXTS = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", ".", "?", "inf", "-inf"})
_WORD = re.compile(r"[^\W\d_]+(?:[ ./-]+[^\W\d_]+)*")
"""Text that a device writes in place of a number, such as ``overflow`` or ``no signal``; the sample is missing."""


def read_csv_of_any_dialect(path: Path) -> ForeignRecording:
    """Read the columns of a CSV file with commas, semicolons, tabs or blanks, and decimal points or commas.

    Comments, lines above the header, columns of text and a last row that may be cut off are left out, with a note.

    Raises:
        InputError: the file is not text, or its rows have different numbers of cells.
    """
    with error_location(path):
        return columns_of_text(path.stem, read_text(path, ("utf-8-sig", "cp1252")))  # cp1252 is what spreadsheets save


def columns_of_text(name: str, text: str) -> ForeignRecording:
    """Recording from the text of a table; see `read_csv_of_any_dialect`."""
    text, headed, notes = single_header_table(text)
    separator = separator_of(header_of(text))
    text = quoted_lists(text, separator)
    try:
        table = parse_delimited(text, separator, MISSING_VALUE_TEXTS, decimal_comma=True)
    except CutOffError as error:
        table = parse_delimited(text[: text.rfind("\n") + 1], separator, MISSING_VALUE_TEXTS, decimal_comma=True)
        notes.append(
            f"{str(error).partition(':')[0]}: the file ends without a newline and may be cut off: row left out"
        )
    if not len(table.rows):
        raise InputError("holds a header and no row: give a recording")
    columns: dict[str, ForeignColumn] = {}
    texts = {}
    lists = dict[str, dict[int, tuple[str, ...]]]()
    units = dict[str, str]()
    for i, label in enumerate(table.labels):
        column, unit = split_name_and_unit(label)
        if column in columns:
            notes.append(f"'{column}' stands in the header again: that column is called '{column}#{i + 1}'")
        column = column if column and column not in columns else f"{column or 'column'}#{i + 1}"
        value, strange = table.values[:, i], table.texts.get(i, {})
        if len(strange) > len(value) / 2:
            cells, different = list(strange.values()), dict.fromkeys(strange.values())
            if (items := lists_in(column, strange, table.rows.tolist())) is not None:
                lists[column], units[column] = items, unit
                continue
            if len(cells) == len(value) and (moments := _moments(cells)) is not None:
                columns[column] = ForeignColumn(moments, "s")
                continue
            if len(cells) == len(value) and len(different) == 1:
                texts[column] = cells[0]
            notes.append(f"'{column}' holds text, such as {cells[0]!r}: left out")
            continue
        wrong = {row: cell for row, cell in strange.items() if not _WORD.fullmatch(cell)}
        wrong |= {
            int(row): f"{value[row]:g}" for row in np.flatnonzero(np.abs(value) > MAX_VALUE_BEFORE_UNIT_CONVERSION)
        }
        if wrong:
            row, cell = next(iter(wrong.items()))
            raise InputError(
                f"row {table.rows[row]}, column '{printable_excerpt(column)}': "
                f"'{printable_excerpt(cell, 40)}' is not a number that anything has: "
                "correct it, or empty the cell"
            )
        if strange:
            cells = [repr(cell) for cell in strange.values()][:MAX_LISTED_TEXT_COLUMNS]
            notes.append(f"'{column}': {len(strange)} cells are not numbers ({', '.join(cells)}): taken as missing")
        columns[column] = ForeignColumn(value, unit)
    parts, said = columns_of_lists(lists, table.rows.tolist())
    for column, found in parts.items():
        columns |= {part: ForeignColumn(value, units[column]) for part, value in found.items()}
    if not columns:
        raise InputError("no column holds numbers: give a recording")
    return ForeignRecording(name, columns, (*notes, *said), texts, headed=headed)


MAX_LISTED_TEXT_COLUMNS = 3
"""Largest number of columns of text that a note lists."""


def _moments(cells: Sequence[str]) -> np.ndarray | None:
    """Dates as seconds since 1970 (n,), in UTC where they state no zone, or times of the day; None for other text."""
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


def read_parquet(path: Path) -> ForeignRecording:
    """Read the columns of a Parquet file; a column of lists becomes one column per entry.

    Raises:
        InputError: pyarrow is not installed, or the file cannot be read.
    """
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise InputError("Parquet files need pyarrow: pip install 'armdyn[import]'") from error
    data, columns, notes = read_bytes(path), dict[str, ForeignColumn](), []
    with error_location(path):
        try:
            with parquet.ParquetFile(io.BytesIO(data), pre_buffer=False) as file:
                _check_parquet(file, len(data))
                table = file.read()
        except (ArrowException, OSError, ValueError, OverflowError) as error:
            raise InputError(f"is not a Parquet file that can be read: {' '.join(str(error).split())}") from error
        if table.num_rows == 0:
            raise InputError("holds no row: give a recording")
    names = _entry_names(table)
    for label in table.column_names:
        name, unit = split_name_and_unit(label)
        found = _arrow_columns(name, table[label])
        if len(found) > 1 and (called := names.get(len(found))) is not None:
            found = dict(zip((f"{name}/{entry}" for entry in called), found.values(), strict=True))
        if not found:
            kind = "lists of numbers of different lengths" if _is_ragged(table[label]) else "no numbers"
            notes.append(f"'{name}' holds {kind}: left out")
        is_date = "timestamp[" in str(table[label].type) or "duration" in str(table[label].type)
        columns |= {part: ForeignColumn(value, "s" if is_date else unit) for part, value in found.items()}
    return ForeignRecording(path.stem, columns, tuple(notes))


def _check_parquet(file: Any, size: int) -> None:
    """Refuse a file whose content would not fit into memory, before it is unpacked: repeated values are compressed."""
    about = file.metadata
    groups = [about.row_group(i) for i in range(about.num_row_groups)]
    parts = [group.column(i) for group in groups for i in range(group.num_columns)]
    unpacked = sum(max(8 * part.num_values, part.total_uncompressed_size) for part in parts)
    if unpacked > 8 * MAX_TABLE_CELLS or about.num_rows > MAX_RECORDING_ROWS:
        raise InputError(
            f"{about.num_rows} rows, {size / MIB:.0f} MiB that become {unpacked / MIB:.0f} MiB or more, where "
            f"{MAX_RECORDING_ROWS} rows and {8 * MAX_TABLE_CELLS / MIB:.0f} MiB are the most: cut it"
        )
    if about.num_columns > MAX_TABLE_COLUMNS or any(
        len(name) > MAX_NAME_CHARACTERS for name in file.schema_arrow.names
    ):
        raise InputError(
            f"{about.num_columns} columns, where {MAX_TABLE_COLUMNS} with names of {MAX_NAME_CHARACTERS} letters "
            "are the most: leave some out"
        )


def _entry_names(table: "pa.Table") -> dict[int, tuple[str, ...]]:
    """Names of the entries of lists, by their number: a column such as ``name`` that has the same list in every row."""
    import pyarrow as pa

    found = {}
    for label in table.column_names:
        kind = table[label].type
        if pa.types.is_list(kind) and pa.types.is_string(kind.value_type) and NAME_WORDS & set(name_words(label)):
            lists = {tuple(row) for row in table[label].to_pylist() if row}
            if len(lists) == 1 and len(set(only := lists.pop())) == len(only) and all(map(_is_name, only)):
                found[len(only)] = only
    return found


def _is_name(text: object) -> bool:
    return isinstance(text, str) and text.isprintable() and 0 < len(text) <= MAX_NAME_CHARACTERS


def _is_ragged(values: "pa.ChunkedArray") -> bool:
    """Whether a column has lists of numbers, of different lengths."""
    import pyarrow as pa

    kind = values.type
    if not (pa.types.is_list(kind) or pa.types.is_large_list(kind)):
        return False
    return bool(pa.types.is_floating(kind.value_type) or pa.types.is_integer(kind.value_type))


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
    return {name: time_in_seconds(array, "s")} if array.dtype.kind in "mMbiuf" else {}


LEROBOT_INFO_FILE = Path("meta/info.json")
MAX_LEROBOT_FRAME_RATE = 1e5
"""Largest number of frames per second of a LeRobot data set."""
_INDEX = re.compile(r"(?P<feature>.+)/(?P<index>\d+)")


def read_lerobot(path: Path) -> list[ForeignRecording]:
    """Read every episode of a LeRobot data set of version 2 (a file per episode) or 3 (many episodes in a file).

    The entries of a feature are named as in ``info.json``: ``observation.state/elbow_flex.pos``.

    Raises:
        InputError: the description or a file cannot be read, or there is no episode.
    """
    info = _info(path)
    names = {feature: _names(about) for feature, about in info.get("features", {}).items()}
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"{path}: holds no Parquet file under data/: download the data set's data too")
    found = []
    for file in files:
        table = read_parquet(file)
        _check_widths(path, file, table.columns, info.get("features", {}))
        named = {_named(label, names): column for label, column in table.columns.items()}
        if "timestamp" not in named and info.get("fps") is not None and "frame_index" in named:
            named["timestamp"] = ForeignColumn(named["frame_index"].value / info["fps"], "s")
        if "timestamp" in named:
            named["timestamp"] = replace(named["timestamp"], unit="s")
        kept = {label: column for label, column in named.items() if label.rpartition("_")[2] != "index"}
        if "episode_index" not in named:
            found.append(ForeignRecording(file.stem, kept, table.notes))
            continue
        episodes = named["episode_index"].value
        if not np.isfinite(episodes).all():
            raise InputError(f"{file}: a row has no episode_index: give a LeRobot data set")
        for episode in np.unique(episodes):
            rows = episodes == episode
            columns = {label: replace(column, value=column.value[rows]) for label, column in kept.items()}
            found.append(ForeignRecording(f"{path.name}_episode_{int(episode):06d}", columns, table.notes))
    return found


def _info(path: Path) -> dict[str, Any]:
    try:
        info = json.loads(read_bytes(path / LEROBOT_INFO_FILE, MAX_TEXT_FILE_BYTES))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path / LEROBOT_INFO_FILE}: cannot be read as JSON: {error}") from error
    if not isinstance(info, dict) or not isinstance(info.get("features", {}), dict):
        raise InputError(f"{path / LEROBOT_INFO_FILE}: does not hold an object with features: give a LeRobot data set")
    rate = info.get("fps")
    if rate is not None and not (isinstance(rate, int | float) and 0.0 < rate <= MAX_LEROBOT_FRAME_RATE):
        text = f"fps is {printable_excerpt(str(rate))}: write frames per second, at most {MAX_LEROBOT_FRAME_RATE:g}"
        raise InputError(f"{path / LEROBOT_INFO_FILE}: {text}")
    return info


def _names(about: Any) -> list[str]:
    """Names of a feature's entries, which are a list, or a list under one key such as ``motors``."""
    names = about.get("names") if isinstance(about, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    return [str(name) for name in names] if isinstance(names, list) else []


def _check_widths(folder: Path, file: Path, columns: Mapping[str, ForeignColumn], features: Mapping[str, Any]) -> None:
    """Compare the widths of the features of numbers with their names in ``info.json``.

    Raises:
        InputError: a feature has more or fewer values in a frame than names, or a name twice.
    """
    for feature, about in features.items():
        names = _names(about)
        if not names or not str(about.get("dtype", "")).startswith(("float", "int")):
            continue
        parts = (_INDEX.fullmatch(label) for label in columns)
        width = sum(match is not None and match["feature"] == feature for match in parts) or int(feature in columns)
        said = f"{file}: {feature} has {width or 'no'} values of a frame"
        if width != len(names):
            raise InputError(
                f"{said}, and {folder / LEROBOT_INFO_FILE} names {len(names)}: correct its names there, or download "
                "the data set again"
            )
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(
                f"{folder / LEROBOT_INFO_FILE}: names '{printable_excerpt(twice[0])}' twice among the values of "
                f"{feature}: give each its own name"
            )


def _named(label: str, names: dict[str, list[str]]) -> str:
    """The column of a feature's entry, with the entry's name in place of its number."""
    match = _INDEX.fullmatch(label)
    known = names.get(match["feature"], []) if match else []
    return f"{match['feature']}/{known[index]}" if match and (index := int(match["index"])) < len(known) else label


READERS = (
    ForeignReader(lambda path: [read_csv_of_any_dialect(path)], (".csv", ".tsv", ".txt", ".dat")),
    ForeignReader(lambda path: [read_parquet(path)], (".parquet", ".pq")),
    ForeignReader(read_lerobot, (), "LeRobot data set", "meta/info.json"),
)
