"""Does what a SPEC asks for, and only what was not done before; what came of it stands in a journal, then in Parquet.

The journal has a line for each outcome, written as they come: whatever ends a batch, what was finished is kept. It is
only ever added to, by one process at a time. A last line that was cut off by a crash is cut away; of two outcomes of
one job the later counts. The Parquet file has a column per quantity, its unit in its name.
"""

import dataclasses
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from armdyn import atomic
from armdyn.bytes_in import read_bytes
from armdyn.errors import InputError
from pipeline.batch.spec import Item, Spec
from pipeline.batch.work import Job, Outcome, key_of, key_of_model
from pipeline.batch.workers import outcomes
from urdf.bounds import LARGEST_JOURNAL, LARGEST_LINE

JOURNAL = "outcomes.jsonl"


class Journal:
    """The outcomes of one folder; use `opened`.

    Attributes:
        outcomes: by key of their job.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.outcomes: dict[str, Outcome] = {}
        whole = self._read()
        self._file = path.open("ab")
        self._file.truncate(whole)

    def _read(self) -> int:
        """Read what is there; the number of bytes that are whole lines."""
        if not self._path.exists():
            return 0
        data = read_bytes(self._path, LARGEST_JOURNAL)
        whole = data.rfind(b"\n") + 1
        for line in data[:whole].splitlines():
            if len(line) > LARGEST_LINE:
                continue
            try:
                outcome = Outcome.of(json.loads(line))
            except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
                continue  # a disk's mistake, or another version's: the job is done again
            self.outcomes[outcome.key] = outcome
        return whole

    def add(self, outcome: Outcome) -> None:
        """Keep an outcome.

        Raises:
            InputError: the disk is full.
        """
        line = json.dumps(dataclasses.asdict(outcome), allow_nan=False) + "\n"
        try:
            self._file.write(line.encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise InputError(
                f"cannot write {self._path}: {error.strerror or error}; make room and run it again"
            ) from error
        self.outcomes[outcome.key] = outcome

    def close(self) -> None:
        """Nothing more comes; what a full disk did not take was told when it was added."""
        with suppress(OSError):
            self._file.close()


@contextmanager
def opened(folder: Path) -> Iterator[Journal]:
    """The journal of a folder that this process alone writes to.

    Raises:
        InputError: the folder cannot be written to.
    """
    try:
        journal = Journal(folder / JOURNAL)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}; choose another --output") from error
    try:
        yield journal
    finally:
        journal.close()


@dataclass(frozen=True)
class Row:
    """One recording: what the SPEC says of it, and what came out."""

    item: Item
    outcome: Outcome


@dataclass(frozen=True)
class Done:
    """What a batch has.

    Attributes:
        rows: of everything that is finished, in the order of the SPEC.
        left: recordings that are not.
        worked: recordings that were done this time.
    """

    rows: tuple[Row, ...]
    left: int
    worked: int


def run_batch(
    spec: Spec,
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    stopped: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = lambda _: None,
) -> Done:
    """Do what is not done yet, and keep every outcome as soon as it is there.

    Args:
        spec: what to do.
        folder: where outcomes are kept; this process alone writes to it.
        workers: processes of this machine; as many as it has cores where it is not given.
        scheduler: of a dask cluster that does the work instead.
        stopped: asked often; where it says so, what is finished is returned.
        say: told how far it is.

    Raises:
        InputError: a model cannot be used, or the folder cannot be written to, or there is no scheduler.
        TaskFailedError: the scheduler is gone.
    """
    say("reading the models")
    models = {item.model: "" for item in spec.items}
    for path in models:
        models[path] = key_of_model(path, spec.effects)
    keys: dict[tuple[Path, Path], str] = {}
    jobs: dict[str, Job] = {}
    for number, item in enumerate(spec.items):
        if stopped():
            break
        if number % 20 == 0:
            say(f"{number} of {len(spec.items)} recordings looked at")
        model_key = models[item.model]
        task = f"{spec.task}, trusted" if spec.trust else spec.task
        key = keys[item.model, item.run] = key_of(task, model_key, spec.name(item.run), item.run)
        jobs[key] = Job(key, spec.task, item.model.resolve(), model_key, item.run.resolve(), spec.effects, spec.trust)
    with opened(folder) as journal:
        kept = {key for key, outcome in journal.outcomes.items() if not outcome.passing}
        todo = [job for key, job in jobs.items() if key not in kept]
        there, worked = len(jobs) - len(todo), 0
        say(f"{there} of {len(jobs)} recordings done")
        if todo and not stopped():
            processes = min(workers or os.cpu_count() or 1, len(todo))
            for outcome in outcomes(todo, processes, scheduler, stopped):
                journal.add(outcome)
                worked += 1
                say(f"{there + worked} of {len(jobs)} recordings done")
        found = ((item, journal.outcomes.get(keys.get((item.model, item.run), ""))) for item in spec.items)
        rows = [Row(item, outcome) for item, outcome in found if outcome is not None]
    return Done(tuple(rows), len(spec.items) - len(rows), worked)


ROWS = "batch.parquet"


def check_parquet() -> None:
    """Refuse early where nothing can write the file.

    Raises:
        InputError: pyarrow is missing.
    """
    if find_spec("pyarrow") is None:
        raise InputError("a batch needs pyarrow: run 'pip install armdyn[batch]'")


def write_parquet(path: Path, spec: Spec, rows: Sequence[Row]) -> None:
    """Write the rows in one step.

    Raises:
        InputError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    fixed = {
        "robot": pa.string(), "model": pa.string(), "recording": pa.string(), "time": pa.timestamp("us", tz="UTC"),
        "time_from": pa.string(), "verdict": pa.string(), "problem": pa.string(), "sentence": pa.string(),
        "explained": pa.float64(), "effects": pa.list_(pa.string()), "chi2_per_sample": pa.float64(),
        "intervals_hold": pa.bool_(), "duration [s]": pa.float64(), "seconds": pa.float64(),
    }  # fmt: skip
    cells = [_cells(spec, row) for row in rows]
    numbers = sorted({name for cell in cells for name in cell if name not in fixed}, key=_order)
    columns = {name: pa.array([cell.get(name) for cell in cells], kind) for name, kind in fixed.items()}
    columns |= {name: pa.array([cell.get(name) for cell in cells], pa.float64()) for name in numbers}
    with atomic.replacing(path) as file:
        pq.write_table(pa.table(columns), file, compression="zstd")


