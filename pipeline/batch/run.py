"""Run the unfinished jobs of a batch; write each outcome to a journal, and all of them to a Parquet file at the end.

The journal is a text file with one line per outcome, written when the job is finished, so that an interrupted batch can
be continued. One process at a time appends to it. An incomplete last line is removed; of two outcomes of one job the
later one is used. The Parquet file has a column per quantity, with the unit in its name.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import set_forkserver_preload
from pathlib import Path
from typing import Any

from armdyn import atomic
from armdyn.errors import InputError
from armdyn.recording.bytes_in import read_bytes
from ik.workers import FailedWorkItem, map_in_processes, map_on_cluster
from pipeline.batch.spec import BatchItem, BatchSpec
from pipeline.batch.work import BatchJob, JobOutcome, file_digest, job_digest, model_digest, run_job, text_digest
from pipeline.processes import Closable
from urdf.bounds import MAX_JOURNAL_BYTES, MAX_JOURNAL_LINE_BYTES

JOURNAL_FILE = "outcomes.jsonl"
START_METHOD = "forkserver"
"""Start method of `multiprocessing`: worker processes share imported modules, but none of this process's threads."""
PRELOADED_MODULES = ("armdyn.arm.model", "armdyn.pendulum.model", "armdyn.identify.repair", "pipeline.answers")
"""Modules that are imported once for all worker processes."""


class Journal(Closable):
    """The file with one line per outcome of a batch; use it in a ``with`` block.

    Attributes:
        outcomes: outcome of each finished job, by the key of the job.

    Raises:
        InputError: the folder cannot be written to.
    """

    def __init__(self, path: Path) -> None:
        self.outcomes: dict[str, JobOutcome] = {}
        self._file = atomic.CrashSafeGrowingFile(path, append=True)
        data = read_bytes(path, MAX_JOURNAL_BYTES)
        whole = data.rfind(b"\n") + 1
        try:
            self._file.stream.truncate(whole)
        except OSError as error:
            raise InputError(
                f"cannot write to {path.parent}: {error.strerror or error}; choose another --output"
            ) from error
        for line in data[:whole].splitlines():
            outcome = JobOutcome.from_json_line(line) if len(line) <= MAX_JOURNAL_LINE_BYTES else None
            if outcome is not None:  # otherwise the line is damaged or of another version: the job is done again
                self.outcomes[outcome.key] = outcome

    def add(self, outcome: JobOutcome) -> None:
        """Append an outcome to the journal's file.

        Raises:
            InputError: the disk is full.
        """
        self._file.write(f"{outcome.line}\n", durable=True)
        if self._file.failure is not None:
            raise InputError(f"{self._file.failure}; the same command then continues")
        self.outcomes[outcome.key] = outcome

    def close(self) -> None:
        """Close the journal's file."""
        self._file.finish()


@dataclass(frozen=True)
class BatchRow:
    """One recording of a batch, and the outcome of its job."""

    item: BatchItem
    outcome: JobOutcome


@dataclass(frozen=True)
class BatchResult:
    """Results of a batch.

    Attributes:
        rows: finished recordings with their outcomes, in the order of the batch's specification.
        left: number of recordings that are not finished.
        worked: number of recordings that this call has computed.
    """

    rows: tuple[BatchRow, ...]
    unfinished: int
    computed: int


def run_batch(
    spec: BatchSpec,
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    stopped: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = lambda _: None,
) -> BatchResult:
    """Run the unfinished jobs of a batch, and store each outcome in the journal when it is finished.

    Args:
        spec: models and recordings.
        folder: folder of the journal.
        workers: number of processes on this computer; by default the number of processor cores.
        scheduler: address of a dask scheduler whose workers compute instead.
        stopped: function that is called often; when it returns True, the batch stops.
        say: function that is called with a sentence about the progress.

    Returns:
        The finished recordings.

    Raises:
        InputError: a model cannot be used, the folder cannot be written to, or the scheduler does not answer.
        TaskFailedError: the connection to the scheduler was lost.
    """
    say("reading the models")
    models = {path: model_digest(path, spec.effects) for path in dict.fromkeys(item.model for item in spec.items)}
    keys: dict[tuple[Path, Path], str] = {}
    jobs: dict[str, BatchJob] = {}
    sounds: dict[tuple[Path, ...], str] = {}
    for number, item in enumerate(spec.items):
        if stopped():
            break
        if number % 20 == 0:
            say(f"{number} of {len(spec.items)} recordings looked at")
        model_content_digest = models[item.model]
        task = f"{spec.task}, trusted" if spec.trust else spec.task
        sound = sounds[item.calibrate] = sounds.get(item.calibrate) or text_digest([*map(file_digest, item.calibrate)])
        key = keys[item.model, item.run] = job_digest(
            task, model_content_digest, spec.relative_name(item.run), item.run, sound
        )
        jobs[key] = BatchJob(
            key, spec.task, item.model.absolute(), model_content_digest, item.run.absolute(), spec.effects, spec.trust,
            tuple(path.absolute() for path in item.calibrate),
        )  # fmt: skip
    with Journal(folder / JOURNAL_FILE) as journal:
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
        rows = [BatchRow(item, outcome) for item, outcome in found if outcome is not None]
    return BatchResult(tuple(rows), len(spec.items) - len(rows), worked)


def _outcomes(
    jobs: Sequence[BatchJob], processes: int, scheduler: str | None, stopped: Callable[[], bool]
) -> Iterator[JobOutcome]:
    if scheduler is None:
        if START_METHOD == "forkserver":
            set_forkserver_preload(list(PRELOADED_MODULES))
        done = map_in_processes(run_job, jobs, processes, START_METHOD, stopped)
    else:
        done = map_on_cluster(run_job, jobs, scheduler, "batch", stopped)
    for job, outcome in done:
        if isinstance(outcome, FailedWorkItem):
            outcome = JobOutcome(job.key, problem=f"{outcome.reason}; the same command tries it again", passing=True)
        yield outcome


PARQUET_FILE = "batch.parquet"


def check_parquet() -> None:
    """Check that a Parquet file can be written, before a batch is computed.

    Raises:
        InputError: the package pyarrow is not installed.
    """
    if find_spec("pyarrow") is None:
        raise InputError("a batch needs pyarrow: run 'pip install armdyn[batch]'")


def write_parquet(path: Path, spec: BatchSpec, rows: Sequence[BatchRow]) -> None:
    """Write the rows of a batch to a Parquet file; an interrupted write leaves the old file unchanged.

    Raises:
        InputError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {"text": pa.string(), "time": pa.timestamp("us", tz="UTC"), "number": pa.float64(), "truth": pa.bool_(),
             "names": pa.list_(pa.string())}  # fmt: skip
    fixed: list[tuple[str, str, Callable[[BatchRow], Any]]] = [
        ("robot", "text", lambda row: row.item.robot),
        ("model", "text", lambda row: spec.relative_name(row.item.model)),
        ("recording", "text", lambda row: spec.relative_name(row.item.run)),
        ("time", "time", lambda row: row.item.recording_time.time),
        (
            "time_from",
            "text",
            lambda row: row.item.recording_time.source.key if row.item.recording_time.time is not None else None,
        ),
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
    with atomic.replace_file(path) as file:
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
    """Sort key of a column's name: errors first, and each standard deviation next to its value."""
    kind, _, rest = name.partition(".")
    return (0 if kind in ("rmse", "noise") else 1, rest, "" if kind in ("rmse", "value") else kind)
