"""One job of a batch: compare or repair one model with one recording, on this machine or another."""

import dataclasses
import gc
import hashlib
import json
import threading
import time
import warnings
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armdyn.errors import ArmdynError, InputError, sentence_of
from armdyn.inspection.check import WrongRecordingError
from armdyn.read_files import keeping_inputs
from urdf import DescriptionWarning
from urdf.toml_tables import read_toml_with_text

if TYPE_CHECKING:
    from armdyn.arm.model import ArmModel
    from armdyn.checked_study import ModelWithCatalogue
    from armdyn.run import Run
    from armdyn.watch.sound import Sound

FALSE_ALARMS_PER_HOUR = 0.01
"""Of a watch."""

_one_at_a_time = threading.Lock()
"""Workers of a dask cluster may have several threads; models are not made for them."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A job for a worker.

    Attributes:
        key: digest of all its files, so that the job is done again only when one of them changes.
        task: ``"compare"`` or ``"repair"``.
        model: file of the model.
        model_key: digest of the model's content.
        run: file of the recording.
        effects: file with effects of the user's own.
        trust: whether to go on where the recording is not what it says it is.
        calibrate: recordings of sound work; where there are any, the recording is watched as well.
    """

    key: str
    task: str
    model: Path
    model_key: str
    run: Path
    effects: Path | None
    trust: bool = False
    calibrate: tuple[Path, ...] = ()


