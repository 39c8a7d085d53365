"""A trial on the simulated robot."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import ik
import urdf
from pipeline.loadcell.faults import LoadCellFaultLimits
from pipeline.robot.protocol import RobotInterface
from pipeline.robot.simulated import SimulatedRobot
from pipeline.trial.ending import TrialEnding
from pipeline.trial.experiment import ProgressCallback
from pipeline.trial.flow import Trial, perform_trial
from pipeline.trial.result import TrialResult
from pipeline.trial.rig import TrialRig
from pipeline.trial.settings import TrialSettings

SimulatedTrial = Trial[SimulatedRobot]
STEADYING_SECONDS = 5.0
"""Time for which the simulated operator steadies the load between two experiments [s]; without one, a swing across the
line would grow from experiment to experiment, and a real trial would not go on."""


@dataclass(frozen=True)
class _SimulationHooks:
    """`RigHooks` of a simulation, which knows the load's true position."""

    simulation: SimulatedRobot

    def load_landed(self) -> bool:
        return self.simulation.load_in_box()

    def ending_judged_by_operator(self, ending: TrialEnding) -> TrialEnding:
        return ending

    def wait_until_calm(self) -> None:
        self.simulation.steady_load(STEADYING_SECONDS)
        self.simulation.load_cell()  # the next experiment reads no old samples

    def announce_phase(self, what: str) -> None: ...


def simulate_trial(
    settings: TrialSettings,
    progress: ProgressCallback | None = None,
    through: Callable[[SimulatedRobot], RobotInterface] = lambda robot: robot,
    real: bool = False,
) -> SimulatedTrial:
    """Run one whole trial on the simulated robot, and write recording and model to the settings' folder, if any.

    Args:
        settings: settings of protocol and simulation.
        progress: called to report the progress.
        through: function that wraps the robot, for example to simulate a fault.
        real: whether the protocol treats the robot as a real one, see `TrialRig`.

    Raises:
        InputError: settings that cannot be used.
        UnknownNameError: the simulated robot has no hidden effect of this name.
    """
    c, say = settings, progress or (lambda _what, _share: None)
    description = urdf.load("baxter")
    table = ik.default_table(description, progress=lambda stage: say(stage, 0.0))
    plant = replace(c.plant, length=c.true_length, mass=c.mass, load_radius=c.load_radius)
    robot = SimulatedRobot(description, table.posture(0.0).q, plant, c.hidden, c.seed)
    cell = plant.cell
    limits = LoadCellFaultLimits.from_noise(cell.noise, cell.resolution, -cell.full_scale, cell.full_scale)
    about = f"simulated Baxter, load on a string, seed {c.seed}"
    rig = TrialRig(through(robot), real, description, table, limits, about, _SimulationHooks(robot), c.true_length)
    experiment, result = perform_trial(rig, c, c.out, say)
    hidden = ", ".join(f"{name} {value:g}" for name, value in robot.truth.hidden.items())
    subtitle = (
        f"Simulated Baxter, load {1e3 * c.mass:g} g on a string of {c.true_length:g} m, seed {c.seed}, "
        f"hidden: {hidden or 'nothing'}"
    )
    return Trial(subtitle, experiment, result, robot, robot.history)


def run_trial(settings: TrialSettings, progress: ProgressCallback | None = None) -> TrialResult:
    """Run one whole trial on the simulated robot, and return its outcome; see `simulate_trial` for the arguments."""
    return simulate_trial(settings, progress).result
