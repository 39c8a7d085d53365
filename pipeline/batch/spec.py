"""What a batch is to do: a small TOML file that names models and recordings.

```toml
task = "compare"                            # or "repair"
[[recordings]]
model = "robots/{robot}/model.toml"         # {robot}: any folder or name, the same in `runs`
runs = ["robots/{robot}/logs/*.csv"]
[time]                                      # optional; where a time is looked for
from = "name"
```
"""

import glob
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from armdyn.errors import InputError, UnknownNameError, at
from armdyn.identify.change import FALSE_ALARMS
from armdyn.sidecar import utc
from armdyn.toml_file import read_toml
from pipeline.batch.times import Clock, TimeFrom, When, seen_from
from urdf.table_file import check_keys

TASKS = ("compare", "repair")
KEYS: Mapping[str, tuple[str, ...]] = {
    "": ("task", "trust_data", "effects", "recordings", "time", "changes"),
    "[[recordings]]": ("model", "runs", "robot", "times"),
    "[time]": ("from", "form"),
    "[changes]": ("false_alarms",),
}
"""By table: what it may hold."""
ROBOT = "{robot}"
FALSE_ALARM_RANGE = (1e-3, 0.2)
"""Rarer ones cannot be told from the simulated batches; more often than that a mark means nothing."""
MOST = 200_000
"""Recordings; their rows are held in memory."""


@dataclass(frozen=True)
class Item:
    """One model and one recording.

    Attributes:
        robot: whose, for a person.
        model: its file.
        run: the recording's file.
        when: it was made.
    """

    robot: str
    model: Path
    run: Path
    when: When


@dataclass(frozen=True)
class Spec:
    """What to do.

    Attributes:
        folder: of the SPEC; paths in it begin there.
        task: of `TASKS`.
        effects: file with effects of the user's own.
        items: in the order of the SPEC, recordings of one entry by name.
        false_alarms: probability of a marked change in a batch where nothing changes.
        trust: whether to go on where a recording is not what it says it is.
    """

    folder: Path
    task: str
    effects: Path | None
    items: tuple[Item, ...]
    false_alarms: float
    trust: bool = False

    def name(self, path: Path) -> str:
        """A path as seen from the SPEC."""
        return seen_from(path, self.folder)


def read_spec(path: Path) -> Spec:
    """Read a SPEC, and find the files that it names.

    Raises:
        InputError: names the file, the field, what is wrong and what to do.
    """
    table = read_toml(path, ": see docs/batch.md for one", finite=True)
    with at(path):
        return _spec(table, Path(path).resolve().parent)


def _spec(table: Mapping[str, Any], folder: Path) -> Spec:
    check_keys(table, KEYS[""])
    task = table.get("task", "compare")
    if task not in TASKS:
        raise UnknownNameError("task", str(task), TASKS)
    trust = table.get("trust_data", False)
    if not isinstance(trust, bool):
        raise InputError(f"trust_data: {trust!r:.40}: write true or false")
    effects = folder / _text(table, "effects") if "effects" in table else None
    clock = _clock(_table(table, "time"))
    changes = _table(table, "changes")
    check_keys(changes, KEYS["[changes]"], "[changes]")
    low, high = FALSE_ALARM_RANGE
    rate = changes.get("false_alarms", FALSE_ALARMS)
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not low <= rate <= high:
        raise InputError(f"[changes] false_alarms: {rate!r:.40}: give a probability from {low:g} to {high:g}")
    entries = table.get("recordings")
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise InputError('there are no [[recordings]]: write below such a line model = "m.toml" and runs = ["*.csv"]')
    items: dict[tuple[Path, Path], Item] = {}
    for number, entry in enumerate(entries, start=1):
        where = f"[[recordings]] {number}"
        for item in _items(entry, where, folder, clock):
            items.setdefault((item.model, item.run), item)
            if len(items) > MOST:
                raise InputError(f"{where}: more than {MOST} recordings: split the batch")
    return Spec(folder, task, effects, tuple(items.values()), float(rate), trust)


