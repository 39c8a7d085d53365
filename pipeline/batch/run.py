"""Does what a SPEC asks for, and only what was not done before."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.batch.journal import opened
from pipeline.batch.spec import Item, Spec
from pipeline.batch.work import Job, Outcome, key_of, key_of_model
from pipeline.batch.workers import in_processes, on_cluster

Progress = Callable[[int, int], None]


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
        key = keys[item.model, item.run] = key_of(spec.task, model_key, spec.name(item.run), item.run)
        jobs[key] = Job(key, spec.task, item.model.resolve(), model_key, item.run.resolve(), spec.effects)
    with opened(folder) as journal:
        kept = {key for key, outcome in journal.outcomes.items() if not outcome.passing}
        todo = [job for key, job in jobs.items() if key not in kept]
        there, worked = len(jobs) - len(todo), 0
        say(f"{there} of {len(jobs)} recordings done")
        if todo and not stopped():
            for outcome in _outcomes(todo, workers, scheduler, stopped):
                journal.add(outcome)
                worked += 1
                say(f"{there + worked} of {len(jobs)} recordings done")
        found = ((item, journal.outcomes.get(keys.get((item.model, item.run), ""))) for item in spec.items)
        rows = [Row(item, outcome) for item, outcome in found if outcome is not None]
    return Done(tuple(rows), len(spec.items) - len(rows), worked)


def _outcomes(
    jobs: Sequence[Job], workers: int | None, scheduler: str | None, stopped: Callable[[], bool]
) -> Iterator[Outcome]:
    if scheduler is not None:
        return on_cluster(jobs, scheduler, stopped)
    return in_processes(jobs, min(workers or os.cpu_count() or 1, len(jobs)), stopped)
