"""The whole trial on any robot: optional experiments that find what the model lacks, then the swing."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from pipeline.trial.ending import Ending
from pipeline.trial.experiment import Experiment, Progress
from pipeline.trial.folder import gather_files
from pipeline.trial.investigation import SwingExperiment, ending_before, investigate, settings_after
from pipeline.trial.result import TrialResult, finish_recording, open_recording, result_of
from pipeline.trial.rig import Rig
from pipeline.trial.settings import ProtocolSettings

if TYPE_CHECKING:
    from armdyn.document import Document
    from pipeline.robot.truth import History

R = TypeVar("R")


@dataclass(frozen=True)
class Trial(Generic[R]):
    """A finished trial.

    Attributes:
        subtitle: description of the trial for the report.
        experiment: the protocol, with everything that was planned and measured.
        result: outcome of the trial.
        robot: robot that moved.
        history: true motion of a simulated robot; None where it is unknown.
    """

    subtitle: str
    experiment: Experiment
    result: TrialResult
    robot: R
    history: "Callable[[], History] | None" = None

    def report(self) -> "Document":
        """Report of the trial; for a simulated trial it shows the true motion of the load."""
        from pipeline.report.trial import SwingTrace
        from pipeline.trial.report import report_of

        executed, history, line = None, self.swing_history(), self.experiment.description.line
        if history is not None:
            gripper, load = (
                np.asarray((points - line.origin) @ line.direction) for points in (history.pivot, history.load)
            )
            time = history.time - (self.experiment.task.started or 0.0)
            executed = SwingTrace(time, gripper, load, history.load[:, 2] - line.origin[2])
        return report_of(self.experiment, self.result, self.subtitle, executed)

    def swing_history(self) -> "History | None":
        """True motion from the swing on; None where there was no swing, or the motion is unknown."""
        started = self.experiment.task.started
        return None if self.history is None or started is None else self.history().from_time(started)


def perform(
    rig: Rig, settings: ProtocolSettings, out: Path | None, progress: Progress
) -> tuple[Experiment, TrialResult]:
    """Perform one whole trial, and write its recordings and model.

    Args:
        rig: the robot.
        settings: settings of the protocol.
        out: directory for recordings and model; None keeps nothing.
        progress: called to report the progress.
    """

    def tell(what: str, share: float = 0.0) -> None:
        rig.hooks.announce(what)
        progress(what, share)

    with gather_files(out) as folder:

        def swing(of: ProtocolSettings, number: int, place: float) -> tuple[SwingExperiment, Ending]:
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
            of = settings_after(settings, found)
            if found.ending is None:
                rig.hooks.wait_until_calm()
        with open_recording(rig, folder, settings) as recorder:
            experiment = Experiment(rig, recorder, of, tell, 0.0 if found is None else found.place)
            ending = ending_before(experiment, found) or rig.hooks.judged(experiment.run())
        ending = finish_recording(experiment, ending, recorder, folder)
        recording = out / recorder.path.name if out else None
        return experiment, result_of(experiment, ending, rig.true_length, recording, found)