def _items(entry: Mapping[str, Any], where: str, folder: Path, clock: Clock) -> Iterator[Item]:
    check_keys(entry, KEYS["[[recordings]]"], where)
    for key, example in (("model", '"m.toml"'), ("runs", '["*.csv"]')):
        if key not in entry:
            raise InputError(f"{where}: '{key}' is missing: write {key} = {example}")
    pattern, label = _text(entry, "model", where), _text(entry, "robot", where) if "robot" in entry else ""
    runs = entry["runs"] if isinstance(entry["runs"], list) else [entry["runs"]]
    if not runs or not all(isinstance(run, str) for run in runs):
        raise InputError(f'{where}: runs: write a list of files or patterns, such as ["logs/*.csv"]')
    if ROBOT not in pattern and any(ROBOT in run for run in runs):
        raise InputError(f"{where}: runs: {ROBOT} stands for what it is in `model`, which lacks it: write it there")
    times = _times(entry.get("times", {}), where)
    named: set[str] = set()
    for robot, model in _models(pattern, where, folder):
        for run in runs:
            found = _matching(run.replace(ROBOT, glob.escape(robot)), folder)
            found = [path for path in found if path.suffix.lower() != ".toml"]
            if not found:
                raise InputError(f"{where}: runs: '{run.replace(ROBOT, robot)}' matches no recording: correct it")
            for path in found:
                named |= {path.name, seen_from(path, folder)}
                yield Item(label or robot or model.stem, model, path, clock.of(path, folder, times))
    for name in times:
        if name not in named:
            raise UnknownNameError(f"recording in times of {where}", name, sorted(named))


def _models(pattern: str, where: str, folder: Path) -> list[tuple[str, Path]]:
    """Names of robots, empty where the pattern has none, and their model files."""
    found = [path for path in _matching(pattern.replace(ROBOT, "*"), folder) if path.is_file()]
    if not found:
        raise InputError(f"{where}: model: '{pattern}' matches no file: correct it")
    if ROBOT not in pattern:
        return [("", path) for path in found]
    parts = (re.escape(part) for part in pattern.split(ROBOT))
    name = re.compile("(?P<robot>[^/]+)".join([next(parts), "(?P=robot)".join(parts)]).replace(r"\*", "[^/]*"))
    matches = ((name.search(path.as_posix()), path) for path in found)
    return [(match["robot"], path) for match, path in matches if match is not None]


def _matching(pattern: str, folder: Path) -> list[Path]:
    """Files of a pattern, sorted; a name without wildcards is taken as it is, whether or not the file is there."""
    if "\0" in pattern:
        raise InputError(f"{pattern!r}: a name holds no null character: correct it")
    if not glob.has_magic(pattern):
        return [folder / pattern]
    return sorted(folder / found for found in glob.glob(pattern, root_dir=folder, recursive=True))


def _clock(table: Mapping[str, Any]) -> Clock:
    check_keys(table, KEYS["[time]"], "[time]")
    places = {place.key: place for place in TimeFrom if place is not TimeFrom.NOWHERE}
    source, form = table.get("from"), table.get("form", "")
    if source is not None and source not in places:
        raise UnknownNameError("place in [time] from", str(source), places)
    if not isinstance(form, str) or (form and "%" not in form):
        raise InputError(f'[time] form: {form!r:.40}: write what the name is, such as "log_%d%m%Y_%H%M"')
    return Clock(None if source is None else places[source], form)


def _times(given: Any, where: str) -> dict[str, datetime]:
    if not isinstance(given, dict):
        raise InputError(f'{where}: times: write times = {{ "a.csv" = 2026-05-04 }}')
    return {name: utc(value, f"{where}: times: '{name}'") for name, value in given.items()}


def _table(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise InputError(f"'{key}' is not a table: write '[{key}]' on a line of its own")
    return value


def _text(table: Mapping[str, Any], key: str, where: str = "") -> str:
    value = table[key]
    if not isinstance(value, str) or not value or "\0" in value:
        raise InputError(f"{where + ': ' if where else ''}{key}: {value!r:.60} is not a text: put it in quotes")
    return value
