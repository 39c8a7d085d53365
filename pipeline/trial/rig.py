"""A robot that is ready for a trial, with its description, table and load cell."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import urdf
from ik import LineTable
from pipeline.loadcell.faults import LoadCellLimits
from pipeline.record import Recorder
from pipeline.robot.protocol import RobotInterface
from pipeline.trial.ending import Ending


class RigHooks(Protocol):
    """What a trial asks of its surroundings: the simulation, or the operator of a real robot."""

    def landed(self) -> bool:
        """Whether the load is at rest in the box; asked once, at the end of the protocol."""

    def judged(self, ending: Ending) -> Ending:
        """The ending of a trial, with the operator's verdict; the arm holds its posture."""

    def wait_until_calm(self) -> None:
        """Wait between two experiments until the load hangs still."""

    def announce(self, what: str) -> None:
        """Publish the progress for others."""


@dataclass(frozen=True)
class Rig:
    """A robot, simulated or real, at the start posture with its load at rest.

    Attributes:
        robot: interface that moves and measures; the nodes of an experiment run on its clock.
        real: whether time, and with it the arm, goes on while this program computes. Then long computations run in
            another process, and a watchdog stops an arm whose loop hangs.
        arm: description of the arm.
        table: IK table of its line.
        cell: limits of plausible readings of the load cell.
        description: a line about the robot, for the recordings.
        hooks: simulation, or operator.
        true_length: true length of the string [m]; None where it is unknown.
        recorder: makes a recorder.
    """

    robot: RobotInterface
    real: bool
    arm: urdf.Robot
    table: LineTable
    cell: LoadCellLimits
    description: str
    hooks: RigHooks
    true_length: float | None = None
    recorder: Callable[..., Recorder] = Recorder
