"""What a trial leaves behind: the folder, the recording completed, the model that the robot had."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from armdyn.errors import ArmdynError, InputError
from armdyn.model_file import ModelFile, write_model_file
from pipeline.record import Recorder
from pipeline.trial.experiment import Ending, Experiment


def kept(experiment: Experiment, ending: Ending, recorder: Recorder, out: Path | None) -> Ending:
    """Complete the recording and write the model; what cannot be written is added to how the trial ended."""
    problems = []
    try:
        recorder.close()
    except (ArmdynError, OSError) as error:
        problems.append(str(error))
    if recorder.failure is not None:
        problems.append(recorder.failure)
    if out is not None:
        try:
            write_model_file(out / "model.toml", ModelFile(experiment.estimator.model, {}))
        except (ArmdynError, OSError) as error:
            problems.append(f"the model was not written: {error}")
    new = [problem for problem in problems if problem not in ending.message]
    return replace(ending, message="; ".join([ending.message, *new])) if new else ending


@contextmanager
def directory(out: Path | None) -> Iterator[Path]:
    """Where the recording is written: the given directory, else one that is gone at the end."""
    if out is None:
        with TemporaryDirectory() as scratch:
            yield Path(scratch)
        return
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {out}: {error.strerror or error}; choose another directory") from error
    yield out