def _cells(spec: Spec, row: Row) -> Mapping[str, Any]:
    item, outcome = row.item, row.outcome
    cells: dict[str, Any] = {
        "robot": item.robot,
        "model": spec.name(item.model),
        "recording": spec.name(item.run),
        "time": item.when.time,
        "time_from": item.when.source.key if item.when.time is not None else None,
        "verdict": outcome.verdict or None,
        "problem": outcome.problem or None,
        "sentence": outcome.sentence or None,
        "explained": outcome.explained,
        "effects": list(outcome.effects) if outcome.verdict else None,
        "chi2_per_sample": outcome.chi2_per_sample,
        "intervals_hold": outcome.intervals_hold if outcome.verdict else None,
        "duration [s]": outcome.duration,
        "seconds": outcome.seconds,
    }
    for name, channel in (outcome.channels or {}).items():
        cells[f"rmse.{name} [{channel['unit']}]"] = channel["rmse"]
        cells[f"noise.{name} [{channel['unit']}]"] = channel["noise_std"]
    for name, parameter in (outcome.parameters or {}).items():
        cells[f"value.{name} [{parameter['unit']}]"] = parameter["value"]
        cells[f"std.{name} [{parameter['unit']}]"] = parameter["std"]
    return cells


def _order(name: str) -> tuple[int, str, str]:
    """Errors first; a standard deviation beside its value."""
    kind, _, rest = name.partition(".")
    return (0 if kind in ("rmse", "noise") else 1, rest, "" if kind in ("rmse", "value") else kind)
