"""The end of a trial: the arm is brought to rest in every case, and a sentence gives the reason for the end."""

import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from pipeline.nodes.drive import DriveNode
from pipeline.nodes.measurement import MeasurementNode
from pipeline.robot.protocol import RobotInterface

MAX_BRAKING_SECONDS = 3.0
"""Longest time for braking along the line [s], ten times that from the highest speed; then the robot brakes alone."""
REST_RECORDING_SECONDS = 0.3
"""Time for which the arm is recorded after the last command [s], because a compliant arm still moves."""


@dataclass(frozen=True)
class TrialEnding:
    """The end of a trial: success, and a sentence with the reason.

    Attributes:
        success: whether the load came to rest in the box.
        message: sentence for the user.
        stopped: whether the trial was ended early, for safety or by the user.
        unwritten: sentence on files that could not be written, such as on a full disk; empty where all were.
    """

    success: bool
    message: str
    stopped: bool
    unwritten: str = field(default="", kw_only=True)


def bring_to_rest(
    drive: DriveNode, measurement: MeasurementNode, robot: RobotInterface, beat: Callable[[], None] | None = None
) -> list[str]:
    """Brake the arm along its line within its limits, then hold its posture; if this fails, the robot brakes alone.

    Time is counted in cycles here, because the clock may have failed.

    Args:
        drive: node that sends the commands.
        measurement: node that records the braking.
        robot: robot that is commanded to hold at the end.
        beat: function that resets a watchdog, called in every cycle; None for no watchdog.

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
    for _ in range(round(REST_RECORDING_SECONDS / drive.period)):
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
        sent = drive.last_command_time
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


def signal_sentence(number: int) -> str:
    """Sentence on the meaning of a signal of the operating system, such as "interrupted by the user"."""
    return _SENTENCES[signal.Signals(number).name]
