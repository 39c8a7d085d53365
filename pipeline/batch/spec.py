"""Read the specification (SPEC) of a batch: a TOML file that names the task, the models and the recordings.

```toml
task = "compare"                            # or "repair"
[[recordings]]
model = "robots/{robot}/model.toml"         # {robot} stands for any name, here and in `runs`
runs = ["robots/{robot}/logs/*.csv"]
[time]                                      # optional: the source of a recording's time
from = "name"
```
"""

import glob
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from armdyn.errors import InputError, UnknownNameError, error_location
from armdyn.recording.sidecar import utc_time
from armdyn.toml_file import read_toml
from armdyn.user_code import check_code
from pipeline.batch.change import DEFAULT_FALSE_ALARM_PROBABILITY
from pipeline.batch.times import (
    RecordingTime,
    RecordingTimeRules,
    RecordingTimeSource,
    is_date_format,
    relative_path_text,
)
from urdf.toml_tables import TomlValueCheck, table_to_dataclass

BATCH_TASKS = ("compare", "repair")
ROBOT_PLACEHOLDER = "{robot}"
FALSE_ALARM_PROBABILITY_RANGE = (1e-3, 0.2)
"""Smallest and largest allowed probability of a false alarm; a smaller one needs more simulated batches."""
TIME_SOURCES = {place.key: place for place in RecordingTimeSource if place is not RecordingTimeSource.NOWHERE}
"""Sources of a recording's time, by the name that the specification uses."""
MAX_BATCH_FILES = 200_000
"""Largest number of recordings of a batch, whose results are held in memory."""


_Text = Annotated[str, TomlValueCheck(bool, "give a name")]
_LOW, _HIGH = FALSE_ALARM_PROBABILITY_RANGE


@dataclass(frozen=True)
class _Recordings:
    """A table ``[[recordings]]``: a model and its recordings."""

    model: _Text
    runs: Annotated[
        _Text | tuple[_Text, ...], TomlValueCheck(bool, 'write a list of files or patterns, such as ["logs/*.csv"]')
    ]
    robot: str = ""
    calibrate: tuple[_Text, ...] = ()
    times: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Time:
    """The table ``[time]``: see `RecordingTimeRules`."""

    from_: (
        Annotated[str, TomlValueCheck(TIME_SOURCES.__contains__, f"choose one of {', '.join(TIME_SOURCES)}")] | None
    ) = None
    form: Annotated[
        str, TomlValueCheck(lambda f: not f or is_date_format(f), 'write what the name is, such as "log_%d%m%Y_%H%M"')
    ] = ""


@dataclass(frozen=True)
class _Changes:
    """The table ``[changes]``: the probability of a false alarm."""

    false_alarms: Annotated[
        float, TomlValueCheck(lambda rate: _LOW <= rate <= _HIGH, f"give a probability from {_LOW:g} to {_HIGH:g}")
    ] = DEFAULT_FALSE_ALARM_PROBABILITY


@dataclass(frozen=True)
class _Entries:
    task: str = "compare"
    trust_data: bool = False
    effects: _Text | None = None
    recordings: tuple[_Recordings, ...] = ()
    time: _Time = _Time()
    changes: _Changes = _Changes()


@dataclass(frozen=True)
class BatchItem:
    """One model and one recording of a batch.

    Attributes:
        robot: name of the robot.
        model: file of the model.
        run: file of the recording.
        when: time of the recording.
        calibrate: recordings of the robot in good condition; if there are any, the recording is also searched for
            events such as contacts.
    """

    robot: str
    model: Path
    run: Path
    recording_time: RecordingTime
    calibrate: tuple[Path, ...] = ()


@dataclass(frozen=True)
class BatchSpec:
    """Content of a batch's specification: a task, models and recordings.

    Attributes:
        folder: folder of the specification's file, to which its paths are relative.
        task: one of `BATCH_TASKS`.
        effects: file with effects that the user has written; None without one.
        items: recordings with their models, in the order of the specification, sorted by name within an entry.
        false_alarms: probability of a false change in a batch in which nothing changes.
        trust: whether to use recordings in which a mistake was found.
    """

    folder: Path
    task: str
    effects: Path | None
    items: tuple[BatchItem, ...]
    false_alarms: float
    trust: bool = False

    def relative_name(self, path: Path) -> str:
        """A file's path relative to the specification's folder."""
        return relative_path_text(path, self.folder)


def read_spec(path: Path) -> BatchSpec:
    """Read the specification of a batch, and find the files that match its patterns.

    Raises:
        InputError: the specification cannot be used; the message names the file, the entry and a remedy.
    """
    table = read_toml(path, ": see docs/batch.md for one", finite=True)
    with error_location(path):
        return _spec(table, Path(path).resolve().parent)


