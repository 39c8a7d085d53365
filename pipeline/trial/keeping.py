"""What a trial leaves behind: the recording completed, and the model that the robot had."""

from dataclasses import replace
from pathlib import Path

from armdyn.errors import ArmdynError
from armdyn.model_file import ModelFile, write_model_file
from pipeline.record import Recorder
from pipeline.trial.experiment import Ending, Experiment


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
