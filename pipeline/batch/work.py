"""One job of a batch: compare or repair one model with one recording, in a process of this or another computer."""

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

from armdyn.errors import ArmdynError, InputError, error_sentence
from armdyn.inspection.check import WrongRecordingError
from armdyn.read_files import refuse_overwriting_inputs
from armdyn.user_code import trusting_code
from urdf import DescriptionWarning
from urdf.toml_tables import read_toml_with_text

if TYPE_CHECKING:
    from armdyn.arm.model import ArmModel
    from armdyn.checked_study import ModelWithCatalogue
    from armdyn.run import Run
    from armdyn.watch.fault_free import FaultFreeStatistics

WATCH_FALSE_ALARMS_PER_HOUR = 0.01
"""Rate of false alarms in the search for events in a recording [1/h]."""

_one_at_a_time = threading.Lock()
"""Held during a job, because workers of a dask cluster may have several threads and models are not thread-safe."""


@dataclasses.dataclass(frozen=True)
class BatchJob:
    """One job of a batch.

    Attributes:
        key: digest of all files of the job; the job is computed again only when one of them changes.
        task: ``"compare"`` or ``"repair"``.
        model: file of the model.
        model_content_digest: digest of the content of the model.
        run: file of the recording.
        effects: file with effects that the user has written; None without one.
        trust: whether to use the recording even if a mistake was found in it.
        calibrate: recordings of the robot in good condition; if there are any, the recording is also searched for
            events such as contacts.
    """

    key: str
    task: str
    model: Path
    model_content_digest: str
    run: Path
    effects: Path | None
    trust: bool = False
    calibrate: tuple[Path, ...] = ()


@dataclasses.dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job; JSON can contain all fields.

    Attributes:
        key: key of the job.
        verdict: verdict of the comparison or repair; empty if the recording could not be used.
        sentence: summary for a person.
        problem: why the recording could not be used; empty if it could.
        passing: whether the problem is temporary, such as a killed worker process, so that the job is tried again.
        explained: share of the error beyond the noise that a repair removes, from 0 to 1; None for a comparison.
        effects: names of the model's effects, after a repair those that were added included.
        chi2_per_sample: mean squared error over the noise variance; 1 if only noise remains.
        intervals_hold: whether the parameters' standard deviations are reliable.
        channels: root mean square error, noise and unit of each channel.
        parameters: value, standard deviation, unit and whether it was fitted, for each parameter of the model; without
            parameters of a single run, such as its initial state.
        events: a sentence per event that was found in the recording; None if it was not searched for events.
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
        """The outcome as one line of JSON with a checksum, for the journal."""
        text = json.dumps(dataclasses.asdict(self), allow_nan=False)
        return json.dumps({"digest": text_digest([text]), **json.loads(text)})

    @classmethod
    def from_json_line(cls, line: bytes) -> "JobOutcome | None":
        """Read an outcome from a line of the journal; None if the line is damaged or has another format."""
        try:
            entry = json.loads(line)
            if entry.pop("digest") == text_digest([json.dumps(entry)]):
                events = entry["events"]
                lists = {"effects": tuple(entry["effects"]), "events": None if events is None else tuple(events)}
                return cls(**entry | lists)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            pass
        return None


def run_job(job: BatchJob) -> JobOutcome:
    """Run a job; an error becomes the `problem` of its outcome."""
    # Code was allowed or refused when the batch's process read the models.
    with _one_at_a_time, warnings.catch_warnings(), refuse_overwriting_inputs(), trusting_code():
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
            found = {"problem": error_sentence(error, "not foreseen"), "passing": True}
        gc.collect()  # results refer to their recording; its memory is needed for the next one
        return JobOutcome(job.key, seconds=time.perf_counter() - began, **found)