def _spec(table: Mapping[str, Any], folder: Path) -> BatchSpec:
    said = table_to_dataclass(_Entries, table)
    if said.task not in BATCH_TASKS:
        raise UnknownNameError("task", said.task, BATCH_TASKS)
    if not said.recordings:
        raise InputError('there are no [[recordings]]: write below such a line model = "m.toml" and runs = ["*.csv"]')
    effects = folder / said.effects if said.effects is not None else None
    if effects is not None:
        check_code(effects, folder)
    clock = RecordingTimeRules(None if said.time.from_ is None else TIME_SOURCES[said.time.from_], said.time.form)
    items: dict[tuple[Path, Path], BatchItem] = {}
    for number, entry in enumerate(said.recordings, start=1):
        where = f"[[recordings]] {number}"
        for item in _items(entry, where, folder, clock):
            items.setdefault((item.model, item.run), item)
            if len(items) > MAX_BATCH_FILES:
                raise InputError(f"{where}: more than {MAX_BATCH_FILES} recordings: split the batch")
    return BatchSpec(folder, said.task, effects, tuple(items.values()), said.changes.false_alarms, said.trust_data)


def _items(entry: _Recordings, where: str, folder: Path, clock: RecordingTimeRules) -> Iterator[BatchItem]:
    runs = [entry.runs] if isinstance(entry.runs, str) else entry.runs
    if ROBOT_PLACEHOLDER not in entry.model and any(ROBOT_PLACEHOLDER in run for run in (*runs, *entry.calibrate)):
        raise InputError(
            f"{where}: runs: {ROBOT_PLACEHOLDER} stands for what it is in `model`, which lacks it: write it there"
        )
    times = {name: utc_time(value, f"{where}: times: '{name}'") for name, value in entry.times.items()}
    named: set[str] = set()
    for robot, model in _models(entry.model, where, folder):
        sound = tuple(path for run in entry.calibrate for path in _runs(run, robot, f"{where}: calibrate", folder))
        for run in runs:
            for path in _runs(run, robot, f"{where}: runs", folder):
                named |= {path.name, relative_path_text(path, folder)}
                yield BatchItem(
                    entry.robot or robot or model.stem, model, path, clock.find_time(path, folder, times), sound
                )
    for name in times:
        if name not in named:
            raise UnknownNameError(f"recording in times of {where}", name, sorted(named))


def _runs(pattern: str, robot: str, where: str, folder: Path) -> list[Path]:
    """Recordings that match a pattern."""
    found = _matching(pattern.replace(ROBOT_PLACEHOLDER, glob.escape(robot)), folder)
    found = [path for path in found if path.suffix.lower() != ".toml"]
    if not found:
        raise InputError(f"{where}: '{pattern.replace(ROBOT_PLACEHOLDER, robot)}' matches no recording: correct it")
    return found


def _models(pattern: str, where: str, folder: Path) -> list[tuple[str, Path]]:
    """Names of robots and their model files; the name is empty if the pattern does not contain ``{robot}``."""
    found = [path for path in _matching(pattern.replace(ROBOT_PLACEHOLDER, "*"), folder) if path.is_file()]
    if not found:
        raise InputError(f"{where}: model: '{pattern}' matches no file: correct it")
    if ROBOT_PLACEHOLDER not in pattern:
        return [("", path) for path in found]
    parts = (re.escape(part) for part in pattern.split(ROBOT_PLACEHOLDER))
    name = re.compile("(?P<robot>[^/]+)".join([next(parts), "(?P=robot)".join(parts)]).replace(r"\*", "[^/]*"))
    matches = ((name.search(path.as_posix()), path) for path in found)
    return [(match["robot"], path) for match, path in matches if match is not None]


def _matching(pattern: str, folder: Path) -> list[Path]:
    """Sorted files that match a pattern; a pattern without wildcards is returned even if the file is missing."""
    if not glob.has_magic(pattern):
        return [folder / pattern]
    if "**" in pattern:
        _look_through(folder / pattern.partition("**")[0])
    return sorted(folder / found for found in glob.glob(pattern, root_dir=folder, recursive=True))


def _look_through(start: Path) -> None:
    """Refuse a folder that contains too many files, because searching it would take hours."""
    count = 0
    for _, folders, files in os.walk(start if start.is_dir() else start.parent):
        count += len(folders) + len(files)
        if count > MAX_BATCH_FILES:
            raise InputError(
                f"'**' below {start}: more than {MAX_BATCH_FILES} files lie there: name the folder of the recordings"
            )
