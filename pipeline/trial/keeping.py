"""What a trial leaves behind: the recording, completed however the trial ends, and the model that the robot had."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from armdyn.errors import ArmdynError
from armdyn.model_file import ModelFile, write_model_file
from armdyn.units import Known
from pipeline.record import Recorder
from pipeline.trial.experiment import Ending, Experiment, recorded_channels
from pipeline.trial.settings import ProtocolSettings

R = TypeVar("R", bound=Recorder)


@contextmanager
def recording(
    kind: type[R], folder: Path, joints: tuple[str, ...], settings: ProtocolSettings, description: str
) -> Iterator[R]:
    """The recorder of a trial; what is raised in the block passes on, and the recording is complete all the same.

    Args:
        kind: of recorder.
        folder: where ``trial.mcap`` goes.
        joints: of the arm.
        settings: whose noise and mass the recording states.
        description: a line for a person.
    """
    recorder = kind(
        folder / "trial.mcap",
        recorded_channels(joints),
        description=description,
        noise={"load_force": settings.force_noise},
        known={"mass": Known(settings.mass, settings.mass_std, "kg")},
    )
    try:
        yield recorder
    except BaseException:
        with suppress(ArmdynError, OSError):  # completing it must not hide what happened
            recorder.close()
        raise


def kept(experiment: Experiment, ending: Ending, recorder: Recorder, folder: Path) -> Ending:
    """Complete the recording and write the model; what cannot be written is added to how the trial ended."""
    problems = []
    try:
        recorder.close()
    except (ArmdynError, OSError) as error:
        problems.append(str(error))
    if recorder.failure is not None:
        problems.append(recorder.failure)
    try:
        write_model_file(folder / "model.toml", ModelFile(experiment.estimator.model, {}))
    except (ArmdynError, OSError) as error:
        problems.append(f"the model was not written: {error}")
    new = [problem for problem in problems if problem not in ending.message]
    return replace(ending, message="; ".join([ending.message, *new])) if new else ending
