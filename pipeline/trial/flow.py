"""The flow of a whole trial on any robot: experiments that find out what the model lacks, if wanted, then the swing."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from pipeline.record import Recorder
from pipeline.trial.ending import Ending
from pipeline.trial.experiment import Experiment, Progress
from pipeline.trial.folder import gather_files
from pipeline.trial.investigation import SwingExperiment, ending_before, investigate, settings_after
from pipeline.trial.result import TRIAL, TrialResult, finish_recording, open_recording, result_of
from pipeline.trial.rig import Rig
from pipeline.trial.settings import ProtocolSettings

if TYPE_CHECKING:
    from armdyn.document import Document
    from pipeline.report.trial import SwingTrace
    from pipeline.robot.truth import History

R = TypeVar("R")


@dataclass(frozen=True)
class Trial(Generic[R]):
    """A trial that has run.

    Attributes:
        subtitle: what was run, for the report.
        experiment: the protocol, with everything that was planned and measured.
        result: what it came to.
        robot: that moved.
        history: the true motion, of a simulated robot; None where nobody knows it.
    """

    subtitle: str
    experiment: Experiment
    result: TrialResult
    robot: R
    history: "Callable[[], History] | None" = None

    def report(self) -> "Document":
        """The report; of a simulated trial with the true motion of the load."""
        from pipeline.trial.report import report_of

        return report_of(self.experiment, self.result, self.subtitle, self._executed())

    def swing_history(self) -> "History | None":
        """What really happened from the swing on; None where there was none, or nobody knows it."""
        started = self.experiment.task.started
        return None if self.history is None or started is None else self.history().from_time(started)

    def _executed(self) -> "SwingTrace | None":
        from pipeline.report.trial import SwingTrace

        history, line = self.swing_history(), self.experiment.description.line
        if history is None:
            return None
        gripper, load = (
            np.asarray((points - line.origin) @ line.direction) for points in (history.pivot, history.load)
        )
        time = history.time - (self.experiment.task.started or 0.0)
        return SwingTrace(time, gripper, load, history.load[:, 2] - line.origin[2])


def perform(
    rig: Rig, settings: ProtocolSettings, out: Path | None, progress: Progress
) -> tuple[Experiment, TrialResult]:
    """One whole trial; what it leaves behind is written.

    Args:
        rig: the robot.
        settings: of the protocol.
        out: directory for recordings and model; None keeps nothing.
        progress: told what is going on.
    """

    def tell(what: str, share: float = 0.0) -> None:
        rig.announce(what)
        progress(what, share)

    with gather_files(out) as folder:

        def recorded(name: str = TRIAL) -> AbstractContextManager[Recorder]:
            return open_recording(rig.recorder, folder, rig.arm.joint_names, settings, rig.description, name)

        def swing(of: ProtocolSettings, number: int, place: float) -> tuple[SwingExperiment, Ending]:
            if number > 1:
                rig.wait_until_calm()
            with recorded(f"experiment_{number}") as recorder:
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
                rig.wait_until_calm()
        with recorded() as recorder:
            experiment = Experiment(rig, recorder, of, tell, 0.0 if found is None else found.place)
            ending = ending_before(experiment, found) or rig.judge(experiment.run())
        ending = finish_recording(experiment, ending, recorder, folder)
        return experiment, result_of(experiment, ending, rig.length, out / recorder.path.name if out else None, found)
