"""Parse text tables, such as CSV files, of armdyn and of other programs.

Rows are counted as in a spreadsheet: the header is row 1 where no blank line is before it.
"""

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from armdyn.errors import InputError
from armdyn.recording.bytes_in import read_bytes
from armdyn.recording.channels import FloatArray, name_and_unit
from armdyn.recording.cut_off_end import ROWS_COMPARED_WITH_LAST, cut_off_message, is_complete_cell
from urdf.bounds import (
    MAX_LINE_BYTES,
    MAX_NAME_CHARACTERS,
    MAX_RECORDING_ROWS,
    MAX_TABLE_CELLS,
    MAX_TABLE_COLUMNS,
    MIB,
    parse_number,
    printable_excerpt,
)

BLOCK_CHARACTERS = 2**20
"""Number of characters of a table that are split into cells at once, which limits the memory."""
MISSING_CELLS = frozenset({"", "nan", "-nan", "+nan"})
"""Texts of cells that mean a missing sample, in lower case."""
IntArray = npt.NDArray[np.int64]
_LINE = re.compile(r"[^\n]*\n|[^\n]+")


class CutOffError(InputError):
    """A file ends in the middle of its last row, or may do so."""


@dataclass(frozen=True, eq=False)
class DelimitedTable:
    """A table of n rows and c columns.

    Attributes:
        labels: (c,) cells of the header.
        values: (n, c) numbers, nan where a cell is empty or no number.
        rows: (n,) row number of each row.
        texts: cells that are neither a number nor missing, by column and by index in `rows`.
    """

    labels: tuple[str, ...]
    values: FloatArray
    rows: IntArray
    texts: Mapping[int, Mapping[int, str]]


def read_text(path: Path, encodings: Sequence[str] = ("utf-8-sig",)) -> str:
    """Read the text of a file, with line feeds between its lines.

    Raises:
        InputError: the file cannot be read, is empty or is not text.
    """
    data = read_bytes(path)
    if not data or data.isspace():
        raise InputError(f"{path}: is empty: record again or give another file")
    if data.startswith(b"\x89MCAP"):
        raise InputError(f"{path}: is an MCAP recording: rename it to end in .mcap")
    if b"\0" in data:
        raise InputError(f"{path}: is not a text file: give a CSV or an .mcap recording")
    _check_size(data, path)
    for encoding in encodings:
        try:
            return data.decode(encoding).replace("\r\n", "\n").replace("\r", "\n")
        except UnicodeDecodeError as error:
            row = data.count(b"\n", 0, error.start) + 1
    raise InputError(f"{path}: row {row} is not UTF-8 text: give a CSV saved as UTF-8, or an .mcap")


def _check_size(data: bytes, path: Path) -> None:
    """Refuse too many rows or cells, and rows that are too long, before the text is split."""
    if data.count(b"\n") > MAX_RECORDING_ROWS or max(map(data.count, (b",", b";", b"\t"))) > MAX_TABLE_CELLS:
        raise InputError(
            f"{path}: has more than {MAX_RECORDING_ROWS} rows or {MAX_TABLE_CELLS} cells: cut it, or record more slowly"
        )
    start = 0
    while start + MAX_LINE_BYTES < len(data):
        end = max(data.rfind(mark, start, start + MAX_LINE_BYTES + 1) for mark in (b"\n", b"\r")) + 1
        if end == 0:
            row = data.count(b"\n", 0, start) + 1
            raise InputError(f"{path}: row {row} is longer than {MAX_LINE_BYTES / MIB:g} MiB: give a table with rows")
        start = end


def header_of(text: str) -> str:
    """The first line of a text that is not blank: the header of a table."""
    return next((match[0].rstrip("\n") for match in _LINE.finditer(text) if match[0].strip()), "")


def separator_of(header: str) -> str:
    """The character that separates the cells of a header; a semicolon before a tab before a comma, else a space."""
    return next((separator for separator in (";", "\t", ",") if separator in header), " ")


def labels_of(header: str, separator: str) -> tuple[str, ...]:
    """Split a header into its cells.

    Raises:
        InputError: there are too many cells, or a cell is too long or not printable.
    """
    labels = tuple(cell.strip() for _, cells in _split(header, separator) for cell in cells)
    if len(labels) > MAX_TABLE_COLUMNS:
        raise InputError(f"has {len(labels)} columns where {MAX_TABLE_COLUMNS} are the most: leave some out")
    for place, label in enumerate(labels, start=1):
        if len(label) > MAX_NAME_CHARACTERS or not label.isprintable():
            raise InputError(
                f"column {place} '{printable_excerpt(label)}': "
                f"a name has at most {MAX_NAME_CHARACTERS} printable letters: rename it"
            )
    return labels


