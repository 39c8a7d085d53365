"""A recording as somebody else wrote it, a table, a bag or a data set: columns of numbers, whatever they are called."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from armdyn.channels import FloatArray, name_and_unit


@dataclass(frozen=True, eq=False)
class Column:
    """Numbers under one name.

    Attributes:
        value: (n,), nan for missing samples.
        unit: as it is written in the file; empty where it is not.
        time: (n,) s; None in a table, where a column of it is the time.
        channel: of the contract, where the file itself says so, such as a joint's position in a JointState.
    """

    value: FloatArray
    unit: str = ""
    time: FloatArray | None = None
    channel: str = ""


@dataclass(frozen=True, eq=False)
class Foreign:
    """One recording.

    Attributes:
        name: of the run that it becomes, without an ending.
        columns: by name, as the file calls them.
        notes: sentences on what was left out while reading.
        texts: by name: what a column of text says that says the same throughout, such as a joint's name.
    """

    name: str
    columns: Mapping[str, Column]
    notes: tuple[str, ...] = field(default=())
    texts: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_table(self) -> bool:
        """Whether all columns share rows, and time is one of them."""
        return all(column.time is None for column in self.columns.values())


def split_label(label: str) -> tuple[str, str]:
    """Name and unit of a column's header: ``q [deg]``, ``q (deg)`` and ``q``; ``q[0]`` is the name of an entry."""
    name, unit = name_and_unit(label)
    if not unit and label.rstrip().endswith(")") and "(" in label:
        name, _, rest = label.strip().rpartition("(")
        name, unit = name.strip(), rest[:-1].strip()
    return (label.strip(), "") if unit.isdigit() else (name, unit)


@dataclass(frozen=True)
class Reader:
    """Reads one kind of recording.

    Attributes:
        read: the recordings in a file or directory; most hold one.
        endings: of the files' names.
        folder: what a directory of this kind is; empty where it is never one.
        marker: file in such a directory, by which it is known.
    """

    read: Callable[[Path], list[Foreign]]
    endings: tuple[str, ...] = ()
    folder: str = ""
    marker: str = ""

    def accepts(self, path: Path) -> bool:
        """Whether a file or directory is of this kind."""
        if path.is_dir():
            return bool(self.marker) and (path / self.marker).is_file()
        return path.suffix.lower() in self.endings
