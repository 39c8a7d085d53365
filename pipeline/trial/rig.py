"""A robot that is ready for a trial, with its description, IK table and load cell."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import urdf
from ik import LineTable
from pipeline.loadcell.faults import LoadCellFaultLimits
from pipeline.record import Recorder
from pipeline.robot.protocol import RobotInterface
from pipeline.trial.ending import TrialEnding


class RigHooks(Protocol):
    """Functions of a trial that differ between a simulated robot and a real one with an operator."""

    def load_landed(self) -> bool:
        """Whether the load is at rest in the box at the end of the protocol."""

    def ending_judged_by_operator(self, ending: TrialEnding) -> TrialEnding:
        """The ending of a trial, corrected by the operator's answer whether the load is in the box."""

    def wait_until_calm(self) -> None:
        """Wait between two experiments until the load hangs still."""

    def announce_phase(self, what: str) -> None:
        """Publish the name of the trial's phase for observers."""


@dataclass(frozen=True)
class TrialRig:
    """A robot, simulated or real, at the start posture of a trial with its load at rest.

    Attributes:
        robot: interface to the robot; the nodes of the control loop run on its clock.
        real: whether the arm moves on while this program computes. Then long computations run in another process, and
            a watchdog stops the arm if the control loop hangs.
        arm: description of the arm.
        table: IK table of the arm's line.
        cell: limits of plausible readings of the load cell.
        description: description of the robot in one line, for the recordings.
        hooks: functions that differ between simulated and real robots.
        true_length: true length of the string [m]; None if it is unknown.
        recorder: function that makes a recorder.
    """

    robot: RobotInterface
    real: bool
    arm: urdf.Robot
    table: LineTable
    cell: LoadCellFaultLimits
    description: str
    hooks: RigHooks
    true_length: float | None = None
    recorder: Callable[..., Recorder] = Recorder
