"""A recording as somebody else wrote it, a table, a bag or a data set: columns of numbers, whatever they are called."""

import glob
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from armdyn.inspection.check import Check, Severity
from armdyn.recording.channels import FloatArray, name_and_unit


@dataclass(frozen=True, eq=False)
class Column:
    """Numbers under one name.

    Attributes:
        value: (n,), nan for missing samples.
        unit: as it is written in the file; empty where it is not.
        time: (n,) s; None in a table, where a column of it is the time.
        channel: of the contract, where the file itself says so, such as a joint's position in a JointState.
        source: topic that it comes from; empty in a table.
    """

    value: FloatArray
    unit: str = ""
    time: FloatArray | None = None
    channel: str = ""
    source: str = ""


@dataclass(frozen=True)
class Account:
    """What became of the messages of a topic, or of the rows of a table.

    Attributes:
        source: the topic; empty of a table.
        came: how many there were.
        kept: how many became rows.
        left_out: how many did not, by reason, as in "3 whose stamp goes back".
        steps: s by which its clock was set, of each time that it was.
        stamped: False where stamps could not be used, and times are those at which messages were recorded.
    """

    source: str
    came: int
    kept: int
    left_out: Mapping[str, int] = field(default_factory=dict)
    steps: tuple[float, ...] = ()
    stamped: bool = True

    @property
    def sentence(self) -> str:
        """For a person."""
        things = "messages" if self.source else "rows"
        said = [f"{self.came} {things} came, " + ("all" if self.kept == self.came else str(self.kept)) + " are used"]
        if self.left_out:
            said.append("left out are " + ", ".join(f"{count} {why}" for why, count in self.left_out.items()))
        if self.steps:
            sizes = ", ".join(f"{step:+.6g}" for step in self.steps[:SHOWN])
            more = f" and {len(self.steps) - SHOWN} more" if len(self.steps) > SHOWN else ""
            said.append(f"the clock was set by {sizes} s{more}: a gap stands there")
        if not self.stamped:
            said.append("its stamps cannot be used: times are those at which it was recorded")
        return (f"{self.source}: " if self.source else "") + "; ".join(said)

    def checks(self, run: str) -> list[Check]:
        """What a person must know before the run of this name is believed."""
        if any(why.startswith(SECOND) for why in self.left_out):
            return [
                Check(
                    "second_publisher", Severity.SUSPECT, run, (), self.sentence,
                    "see that the right one was taken; if not, record it alone ('rosbag filter')",
                )
            ]  # fmt: skip
        if self.steps or not self.stamped:
            return [
                Check(
                    "samples_dropped", Severity.SUSPECT, run, (), self.sentence,
                    "look for what set the clock, or for a driver that does not stamp",
                )
            ]  # fmt: skip
        if self.left_out:
            return [
                Check(
                    "samples_dropped", Severity.NOTE, run, (), self.sentence,
                    "nothing to do: what was left out is missing in the run",
                )
            ]  # fmt: skip
        return []


SECOND = "of a second publisher"
"""How the reason begins why its messages are left out."""
SHOWN = 3
"""Steps of a clock that a sentence holds."""


@dataclass(frozen=True, eq=False)
class Foreign:
    """One recording.

    Attributes:
        name: of the run that it becomes, without an ending.
        columns: by name, as the file calls them.
        notes: sentences on what was left out while reading.
        texts: by name: what a column of text says that says the same throughout, such as a joint's name.
        accounts: by topic: what became of its messages; of a table that is not known before its time is.
        headed: False of a table without a header, whose columns are called by their place.
    """

    name: str
    columns: Mapping[str, Column]
    notes: tuple[str, ...] = field(default=())
    texts: Mapping[str, str] = field(default_factory=dict)
    accounts: Mapping[str, Account] = field(default_factory=dict)
    headed: bool = True

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
        parts: patterns of files, `name` that of the directory, by which it is known where that one is missing, as
            after a recorder that was killed.
    """

    read: Callable[[Path], list[Foreign]]
    endings: tuple[str, ...] = ()
    folder: str = ""
    marker: str = ""
    parts: tuple[str, ...] = ()

    def accepts(self, path: Path) -> bool:
        """Whether a file or directory is of this kind."""
        if path.is_dir():
            name = glob.escape(path.resolve().name)
            known = [self.marker, *(part.format(name=name) for part in self.parts)] if self.marker else []
            return any(file.is_file() for pattern in known for file in path.glob(pattern))
        return path.suffix.lower() in self.endings
