"""A whole trial on any robot: optional experiments that identify the model's missing effects, then the swing."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from pipeline.trial.ending import TrialEnding
from pipeline.trial.experiment import Experiment, ProgressCallback
from pipeline.trial.folder import temporary_output_folder
from pipeline.trial.investigation import SwingExperiment, early_ending, investigate, settings_after_investigation
from pipeline.trial.result import TrialResult, finish_recording, open_recording, trial_result
from pipeline.trial.rig import TrialRig
from pipeline.trial.settings import ProtocolSettings

if TYPE_CHECKING:
    from armdyn.document import Document
    from pipeline.robot.truth import TrueMotion

R = TypeVar("R")


@dataclass(frozen=True)
class Trial(Generic[R]):
    """A finished trial.

    Attributes:
        subtitle: description of the trial for the report.
        experiment: finished protocol, with plans and measurements.
        result: outcome of the trial.
        robot: robot that moved.
        history: true motion of a simulated robot; None where it is unknown.
    """

    subtitle: str
    experiment: Experiment
    result: TrialResult
    robot: R
    history: "Callable[[], TrueMotion] | None" = None

    def report(self) -> "Document":
        """Report of the trial; in a simulated trial it also shows the true motion of the load."""
        from pipeline.report.trial import SwingTrace
        from pipeline.trial.report import trial_report

        executed, history, line = None, self.swing_history(), self.experiment.description.line
        if history is not None:
            gripper, load = (
                np.asarray((points - line.origin) @ line.direction) for points in (history.pivot, history.load)
            )
            time = history.time - (self.experiment.task.swing_start or 0.0)
            executed = SwingTrace(time, gripper, load, history.load[:, 2] - line.origin[2])
        return trial_report(self.experiment, self.result, self.subtitle, executed)

    def swing_history(self) -> "TrueMotion | None":
        """True motion from the start of the swing; None if there was no swing or the motion is unknown."""
        started = self.experiment.task.swing_start
        return None if self.history is None or started is None else self.history().from_time(started)


def perform_trial(
    rig: TrialRig, settings: ProtocolSettings, out: Path | None, progress: ProgressCallback
) -> tuple[Experiment, TrialResult]:
    """Perform one whole trial, and write its recordings and model.

    Args:
        rig: robot with its description, IK table and load cell.
        settings: settings of the protocol.
        out: directory for recordings and model; None to write no files.
        progress: called to report the progress.

    Returns:
        The finished protocol, and the outcome.
    """

    def tell(what: str, share: float = 0.0) -> None:
        rig.hooks.announce_phase(what)
        progress(what, share)

    with temporary_output_folder(out) as folder:

        def swing(of: ProtocolSettings, number: int, place: float) -> tuple[SwingExperiment, TrialEnding]:
            if number > 1:
                rig.hooks.wait_until_calm()
            with open_recording(rig, folder, settings, f"experiment_{number}") as recorder:
                made = SwingExperiment(
                    rig, recorder, of, lambda what, _share: tell(f"experiment {number}: {what}"), place
                )
                ending = made.run()
                recorder.close()
            return made, ending

        found, of = None, settings
        if settings.investigate:
            found = investigate(settings, swing, rig.arm, rig.table, tell)
            of = settings_after_investigation(settings, found)
            if found.ending is None:
                rig.hooks.wait_until_calm()
        with open_recording(rig, folder, settings) as recorder:
            experiment = Experiment(rig, recorder, of, tell, 0.0 if found is None else found.place)
            ending = early_ending(experiment, found) or rig.hooks.ending_judged_by_operator(experiment.run())
        ending = finish_recording(experiment, ending, recorder, folder)
        recording = out / recorder.path.name if out else None
        return experiment, trial_result(experiment, ending, rig.true_length, recording, found)
