"""A trial on the simulated robot: the rig that it runs on, and what only a simulation knows."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

import ik
import urdf
from pipeline.loadcell.faults import FaultLimits
from pipeline.nodes.scheduler import Clock, SimulatedClock
from pipeline.robot.protocol import RobotInterface, Vector
from pipeline.robot.settings import PlantSettings
from pipeline.robot.simulated import SimulatedRobot
from pipeline.robot.truth import History
from pipeline.trial.experiment import Progress
from pipeline.trial.flow import Trial, perform
from pipeline.trial.result import TrialResult
from pipeline.trial.rig import Rig
from pipeline.trial.settings import TrialSettings

if TYPE_CHECKING:
    from pipeline.report.trial import SwingTrace


@dataclass(frozen=True)
class SimulatedTrial(Trial):
    """A trial that has run on the simulated robot.

    Attributes:
        plant: the simulated robot as it was built.
        robot: which knows the truth.
    """

    plant: PlantSettings
    robot: SimulatedRobot

    def swing_history(self) -> History | None:
        """What really happened from the swing on; None where there was none."""
        history, started = self.robot.history(), self.experiment.task.started
        return None if started is None else history.from_time(started)

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
    rig = Rig(
        reached,
        lambda: clock(reached),
        description,
        table,
        FaultLimits.of(plant.cell.noise, plant.cell.resolution, -plant.cell.full_scale, plant.cell.full_scale),
        f"simulated Baxter, load on a string, seed {c.seed}",
        c.length,
        landed=robot.load_in_box,
    )
    experiment, result = perform(rig, c, c.out, say)
    hidden = ", ".join(f"{name} {value:g}" for name, value in robot.truth.hidden.items())
    subtitle = (
        f"Simulated Baxter, load {1e3 * c.mass:g} g on a string of {c.length:g} m, seed {c.seed}, "
        f"hidden: {hidden or 'nothing'}"
    )
    return SimulatedTrial(c, subtitle, experiment, result, plant, robot)


def run_trial(settings: TrialSettings, progress: Progress | None = None) -> TrialResult:
    """The outcome of one whole trial on the simulated robot, see `simulate`."""
    return simulate(settings, progress).result
