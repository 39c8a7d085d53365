"""The end of a trial: the arm comes to rest in every case, and one sentence tells a person why the trial ended."""

import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from pipeline.nodes.drive import DriveNode
from pipeline.nodes.measurement import MeasurementNode
from pipeline.robot.protocol import RobotInterface

MAX_BRAKING_SECONDS = 3.0
"""Braking from the highest speed takes 0.3 s; after this time [s] the robot is told to brake on its own."""
REST_WATCH_SECONDS = 0.3
"""How long the arm is watched at rest [s]: its servo is soft, and the end of the motion belongs to the recording."""


@dataclass(frozen=True)
class Ending:
    """The end of a trial: success, and a sentence for a person.

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
    """Brake along the line within its limits, then hold; where this fails, the robot brakes on its own.

    Only the drive and the measurement run. The time is counted in cycles, because the clock may be what failed.

    Args:
        drive: node that sends the commands.
        measurement: node that records the braking.
        robot: robot that is commanded to hold at the end.
        beat: called in every cycle to reset a watchdog; None where there is no watchdog.

    Returns:
        A sentence for every failure while braking; empty where nothing failed.
    """
    failed: list[str] = []
    drive.stop()
    _brake(drive, measurement, robot, beat, failed)
    try:
        # Needed after a perfect stop too: from here on the robot holds its posture without this program.
        drive.halt()
    except Exception as error:
        failed.append(f"the robot did not take the command to stop ({type(error).__name__}: {error})")
    for _ in range(round(REST_WATCH_SECONDS / drive.period)):
        try:
            robot.advance(drive.period)
        except Exception as error:
            failed.append(f"how the arm came to rest was not watched to the end ({type(error).__name__}: {error})")
            break
        with suppress(Exception):  # the trial's end is explained already; this only completes the recording
            measurement.step(robot.time)
    return failed


def _brake(
    drive: DriveNode,
    measurement: MeasurementNode,
    robot: RobotInterface,
    beat: Callable[[], None] | None,
    failed: list[str],
) -> None:
    """Send braking references until the commanded motion is at rest."""
    try:
        sent = drive.sent_at
        due = sent is None or robot.time - sent >= drive.period / 2
        for _ in range(round(MAX_BRAKING_SECONDS / drive.period)):
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
    """Sentence that tells a person what a signal means."""
    return _SENTENCES[signal.Signals(number).name]
