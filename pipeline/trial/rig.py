"""A robot that is ready for a trial, with its description, table and load cell; a driver provides it."""

from collections.abc import Callable
from dataclasses import dataclass

import urdf
from ik import LineTable
from pipeline.loadcell.faults import FaultLimits
from pipeline.record import Recorder
from pipeline.robot.protocol import RobotInterface
from pipeline.trial.ending import Ending


@dataclass(frozen=True)
class Rig:
    """A robot, simulated or real, at the start posture with its load at rest.

    Attributes:
        robot: interface that moves and measures; its clock is the one that an experiment's nodes run on.
        real: whether time, and with it the arm, goes on while this program computes. Then long work is done beside the
            loop, and a watchdog stops an arm whose loop hangs. Else how long a computation takes changes no result.
        arm: its description.
        table: from its line to its joints.
        cell: what is in order for the load cell.
        description: a line about it, for the recordings.
        length: true length of the string [m]; None where nobody knows it.
        landed: whether the load is at rest in the box, asked once at the end of the protocol.
        judge: what a person adds to how a trial ended, once the arm holds.
        wait_until_calm: waits between two experiments until the load hangs still.
        announce: told what goes on, for others to see.
        recorder: makes a recorder.
    """

    robot: RobotInterface
    real: bool
    arm: urdf.Robot
    table: LineTable
    cell: FaultLimits
    description: str
    length: float | None = None
    landed: Callable[[], bool] = lambda: True
    judge: Callable[[Ending], Ending] = lambda ending: ending
    wait_until_calm: Callable[[], None] = lambda: None
    announce: Callable[[str], None] = lambda _what: None
    recorder: Callable[..., Recorder] = Recorder