def _found(job: BatchJob) -> dict[str, Any]:
    from armdyn.checked_study import CheckedStudy
    from armdyn.run import read_run
    from pipeline.answers import model_fit_json
    from pipeline.fields import attributes_as_json, finite_or_none

    known, run = _known(job.model, job.model_content_digest, job.effects), read_run(job.run)
    choosing = None if job.task == "repair" else ()
    given = CheckedStudy.of(known, [run], effects=choosing, trusted=job.trust)
    if job.task == "compare":
        compared = given.compare()
        answer, model = attributes_as_json(compared, "verdict sentence"), given.study.model
    else:
        repaired = given.repair()
        compared, model = repaired.after, repaired.model
        answer = attributes_as_json(repaired, "verdict sentence explained")
    fit, columns = model_fit_json(compared), compared.fit.problem.columns
    of_the_run = {c.name for c in columns if c.parameter.scope == "per_run"}
    return {
        **answer,
        "effects": tuple(effect.name for effect in model.named_effects),
        "chi2_per_sample": finite_or_none(compared.fit.chi2_per_sample),
        "intervals_hold": compared.intervals_hold,
        "channels": {
            name: {key: channel[key] for key in ("unit", "rmse", "noise_std")}
            for name, channel in fit["channels"].items()
        },
        "parameters": {name: p for name, p in fit["parameters"].items() if name not in of_the_run},
        "events": _events(job, run) if job.calibrate else None,
        "duration": max((float(c.time[-1] - c.time[0]) for c in run.channels.values()), default=0.0),
    }


def _events(job: BatchJob, run: "Run") -> tuple[str, ...]:
    from armdyn.watch.fault_free import joint_samples_of_recording
    from armdyn.watch.watch import Watch

    model, sound = _sound(job.model, job.model_content_digest, job.effects, job.calibrate)
    found = Watch(model, sound, WATCH_FALSE_ALARMS_PER_HOUR).events_of(
        joint_samples_of_recording(model.with_estimated_channels(run), model, sound.changes.channels)
    )
    return tuple(f"{event.time:.2f} s: {event.sentence}" for event in found)


@lru_cache(maxsize=4)
def _sound(
    path: Path, key: str, effects: Path | None, calibrate: tuple[Path, ...]
) -> "tuple[ArmModel, FaultFreeStatistics]":
    """The model of an arm, and the statistics of its recordings in good condition; cached for the jobs of one arm."""
    from armdyn.arm.model import ArmModel
    from armdyn.watch.channels import WatchedChannels
    from armdyn.watch.fault_free import statistics_of_recordings
    from pipeline.watch.sources import read_arm_runs, sample_sources

    model = _known(path, key, effects).file.model.capability(ArmModel)
    if model is None:
        raise InputError(f"{path}: `calibrate` is for a watch, which is for arms: leave it out")
    runs = read_arm_runs(model, calibrate)
    channels = WatchedChannels.of(model, runs)
    return model, statistics_of_recordings(model, sample_sources(model, runs, channels), channels=channels)


@lru_cache(maxsize=64)
def _known(path: Path, key: str, effects: Path | None) -> "ModelWithCatalogue":
    """The model and the effects to choose from; cached by the digest of their content."""
    del key
    from armdyn.checked_study import ModelWithCatalogue

    return ModelWithCatalogue.of(path, effects)


def model_digest(path: Path, effects: Path | None) -> str:
    """Digest of a model: of the content of all files from which it is read.

    Raises:
        InputError: one of these files cannot be used.
    """
    from armdyn.checked_study import ModelWithCatalogue

    model = ModelWithCatalogue.of(path, effects).file.model
    base = str(read_toml_with_text(path)[1]["base"])
    files = [path, effects, path.parent / base if base.endswith(".py") else None]
    robot = [model.robot.fingerprint] if model.robot is not None else []
    return text_digest([file_digest(file) for file in files if file is not None] + robot)


def job_digest(task: str, model_content_digest: str, name: str, run: Path, reference_digest: str) -> str:
    """Digest of a job.

    Args:
        task: the task and its options.
        model_content_digest: digest of the model.
        name: name of the recording.
        run: file of the recording; its content and its sidecar file are part of the digest.
        reference_digest: digest of the recordings of the robot in good condition.
    """
    from armdyn import __version__

    return text_digest(
        [
            __version__,
            task,
            model_content_digest,
            name,
            file_digest(run),
            file_digest(run.with_suffix(".toml")),
            reference_digest,
        ]
    )


def file_digest(path: Path) -> str:
    """SHA-256 digest of a file's content; empty if the file cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""


def text_digest(parts: list[str]) -> str:
    """Digest of texts: the first 32 characters of their SHA-256."""
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
