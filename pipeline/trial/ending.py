"""How a trial ends: the arm comes to rest, whatever has happened, and why is told in one sentence for a person."""

import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from pipeline.nodes.drive import DriveNode
from pipeline.nodes.measurement import MeasurementNode
from pipeline.robot.protocol import RobotInterface

LONGEST = 3.0
"""Braking from the highest speed takes 0.3 s; after this time [s] the robot is told to brake on its own."""
SETTLED_FOR = 0.3
"""How long the arm is watched at rest [s]: its servo is soft, and the end of the motion belongs to the recording."""


@dataclass(frozen=True)
class Ending:
    """How a run ended.

    Attributes:
        success: whether the load came to rest in the box.
        message: a sentence for a person.
        stopped: whether it was ended before its time, for safety or by the user.
    """

    success: bool
    message: str
    stopped: bool


def come_to_rest(
    drive: DriveNode, measurement: MeasurementNode, robot: RobotInterface, beat: Callable[[], None] | None = None
) -> list[str]:
    """Brake along the line within its limits, then hold; where that fails, let the robot brake on its own.

    Only the drive and the measurement run. The time is counted in cycles, because the clock may be what failed.

    Args:
        drive: that sends the commands.
        measurement: that records how the arm comes to rest.
        robot: that is told to hold at the end.
        beat: tells a watchdog in every cycle that this goes on; None where there is none.

    Returns:
        A sentence for everything that failed on the way; empty where nothing did.
    """
    failed: list[str] = []
    drive.stop()
    _brake(drive, measurement, robot, beat, failed)
    try:
        # Also after a perfect stop: from here on the robot holds without this program.
        drive.halt()
    except Exception as error:
        failed.append(f"the robot did not take the command to stop ({type(error).__name__}: {error})")
    for _ in range(round(SETTLED_FOR / drive.period)):
        try:
            robot.advance(drive.period)
        except Exception as error:
            failed.append(f"how the arm came to rest was not watched to the end ({type(error).__name__}: {error})")
            break
        with suppress(Exception):  # it has been noted why the trial ended; this only completes the recording
            measurement.step(robot.time)
    return failed


def _brake(
    drive: DriveNode,
    measurement: MeasurementNode,
    robot: RobotInterface,
    beat: Callable[[], None] | None,
    failed: list[str],
) -> None:
    """Send braking references until the arm is told to stand still."""
    try:
        sent = drive.sent_at
        due = sent is None or robot.time - sent >= drive.period / 2
        for _ in range(round(LONGEST / drive.period)):
            if drive.at_rest:
                return
            if beat is not None:
                beat()
            if not due:
                robot.advance(drive.period)
                with suppress(Exception):  # a stop needs no measurement
                    measurement.step(robot.time)
            due = False
            drive.step(robot.time)
    except Exception as error:
        failed.append(f"braking failed as well ({type(error).__name__}: {error}), so the robot stopped on its own")


_SENTENCES = {
    "SIGINT": "interrupted by the user",
    "SIGTERM": "ended from outside (SIGTERM)",
    "SIGHUP": "ended because its terminal was closed (SIGHUP)",
}


def sentence_of_signal(number: int) -> str:
    """What a signal means."""
    return _SENTENCES[signal.Signals(number).name]
