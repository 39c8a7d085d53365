"""Run the jobs of a SPEC that were not done before; outcomes go to a journal, then to a Parquet file.

The journal has a line for each outcome, written as they come: whatever ends a batch, what was finished is kept. It is
only ever added to, by one process at a time. A last line that was cut off by a crash is cut away; of two outcomes of
one job the later counts. The Parquet file has a column per quantity, its unit in its name.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import set_forkserver_preload
from pathlib import Path
from typing import Any

from armdyn import atomic
from armdyn.errors import InputError
from armdyn.recording.bytes_in import read_bytes
from ik.workers import LostItem, map_in_processes, map_on_cluster
from pipeline.batch.spec import BatchItem, Spec
from pipeline.batch.work import Job, JobOutcome, contents, digest, key_of, key_of_model, work
from pipeline.processes import Closing
from urdf.bounds import MAX_JOURNAL_BYTES, MAX_JOURNAL_LINE_BYTES

JOURNAL = "outcomes.jsonl"
START_METHOD = "forkserver"
"""How processes begin: with everything loaded, and free of the threads of this one."""
PRELOADED = ("armdyn.arm.model", "armdyn.pendulum.model", "armdyn.identify.repair", "pipeline.answers")
"""Modules that the processes share."""


class Journal(Closing):
    """File of a batch's outcomes in one folder, to which only this process writes; use it in a ``with`` block.

    Attributes:
        outcomes: outcomes by the key of their job.

    Raises:
        InputError: the folder cannot be written to.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.outcomes: dict[str, JobOutcome] = {}
        try:
            data = read_bytes(path, MAX_JOURNAL_BYTES) if path.exists() else b""
            self._file = path.open("ab")
            whole = data.rfind(b"\n") + 1
            self._file.truncate(whole)
        except OSError as error:
            raise InputError(
                f"cannot write to {path.parent}: {error.strerror or error}; choose another --output"
            ) from error
        for line in data[:whole].splitlines():
            outcome = JobOutcome.of(line) if len(line) <= MAX_JOURNAL_LINE_BYTES else None
            if outcome is not None:  # otherwise the line is damaged or of another version: the job is done again
                self.outcomes[outcome.key] = outcome

    def add(self, outcome: JobOutcome) -> None:
        """Add an outcome to the journal.

        Raises:
            InputError: the disk is full.
        """
        try:
            self._file.write(f"{outcome.line}\n".encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise InputError(
                f"cannot write {self._path}: {error.strerror or error}; make room and run it again"
            ) from error
        self.outcomes[outcome.key] = outcome

    def close(self) -> None:
        """Close the journal; a full disk was reported when an outcome was added."""
        with suppress(OSError):
            self._file.close()


@dataclass(frozen=True)
class Row:
    """One recording of a batch: its entry in the SPEC, and its outcome."""

    item: BatchItem
    outcome: JobOutcome


@dataclass(frozen=True)
class Done:
    """Results of a batch.

    Attributes:
        rows: rows of all finished recordings, in the order of the SPEC.
        left: number of recordings that are not finished.
        worked: number of recordings that were done this time.
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
    """Do the jobs of a SPEC that are not done yet, and store every outcome at once.

    Args:
        spec: models and recordings.
        folder: folder of the outcomes; only this process writes to it.
        workers: number of processes on this machine; by default the number of cores.
        scheduler: address of a dask cluster that does the work instead.
        stopped: called often; where it returns True, the finished part is returned.
        say: called to report the progress.

    Raises:
        InputError: a model cannot be used, or the folder cannot be written to, or there is no scheduler.
        TaskFailedError: the scheduler is gone.
    """
    say("reading the models")
    models = {path: key_of_model(path, spec.effects) for path in dict.fromkeys(item.model for item in spec.items)}
    keys: dict[tuple[Path, Path], str] = {}
    jobs: dict[str, Job] = {}
    sounds: dict[tuple[Path, ...], str] = {}
    for number, item in enumerate(spec.items):
        if stopped():
            break
        if number % 20 == 0:
            say(f"{number} of {len(spec.items)} recordings looked at")
        model_key = models[item.model]
        task = f"{spec.task}, trusted" if spec.trust else spec.task
        sound = sounds[item.calibrate] = sounds.get(item.calibrate) or digest([*map(contents, item.calibrate)])
        key = keys[item.model, item.run] = key_of(task, model_key, spec.name(item.run), item.run, sound)
        jobs[key] = Job(
            key, spec.task, item.model.absolute(), model_key, item.run.absolute(), spec.effects, spec.trust,
            tuple(path.absolute() for path in item.calibrate),
        )  # fmt: skip
    with Journal(folder / JOURNAL) as journal:
        kept = {key for key, outcome in journal.outcomes.items() if not outcome.passing}
        todo = [job for key, job in jobs.items() if key not in kept]
        there, worked = len(jobs) - len(todo), 0
        say(f"{there} of {len(jobs)} recordings done")
        if todo and not stopped():
            processes = min(workers or os.cpu_count() or 1, len(todo))
            for outcome in _outcomes(todo, processes, scheduler, stopped):
                journal.add(outcome)
                worked += 1
                say(f"{there + worked} of {len(jobs)} recordings done")
        found = ((item, journal.outcomes.get(keys.get((item.model, item.run), ""))) for item in spec.items)
        rows = [Row(item, outcome) for item, outcome in found if outcome is not None]
    return Done(tuple(rows), len(spec.items) - len(rows), worked)


def _outcomes(
    jobs: Sequence[Job], processes: int, scheduler: str | None, stopped: Callable[[], bool]
) -> Iterator[JobOutcome]:
    if scheduler is None:
        if START_METHOD == "forkserver":
            set_forkserver_preload(list(PRELOADED))
        done = map_in_processes(work, jobs, processes, START_METHOD, stopped)
    else:
        done = map_on_cluster(work, jobs, scheduler, "batch", stopped)
    for job, outcome in done:
        if isinstance(outcome, LostItem):
            outcome = JobOutcome(job.key, problem=f"{outcome.reason}; the same command tries it again", passing=True)
        yield outcome


ROWS = "batch.parquet"


def check_parquet() -> None:
    """Refuse early where no library can write a Parquet file.

    Raises:
        InputError: pyarrow is missing.
    """
    if find_spec("pyarrow") is None:
        raise InputError("a batch needs pyarrow: run 'pip install armdyn[batch]'")


def write_parquet(path: Path, spec: Spec, rows: Sequence[Row]) -> None:
    """Write the rows of a batch to a Parquet file, in one step.

    Raises:
        InputError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {"text": pa.string(), "time": pa.timestamp("us", tz="UTC"), "number": pa.float64(), "truth": pa.bool_(),
             "names": pa.list_(pa.string())}  # fmt: skip
    fixed: list[tuple[str, str, Callable[[Row], Any]]] = [
        ("robot", "text", lambda row: row.item.robot),
        ("model", "text", lambda row: spec.name(row.item.model)),
        ("recording", "text", lambda row: spec.name(row.item.run)),
        ("time", "time", lambda row: row.item.when.time),
        ("time_from", "text", lambda row: row.item.when.source.key if row.item.when.time is not None else None),
        ("verdict", "text", lambda row: row.outcome.verdict or None),
        ("problem", "text", lambda row: row.outcome.problem or None),
        ("sentence", "text", lambda row: row.outcome.sentence or None),
        ("explained", "number", lambda row: row.outcome.explained),
        ("effects", "names", lambda row: row.outcome.effects if row.outcome.verdict else None),
        ("chi2_per_sample", "number", lambda row: row.outcome.chi2_per_sample),
        ("intervals_hold", "truth", lambda row: row.outcome.intervals_hold if row.outcome.verdict else None),
        ("events", "names", lambda row: row.outcome.events),
        ("duration [s]", "number", lambda row: row.outcome.duration),
        ("seconds", "number", lambda row: row.outcome.seconds),
    ]
    columns = {name: pa.array(list(map(value, rows)), kinds[kind]) for name, kind, value in fixed}
    measured = [_numbers(row.outcome) for row in rows]
    for name in sorted({name for cells in measured for name in cells}, key=_order):
        columns[name] = pa.array([cells.get(name) for cells in measured], pa.float64())
    with atomic.replacing(path) as file:
        pq.write_table(pa.table(columns), file, compression="zstd")


def _numbers(outcome: JobOutcome) -> dict[str, float | None]:
    return {
        f"{column}.{name} [{entry['unit']}]": entry[key]
        for entries, keys in (
            (outcome.channels, {"rmse": "rmse", "noise": "noise_std"}),
            (outcome.parameters, {"value": "value", "std": "std"}),
        )
        for name, entry in (entries or {}).items()
        for column, key in keys.items()
    }


def _order(name: str) -> tuple[int, str, str]:
    """Sorting key of a column: errors come first, and a standard deviation beside its value."""
    kind, _, rest = name.partition(".")
    return (0 if kind in ("rmse", "noise") else 1, rest, "" if kind in ("rmse", "value") else kind)
