"""A recording in another format, a table, a bag or a data set: columns of numbers under the names of the file."""

import glob
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from armdyn.inspection.check import Check, CheckKind, Severity
from armdyn.quoting import name_list
from armdyn.recording.channels import FloatArray, name_and_unit
from pipeline.imports.stamps import STAMP_BESIDE_RESET


@dataclass(frozen=True, eq=False)
class ForeignColumn:
    """One column of numbers of an imported recording.

    Attributes:
        value: numbers (n,); nan for a missing sample.
        unit: unit as the file writes it; empty if the file states none.
        time: times (n,) [s]; None in a table, where another column contains the time.
        channel: channel of armdyn's recordings, such as ``q.elbow``, if the format defines it; else empty.
        source: topic of the messages; empty in a table.
    """

    value: FloatArray
    unit: str = ""
    time: FloatArray | None = None
    channel: str = ""
    source: str = ""


SECOND_PUBLISHER = "of a second publisher"
"""First words of the reason why the messages of a second publisher are left out."""


@dataclass(frozen=True)
class ImportedSampleCounts:
    """Numbers of used and left-out messages of a topic, or rows of a table.

    Attributes:
        source: the topic; empty for a table.
        came: number of messages or rows in the file.
        kept: number of used messages or rows.
        left_out: number of left-out messages or rows, by reason, such as "whose stamp goes back".
        steps: every step by which the clock was set [s].
        stamped: False where the stamps are unusable, and the times are those of the recording.
    """

    source: str
    came: int
    kept: int
    left_out: Mapping[str, int] = field(default_factory=dict)
    steps: tuple[float, ...] = ()
    stamped: bool = True

    @property
    def sentence(self) -> str:
        """Sentence with the numbers of used and left-out messages or rows."""
        things = "messages" if self.source else "rows"
        said = [f"{self.came} {things} came, " + ("all" if self.kept == self.came else str(self.kept)) + " are used"]
        if self.left_out:
            said.append("left out are " + ", ".join(f"{count} {why}" for why, count in self.left_out.items()))
        if self.steps:
            gap = STAMP_BESIDE_RESET in self.left_out
            after = ": a gap stands there" if gap else ", and times of arrival join its parts"
            said.append(f"the clock was set by {name_list((f'{step:+.6g}' for step in self.steps), 3)} s{after}")
        if not self.stamped:
            said.append("its stamps cannot be used: times are those at which it was recorded")
        return (f"{self.source}: " if self.source else "") + "; ".join(said)

    def checks(self, run: str) -> list[Check]:
        """Finding for the run with this name; empty if every message is used with its own stamp."""
        kind: CheckKind = "samples_dropped"
        severity, remedy = Severity.SUSPECT, "look for what set the clock, or for a driver that does not stamp"
        if any(why.startswith(SECOND_PUBLISHER) for why in self.left_out):
            kind = "second_publisher"
            remedy = "see that the right one was taken; if not, record it alone ('rosbag filter')"
        elif self.stamped and not self.steps:
            severity, remedy = Severity.NOTE, "nothing to do: what was left out is missing in the run"
            if not self.left_out:
                return []
        return [Check(kind, severity, run, (), self.sentence, remedy)]


@dataclass(frozen=True, eq=False)
class ForeignRecording:
    """One recording in another format than armdyn's.

    Attributes:
        name: name of the run to which it is converted, without an ending.
        columns: columns by their names in the file.
        notes: sentences on what was left out while reading.
        texts: text of a column that contains the same text in every row, such as a joint's name, by column.
        accounts: by topic, how many messages were read, used and left out. A table has none before the mapping defines
            its time.
        headed: False for a table without a header, whose columns are named by their number.
    """

    name: str
    columns: Mapping[str, ForeignColumn]
    notes: tuple[str, ...] = ()
    texts: Mapping[str, str] = field(default_factory=dict)
    accounts: Mapping[str, ImportedSampleCounts] = field(default_factory=dict)
    headed: bool = True

    @property
    def is_table(self) -> bool:
        """Whether the recording is a table, in which all columns have the same rows and one column is the time."""
        return all(column.time is None for column in self.columns.values())


def split_name_and_unit(label: str) -> tuple[str, str]:
    """Name and unit of a column's header: ``q [deg]``, ``q (deg)`` and ``q``; ``q[0]`` is the name of an entry."""
    name, unit = name_and_unit(label)
    if not unit and label.rstrip().endswith(")") and "(" in label:
        name, _, rest = label.strip().rpartition("(")
        name, unit = name.strip(), rest[:-1].strip()
    return (label.strip(), "") if unit.isdigit() else (name, unit)


@dataclass(frozen=True)
class ForeignReader:
    """Reader of one format of recordings.

    Attributes:
        read: function that reads the recordings in a file or directory.
        endings: endings of the file names.
        folder: name of the kind of directory that is read; empty where directories are not read.
        marker: file by which such a directory is recognised.
        files: patterns of files, with ``{name}`` for the directory's name, by which a directory without the marker is
            recognised: a recorder that was killed has not written it.
    """

    read: Callable[[Path], list[ForeignRecording]]
    endings: tuple[str, ...] = ()
    folder: str = ""
    marker: str = ""
    files: tuple[str, ...] = ()

    def accepts(self, path: Path) -> bool:
        """Whether a file or directory has this format."""
        if not path.is_dir():
            return path.suffix.lower() in self.endings
        name = glob.escape(path.resolve().name)
        patterns = [self.marker, *(file.format(name=name) for file in self.files)] if self.marker else []
        return any(file.is_file() for pattern in patterns for file in path.glob(pattern))
