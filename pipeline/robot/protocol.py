"""The interface of a robot, simulated or real."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, Self

from urdf.robot import Array

if TYPE_CHECKING:
    from pipeline.record import Recorder
    from pipeline.robot.link import LinkStatistics

Vector = Array


@dataclass(frozen=True)
class JointState:
    """One reading of the joints.

    Attributes:
        time: time of the reading [s].
        q: joint positions (n,) [rad].
        v: joint velocities (n,) [rad/s]; all nan where the robot does not report them.
        tau: torques of the motors (n,) [N m]; all nan where the robot does not report them.
    """

    time: float
    q: Vector
    v: Vector
    tau: Vector


@dataclass(frozen=True)
class ForceSample:
    """One reading of the load cell.

    Attributes:
        time: time at which the sample was *received* [s]; the force acted earlier, by an unknown latency.
        force: string tension as the cell reports it [N].
    """

    time: float
    force: float


class RobotInterface(Protocol):
    """An arm with a load cell at its gripper, commanded in joint space at about 100 Hz."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the commanded joints, in the order of every joint vector."""

    @property
    def time(self) -> float:
        """The robot's clock [s]."""

    def command(self, q: Vector, v: Vector, a: Vector) -> None:
        """Send a reference to follow: positions, velocities and accelerations (n,) each [rad, rad/s, rad/s^2]."""

    def stop(self) -> None:
        """Bring the arm to rest within the acceleration limits and hold it until the next command.

        On a real robot a watchdog may call this method from another thread while another method runs.
        """

    def advance(self, duration: float) -> None:
        """Let `duration` seconds pass: a simulated robot simulates them, for a real robot the program waits."""

    def joint_state(self) -> JointState:
        """The latest reading of the joints."""

    def load_cell(self) -> list[ForceSample]:
        """Readings of the load cell received since the last call, oldest first."""


class RealRobot(RobotInterface, Protocol):
    """A real arm behind a connection; use it in a ``with`` block, after which the arm is enabled and holds its posture.

    Every command is checked before it is sent, see `pipeline.motion.gate`.

    Attributes:
        statistics: measured delays of the connection.
    """

    statistics: "LinkStatistics"

    def __enter__(self) -> Self: ...

    def __exit__(self, *_raised: object) -> None: ...

    def prepare(self) -> None:
        """Enable the arm without a motion.

        Raises:
            InputError: the arm cannot be enabled.
        """

    def newest_state(self) -> JointState:
        """The newest reading of the joints as it arrived, with its time on this program's clock.

        Raises:
            TaskFailedError: no state has arrived.
        """

    def announce_phase(self, phase: str) -> None:
        """Publish the name of the trial's phase for observers, where the robot can do so."""

    @property
    def recorder(self) -> "Callable[..., Recorder]":
        """Class of a trial's recorder: `Recorder`, or one that also publishes what it records."""
