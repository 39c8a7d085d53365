"""A trial on the simulated robot."""

from collections.abc import Callable
from dataclasses import replace

import ik
import urdf
from pipeline.loadcell.faults import FaultLimits
from pipeline.robot.protocol import RobotInterface
from pipeline.robot.simulated import SimulatedRobot
from pipeline.trial.experiment import Progress
from pipeline.trial.flow import Trial, perform
from pipeline.trial.result import TrialResult
from pipeline.trial.rig import Rig
from pipeline.trial.settings import TrialSettings

SimulatedTrial = Trial[SimulatedRobot]


def simulate(
    settings: TrialSettings,
    progress: Progress | None = None,
    through: Callable[[SimulatedRobot], RobotInterface] = lambda robot: robot,
    real: bool = False,
) -> SimulatedTrial:
    """Run one whole trial on the simulated robot; recording and model are written where the settings name a folder.

    Args:
        settings: settings of protocol and simulation.
        progress: called to report the progress.
        through: wraps the robot, for example to simulate a fault; None for no wrapper.
        real: whether the protocol treats the robot as one that moves on by itself, see `Rig`.

    Raises:
        InputError: settings that cannot be used.
        UnknownNameError: a hidden effect that the simulated robot does not have.
    """
    c, say = settings, progress or (lambda _what, _share: None)
    description = urdf.load("baxter")
    table = ik.default_table(description, progress=lambda stage: say(stage, 0.0))
    plant = replace(c.plant, length=c.length, mass=c.mass, load_radius=c.load_radius)
    robot = SimulatedRobot(description, table.posture(0.0).q, plant, c.hidden, c.seed)
    rig = Rig(
        through(robot),
        real,
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
    return Trial(subtitle, experiment, result, robot, robot.history)


def run_trial(settings: TrialSettings, progress: Progress | None = None) -> TrialResult:
    """Run one whole trial on the simulated robot, and return its outcome; see `simulate`."""
    return simulate(settings, progress).result