@dataclasses.dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job, without the SPEC's entry; all fields can be written as JSON.

    Attributes:
        key: key of the job.
        verdict: verdict of a comparison or a repair; empty where the recording could not be used.
        sentence: summary for a person.
        problem: why the recording could not be used; empty where it could.
        passing: whether the problem may be gone next time, such as a killed worker.
        explained: share of the misfit that a repair removes; None for a comparison.
        effects: effects of the model, after a repair.
        chi2_per_sample: 1 where only noise is left.
        intervals_hold: whether the standard deviations can be trusted as intervals.
        channels: rms error, noise and unit by channel.
        parameters: value, standard deviation, unit and whether it was fitted, by name; those of the model, not those of
            a single run such as how it began.
        events: what a watch tells of the recording, a sentence each; None where it was not watched.
        duration: duration of the recording [s].
        seconds: computing time [s].
    """

    key: str
    verdict: str = ""
    sentence: str = ""
    problem: str = ""
    passing: bool = False
    explained: float | None = None
    effects: tuple[str, ...] = ()
    chi2_per_sample: float | None = None
    intervals_hold: bool = False
    channels: Mapping[str, Mapping[str, Any]] | None = None
    parameters: Mapping[str, Mapping[str, Any]] | None = None
    events: tuple[str, ...] | None = None
    duration: float | None = None
    seconds: float = 0.0

    @property
    def line(self) -> str:
        """The outcome as a line of JSON with a checksum."""
        text = json.dumps(dataclasses.asdict(self), allow_nan=False)
        return json.dumps({"digest": digest([text]), **json.loads(text)})

    @classmethod
    def of(cls, line: bytes) -> "JobOutcome | None":
        """The outcome in a line; None where the line is damaged, or of another version."""
        try:
            entry = json.loads(line)
            if entry.pop("digest") == digest([json.dumps(entry)]):
                events = entry["events"]
                lists = {"effects": tuple(entry["effects"]), "events": None if events is None else tuple(events)}
                return cls(**entry | lists)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            pass
        return None


def work(job: Job) -> JobOutcome:
    """Do a job; whatever is wrong with the recording becomes part of the outcome."""
    with _one_at_a_time, warnings.catch_warnings(), keeping_inputs():
        warnings.simplefilter("ignore", DescriptionWarning)  # the batch's user has seen these warnings
        began = time.perf_counter()
        try:
            found = _found(job)
        except WrongRecordingError as error:
            wrong = error.inspection
            found = {"problem": f"{wrong.sentence} {wrong.wrong[0].remedy}; trust_data = true goes on regardless"}
        except ArmdynError as error:
            found = {"problem": str(error)}
        except MemoryError:
            found = {"problem": "the memory of this machine is too small for it", "passing": True}
        except Exception as error:  # a bad file must never end a batch
            found = {"problem": sentence_of(error, "not foreseen"), "passing": True}
        gc.collect()  # results refer to their recording; its memory is needed for the next one
        return JobOutcome(job.key, seconds=time.perf_counter() - began, **found)


def _found(job: Job) -> dict[str, Any]:
    from armdyn.checked_study import CheckedStudy
    from armdyn.run import read_run
    from pipeline.answers import fit_answer
    from pipeline.fields import fields, number

    known, run = _known(job.model, job.model_key, job.effects), read_run(job.run)
    choosing = None if job.task == "repair" else ()
    given = CheckedStudy.of(known, [run], effects=choosing, trusted=job.trust)
    if job.task == "compare":
        compared = given.compare()
        answer, model = fields(compared, "verdict sentence"), given.study.model
    else:
        repaired = given.repair()
        compared, model = repaired.after, repaired.model
        answer = fields(repaired, "verdict sentence explained")
    fit, columns = fit_answer(compared), compared.fit.problem.columns
    of_the_run = {c.name for c in columns if c.parameter.scope == "per_run"}
    return {
        **answer,
        "effects": tuple(effect.name for effect in model.named_effects),
        "chi2_per_sample": number(compared.fit.chi2_per_sample),
        "intervals_hold": compared.intervals_hold,
        "channels": {
            name: {key: channel[key] for key in ("unit", "rmse", "noise_std")}
            for name, channel in fit["channels"].items()
        },
        "parameters": {name: p for name, p in fit["parameters"].items() if name not in of_the_run},
        "events": _events(job, run) if job.calibrate else None,
        "duration": max((float(c.time[-1] - c.time[0]) for c in run.channels.values()), default=0.0),
    }


def _events(job: Job, run: "Run") -> tuple[str, ...]:
    from armdyn.watch.sound import samples_of
    from armdyn.watch.watch import Watch

    model, sound = _sound(job.model, job.model_key, job.effects, job.calibrate)
    found = Watch(model, sound, FALSE_ALARMS_PER_HOUR).all(samples_of(model.reading(run), model))
    return tuple(f"{event.time:.2f} s: {event.sentence}" for event in found)


@lru_cache(maxsize=4)
def _sound(path: Path, key: str, effects: Path | None, calibrate: tuple[Path, ...]) -> "tuple[ArmModel, Sound]":
    """An arm's model, and what its sound recordings say; cached while one arm's recordings follow each other.

    Raises:
        InputError: the model is no arm's, or the recordings are too short.
    """
    from armdyn.watch.sound import measured_sound
    from pipeline.watch.sources import runs_of, sample_sources

    model = _known(path, key, effects).file.model.as_arm()
    if model is None:
        raise InputError(f"{path}: `calibrate` is for a watch, which is for arms: leave it out")
    return model, measured_sound(model, sample_sources(model, runs_of(model, calibrate)))


@lru_cache(maxsize=64)
def _known(path: Path, key: str, effects: Path | None) -> "ModelWithCatalogue":
    """Model and effects to choose from, cached by the key of their content."""
    del key
    from armdyn.checked_study import ModelWithCatalogue

    return ModelWithCatalogue.of(path, effects)


def key_of_model(path: Path, effects: Path | None) -> str:
    """Digest of a model, from the content of every file that it is read from.

    Raises:
        InputError: one of them cannot be used.
    """
    from armdyn.checked_study import ModelWithCatalogue

    model = ModelWithCatalogue.of(path, effects).file.model
    base = str(read_toml_with_text(path)[1]["base"])
    files = [path, effects, path.parent / base if base.endswith(".py") else None]
    robot = [model.robot.fingerprint] if model.robot is not None else []
    return digest([contents(file) for file in files if file is not None] + robot)


def key_of(task: str, model_key: str, name: str, run: Path, sound: str) -> str:
    """Digest of a job, from armdyn's version, the model, recording, sidecar and the digest of sound recordings."""
    from armdyn import __version__

    return digest([__version__, task, model_key, name, contents(run), contents(run.with_suffix(".toml")), sound])


def contents(path: Path) -> str:
    """Digest of a file; empty where it cannot be read, which its reader will report."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""


def digest(parts: list[str]) -> str:
    """Digest of texts, 32 letters."""
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
