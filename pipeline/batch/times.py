"""Find the time of a recording in the batch's specification, in its sidecar file, or in a date in its file name."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path, PurePosixPath

from armdyn.errors import InputError
from armdyn.recording.sidecar import read_sidecar

EARLIEST_YEAR, LATEST_YEAR = 1990, 2100
"""First and last year that a date in a file name may have; other numbers of eight digits are not dates."""
DATE_PATTERN = re.compile(
    r"(?<!\d)(?P<year>\d{4})(?P<between>[-_.]?)(?P<month>\d{2})(?P=between)(?P<day>\d{2})"
    r"(?:[T_ -]{1,2}(?P<hour>\d{2})[-:.h_]?(?P<minute>\d{2})(?:[-:.m_]?(?P<second>\d{2}))?)?(?!\d)"
)
"""Pattern of a date in a file name: year, month and day with equal or no separators, and an optional time of day."""


class RecordingTimeSource(Enum):
    """Source of a recording's time; the value is a text for messages."""

    SPEC = "the SPEC"
    SIDECAR = "the sidecar"
    NAME = "a date in the name"
    NOWHERE = "nowhere"

    @property
    def key(self) -> str:
        """Name of the source in the specification and in result files."""
        return self.name.lower()


def is_date_format(form: str) -> bool:
    """Whether a text is a valid format of `datetime.strptime`, such as ``log_%d%m%Y``."""
    try:
        datetime.strptime(datetime(2001, 2, 3, tzinfo=UTC).strftime(form), form)
    except (ValueError, re.error, OverflowError):
        return False
    return "%" in form


@dataclass(frozen=True)
class RecordingTime:
    """Time of a recording, and its source.

    Attributes:
        time: time in UTC; None if it is unknown.
        source: where the time was found.
        problem: why the time is unknown; empty if it is known.
    """

    time: datetime | None
    source: RecordingTimeSource
    problem: str = ""


@dataclass(frozen=True)
class RecordingTimeRules:
    """Rules for finding the time of a recording.

    Attributes:
        required_time_source: the only source to use; None for the first of specification, sidecar file and file name
            that has a time.
        date_format: format of the whole file name without suffix, for `datetime.strptime`; empty to search the name
            for a date in the order year, month, day.
    """

    required_time_source: RecordingTimeSource | None = None
    date_format: str = ""

    def find_time(self, path: Path, folder: Path, given: Mapping[str, datetime]) -> RecordingTime:
        """Find the time of a recording.

        Args:
            path: file of the recording.
            folder: folder of the specification; the names of folders below it are searched for a date too.
            given: times in the specification, by file name or by path relative to `folder`.
        """
        name = relative_path_text(path, folder)
        for source in (
            [self.required_time_source]
            if self.required_time_source is not None
            else [RecordingTimeSource.SPEC, RecordingTimeSource.SIDECAR, RecordingTimeSource.NAME]
        ):
            found: datetime | str | None
            if source is RecordingTimeSource.SPEC:
                found = given.get(name, given.get(path.name))
            elif source is RecordingTimeSource.SIDECAR:
                found = _of_sidecar(path)
            else:
                found = self._of_name(name)
            if isinstance(found, datetime):
                return RecordingTime(found, source)
            if isinstance(found, str):
                return RecordingTime(None, RecordingTimeSource.NOWHERE, found)
        where = (
            "the SPEC, the sidecar or a date in the name"
            if self.required_time_source is None
            else self.required_time_source.value
        )
        return RecordingTime(None, RecordingTimeSource.NOWHERE, f"no time in {where}")

    def _of_name(self, name: str) -> datetime | str | None:
        if self.date_format:
            stem = PurePosixPath(name).stem
            try:
                return datetime.strptime(stem, self.date_format).replace(tzinfo=None)
            except (ValueError, OverflowError):
                return f"the name is not of the form {self.date_format}"
        for part in (PurePosixPath(name).stem, *reversed(PurePosixPath(name).parts[:-1])):
            dates = {found for match in DATE_PATTERN.finditer(part) if (found := _date(match)) is not None}
            if len(dates) > 1:
                return f"several dates in '{part}': set [time] form, or give it in times"
            if dates:
                return dates.pop()
        return None


def relative_path_text(path: Path, folder: Path) -> str:
    """A file's path, relative to the given folder if the file is inside it."""
    return (path.relative_to(folder) if path.is_relative_to(folder) else path).as_posix()


def _of_sidecar(path: Path) -> datetime | None:
    try:
        if path.suffix.lower() == ".mcap" and not path.with_suffix(".toml").exists():
            from armdyn.recording.mcap_run import read_mcap

            return read_mcap(path, recover=True).sidecar.recorded
        return read_sidecar(path.with_suffix(".toml")).recorded
    except InputError:  # the recording cannot be used, and its row says so
        return None


def _date(match: re.Match[str]) -> datetime | None:
    year, month, day = (int(match[key]) for key in ("year", "month", "day"))
    hour, minute, second = (int(match[key] or 0) for key in ("hour", "minute", "second"))
    if not EARLIEST_YEAR <= year <= LATEST_YEAR:
        return None
    try:
        found = datetime(year, month, day)
    except ValueError:
        return None
    try:
        return found.replace(hour=hour, minute=minute, second=second)
    except ValueError:  # another number that follows the day
        return found
