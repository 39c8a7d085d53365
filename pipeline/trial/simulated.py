"""A trial on the simulated robot: builds it, runs the protocol on it, and adds what only a simulation knows."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

import ik
import urdf
from pipeline.loadcell.faults import FaultLimits
from pipeline.nodes.scheduler import Clock, SimulatedClock
from pipeline.record import Recorder
from pipeline.robot.protocol import RobotInterface, Vector
from pipeline.robot.settings import PlantSettings
from pipeline.robot.simulated import SimulatedRobot
from pipeline.robot.truth import History
from pipeline.trial.ending import Ending
from pipeline.trial.experiment import Experiment, Progress
from pipeline.trial.folder import gathered
from pipeline.trial.investigation import SwingExperiment, after, ended_before, investigate, swing_of
from pipeline.trial.result import TrialResult, kept, recording, result_of
from pipeline.trial.settings import ProtocolSettings, TrialSettings

if TYPE_CHECKING:
    from armdyn.document import Document
    from pipeline.report.trial import SwingTrace


@dataclass(frozen=True)
class SimulatedTrial:
    """A trial that has run.

    Attributes:
        settings: what it was given.
        plant: the simulated robot as it was built.
        robot: which knows the truth.
        experiment: the protocol, with everything that was planned and measured.
        result: what it came to.
    """

    settings: TrialSettings
    plant: PlantSettings
    robot: SimulatedRobot
    experiment: Experiment
    result: TrialResult

    def swing_history(self) -> History | None:
        """What really happened from the swing on; None where there was none."""
        history, started = self.robot.history(), self.experiment.task.started
        return None if started is None else history.from_time(started)

    def report(self, command: str = "") -> "Document":
        """The report, with the true length and the true motion of the load."""
        from pipeline.trial.report import report_of

        c = self.settings
        hidden = ", ".join(f"{name} {value:g}" for name, value in self.robot.truth.hidden.items())
        subtitle = (
            f"Simulated Baxter, load {1e3 * c.mass:g} g on a string of {c.length:g} m, seed {c.seed}, "
            f"hidden: {hidden or 'nothing'}"
        )
        return report_of(self.experiment, self.result, subtitle, command, executed=self._executed())

    def _executed(self) -> "SwingTrace | None":
        from pipeline.report.trial import SwingTrace

        history, line = self.swing_history(), self.experiment.description.line
        if history is None:
            return None

        def along(points: Vector) -> Vector:
            return np.asarray((points - line.origin) @ line.direction)

        time = history.time - (self.experiment.task.started or 0.0)
        return SwingTrace(time, along(history.pivot), along(history.load), history.load[:, 2] - line.origin[2])


def simulate(
    settings: TrialSettings,
    progress: Progress | None = None,
    through: Callable[[SimulatedRobot], RobotInterface] | None = None,
    clock: Callable[[RobotInterface], Clock] = SimulatedClock,
) -> SimulatedTrial:
    """One whole trial on the simulated robot; the recording and the model are written where settings say so.

    Args:
        settings: of protocol and simulation.
        progress: told what is going on.
        through: what stands between the robot and the protocol, such as a fault that is tried; nothing if not given.
        clock: of what the protocol then sees; one that is real where that goes on by itself.

    Raises:
        InputError: settings that cannot be used.
        UnknownNameError: a hidden effect that the simulated robot does not have.
    """
    c, say = settings, progress or (lambda _what, _share: None)
    description = urdf.load("baxter")
    table = ik.default_table(description, progress=lambda stage: say(stage, 0.0))
    plant = replace(c.plant, length=c.length, mass=c.mass, load_radius=c.load_radius)
    robot = SimulatedRobot(description, table.posture(0.0).q, plant, c.hidden, c.seed)
    reached = through(robot) if through is not None else robot
    cell = FaultLimits.of(plant.cell.noise, plant.cell.resolution, plant.cell.full_scale)
    with gathered(c.out) as directory:
        described = f"simulated Baxter, load on a string, seed {c.seed}"

        def swing(of: ProtocolSettings, number: int, place: float) -> tuple[SwingExperiment, Ending]:
            def show(what: str, _share: float) -> None:
                say(f"experiment {number}: {what}", 0.0)

            name = f"experiment_{number}"
            with recording(Recorder, directory, description.joint_names, c, described, name) as kept_there:
                return swing_of(reached, clock(reached), description, table, kept_there, of, cell, show, place)

        found, of = None, c
        if c.investigate:
            found = investigate(c, swing, description, table, c.investigate, lambda what: say(what, 0.0))
            of = after(c, found)
        with recording(Recorder, directory, description.joint_names, c, described) as recorder:
            experiment = Experiment(
                reached,
                clock(reached),
                description,
                table,
                recorder,
                of,
                cell=cell,
                landed=robot.load_in_box,
                progress=say,
                begin=found.place if found is not None else 0.0,
            )
            ending = ended_before(experiment, found) or experiment.run()
        ending = kept(experiment, ending, recorder, directory)
        result = result_of(experiment, ending, c.length, c.out / recorder.path.name if c.out else None, found)
    return SimulatedTrial(c, plant, robot, experiment, result)


def run_trial(settings: TrialSettings, progress: Progress | None = None) -> TrialResult:
    """The outcome of one whole trial on the simulated robot, see `simulate`."""
    return simulate(settings, progress).result
