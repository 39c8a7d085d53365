"""The first sheet of an Excel workbook (.xlsx), which is XML in a ZIP archive."""

import io
import re
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

from armdyn.errors import InputError, error_location
from armdyn.recording.bytes_in import read_bytes
from pipeline.imports.foreign import ForeignReader, ForeignRecording
from pipeline.imports.table import columns_of_text
from urdf.bounds import MAX_TABLE_CELLS, MAX_TABLE_COLUMNS, MAX_XML_BYTES, MIB

_SPACE = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
SHEET_PATH, STRINGS_PATH = "xl/worksheets/sheet1.xml", "xl/sharedStrings.xml"
"""Paths of the first sheet and of the texts of all cells in an Excel workbook."""
MAX_SHEET_ROWS = 2**20
"""Largest number of rows that Excel itself writes."""


def read_sheet(path: Path) -> ForeignRecording:
    """Read the columns of the first sheet of an Excel workbook, in the same way as those of a CSV file.

    Raises:
        InputError: the file is not a workbook or is too large, or its first sheet is not a table.
    """
    data = read_bytes(path)
    with error_location(path):
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                names = archive.namelist()
                strings = (
                    [_text(item) for item in _elements(archive, STRINGS_PATH, "si")] if STRINGS_PATH in names else []
                )
                rows = list(_rows(_elements(archive, SHEET_PATH, "row"), strings))
        except (zipfile.BadZipFile, KeyError, ET.ParseError, ValueError, IndexError, OSError, RuntimeError) as error:
            raise InputError(f"is not an Excel workbook that can be read ({error}): save it as CSV") from error
        return columns_of_text(path.stem, "".join("\t".join(row) + "\n" for row in rows))


def _elements(archive: zipfile.ZipFile, name: str, tag: str) -> Iterator[ET.Element]:
    """Iterate over the elements of a part of the workbook, without keeping their content."""
    if archive.getinfo(name).file_size > MAX_XML_BYTES:
        raise InputError(f"its sheet is larger than {MAX_XML_BYTES / MIB:g} MiB: save it as CSV")
    with archive.open(name) as part:
        found = (element for _, element in ET.iterparse(part) if element.tag == f"{_SPACE}{tag}")
        for number, element in enumerate(found):
            if number == MAX_SHEET_ROWS:
                raise InputError(f"it has more than {MAX_SHEET_ROWS} rows or texts: save as CSV what you need of it")
            yield element
            element.clear()


def _text(item: ET.Element) -> str:
    return " ".join("".join(part.text or "" for part in item.iter(f"{_SPACE}t")).split())


def _rows(sheet: Iterable[ET.Element], strings: list[str]) -> Iterator[list[str]]:
    """The cells of each row as text, empty ones included."""
    width = total = 0
    for row in sheet:
        cells: dict[int, str] = {}
        for cell in row:
            kind, value = cell.get("t", "n"), cell.findtext(f"{_SPACE}v") or ""
            text = strings[int(value)] if kind == "s" else _text(cell) if kind == "inlineStr" else value
            cells[_column(cell.get("r", ""), len(cells))] = text
        width = max(width, 1 + max(cells, default=-1))
        total += width
        if width > MAX_TABLE_COLUMNS or total > MAX_TABLE_CELLS:
            raise InputError(
                f"its sheet has more than {MAX_TABLE_COLUMNS} columns, or {MAX_TABLE_CELLS} cells with the empty ones: "
                "save as CSV what you need of it"
            )
        yield [cells.get(i, "") for i in range(width)]


def _column(reference: str, default: int) -> int:
    """Index of the column of a cell such as ``AB12``."""
    column = 0
    for letter in re.split("[^A-Z]", reference, maxsplit=1)[0][:3]:
        column = 26 * column + ord(letter) - ord("A") + 1
    return column - 1 if column else default


READERS = (ForeignReader(lambda path: [read_sheet(path)], (".xlsx",)),)