def parse_delimited(
    text: str, separator: str = ",", missing: Collection[str] = MISSING_CELLS, *, decimal_comma: bool = False
) -> DelimitedTable:
    """Parse the header and the numbers of a table.

    Args:
        text: text of the table; see `read_text`.
        separator: separator between cells.
        missing: cells of missing samples, in lower case.
        decimal_comma: whether a cell ``0,5`` is a number.

    Raises:
        CutOffError: the file ends in the middle of a row.
        InputError: the table has too many rows or columns, or a row has another number of cells than the header.
    """
    header = header_of(text)
    start = text.find(header) + len(header) + 1
    row = text.count("\n", 0, start) + (start > len(text)) + 1
    labels = labels_of(header, separator)
    unfinished = start < len(text) and not text.endswith("\n")  # a complete file ends in a newline
    size = len(text) if '"' in text else BLOCK_CHARACTERS  # a cell in quotes may contain line breaks
    tables, rows = [np.empty((0, len(labels)))], [np.empty(0, dtype=np.int64)]
    texts: dict[int, dict[int, str]] = {}
    count = 0
    while start < len(text):
        end = text.find("\n", start + size) + 1 or len(text)
        block = text[start:end]
        table, found = _plain(block, len(labels), separator, decimal_comma), np.arange(row, row + block.count("\n"))
        if table is None:
            lines = _split(block, separator, row)
            _check_widths(lines, labels, unfinished and end == len(text))
            table = np.empty((len(lines), len(labels)))
            for i, (_, cells) in enumerate(lines):
                for k, cell in enumerate(cells):
                    table[i, k] = _number(cell, missing, decimal_comma)
                    if table[i, k] == np.inf:
                        table[i, k] = np.nan
                        texts.setdefault(k, {})[count + i] = cell.strip()
            found = np.array([at for at, _ in lines], dtype=np.int64)
        tables.append(table)
        rows.append(found)
        count, row, start = count + len(table), row + block.count("\n"), end
        if count > MAX_RECORDING_ROWS or count * len(labels) > MAX_TABLE_CELLS:
            most = min(MAX_RECORDING_ROWS, MAX_TABLE_CELLS // max(len(labels), 1))
            raise InputError(f"has more than {most} rows of {len(labels)} columns: cut it, or record more slowly")
    last = text[text.rfind("\n") + 1 :]
    if unfinished and last.strip():
        tail = text[text.find(header) + len(header) :][-BLOCK_CHARACTERS:].split("\n")[1:]
        ends = [line.rpartition(separator)[2] for line in tail[-ROWS_COMPARED_WITH_LAST - 1 :] if line.strip()]
        if not is_complete_cell(ends):
            raise CutOffError(cut_off_message(row, ends[-1], name_and_unit(labels[-1])[0]))
    return DelimitedTable(labels, np.concatenate(tables), np.concatenate(rows), texts)


def _plain(block: str, width: int, separator: str, decimal_comma: bool) -> FloatArray | None:
    """Complete rows of `width` numbers or empty cells, (n, width); None where any cell is something else."""
    if separator != ",":
        block = block.replace(",", "." if decimal_comma else "_").replace(separator, ",")
    if not block.endswith("\n") or not block.isascii() or "_" in block or '"' in block:
        return None
    marks = np.frombuffer(block.encode("ascii"), dtype=np.uint8)
    commas = np.cumsum(marks == ord(","))[marks == ord("\n")]
    if (np.diff(commas, prepend=0) != width - 1).any():
        return None
    cells = block[:-1].replace("\n", ",").split(",")
    try:
        if "" in cells:
            values = np.array([float(cell) if cell else np.nan for cell in cells])
        else:
            values = np.fromiter(map(float, cells), dtype=float, count=len(cells))
    except ValueError:
        return None
    table = values.reshape(-1, width)
    return None if np.isinf(values).any() or (np.isnan(table).all(axis=1)).any() else table


def _split(block: str, separator: str, row: int = 1) -> list[tuple[int, list[str]]]:
    """Split rows into cells, with each row's number; empty rows are left out, the first line is number `row`."""
    lines = (match[0] for match in _LINE.finditer(block))  # a stream of text would take four times its memory
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    try:
        return [(row + reader.line_num - 1, cells) for cells in reader if any(map(str.strip, cells))]
    except csv.Error as error:
        raise InputError(f"is not a table: {error}: give a CSV") from error


def _check_widths(lines: Sequence[tuple[int, list[str]]], labels: Sequence[str], unfinished: bool) -> None:
    for row, cells in lines:
        if len(cells) < len(labels) and unfinished and row == lines[-1][0]:
            raise CutOffError(cut_off_message(row, cells[-1], name_and_unit(labels[len(cells) - 1])[0]))
        if len(cells) != len(labels):
            raise InputError(
                f"row {row} has {len(cells)} cells where the header has {len(labels)}: correct or remove the row"
            )


def _number(cell: str, missing: Collection[str], decimal_comma: bool) -> float:
    """Number in a cell; nan where it is missing, and infinity where it is text."""
    text = cell.strip()
    if text.lower() in missing:
        return np.nan
    try:
        return parse_number(text.replace(",", ".") if decimal_comma else text)
    except ValueError:
        return np.inf
