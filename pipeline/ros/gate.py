"""The one gate that every command to a real arm passes; whatever it withholds ends the run."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

import urdf
from pipeline.robot.protocol import JointState, Vector

PERIOD = 0.01
"""Time between two commands [s]."""
FRESH = 0.05
"""Oldest joint state with which a command may be sent [s]."""
GAP = 0.05
"""Silence after which a stream of commands is a new one [s]."""
NEAR = 1e-6
"""How far from where the arm is a stream may begin [rad]: for rounding. A step would break every limit."""
TOLERANCE = 1e-3
"""Share by which a limit may be exceeded, for rounding and for tables between nodes: that of the motion's gate."""
REST_SPEED = 1e-3
"""Commanded speed below which a stream is at rest [rad/s]."""


class Withheld(Enum):
    """Why a command was not sent; the value says it to a person, with what to do."""

    NOT_A_NUMBER = "a command holds a NaN or an infinity: look at the node that made it"
    WRONG_NUMBER = "a command has the wrong number of joints: look at the node that made it"
    NO_STATE = "no joint state has arrived: is the robot on, and is this its topic?"
    STALE = "the newest joint state is too old: check the network, the bridge and the robot"
    POSITION = "a joint would leave its range: choose a nearer target"
    VELOCITY = "a joint would be faster than its limit: slow the motion down"
    ACCELERATION = "a joint would accelerate more than its limit: smooth the motion"
    JERK = "a joint would jerk more than its limit: smooth the motion"
    TRACKING = "the arm is not where it was told to be: something holds it, or it is not enabled"
    ELSEWHERE = "a motion would begin away from where the arm is: move it there first"
    GAP = "the commands paused while the arm moved: check the load of this computer"


@dataclass(frozen=True)
class Refusal:
    """Why, which joint, and by how much."""

    why: Withheld
    detail: str = ""

    @property
    def sentence(self) -> str:
        """For a person."""
        return f"{self.why.value}{f' ({self.detail})' if self.detail else ''}"


class CommandGate:
    """Judges the next command against the ones before it and against where the arm is now.

    What leaves is a sequence of positions, so positions are judged: their first, second and third differences are the
    velocity, acceleration and jerk that the arm sees. Velocities and accelerations that go along as feed-forward are
    held against the same limits.

    Args:
        names: of the joints.
        limits: of the joints.
        tracking: farthest that a joint may be from its command [rad]; Baxter's own server stops at 0.2.
    """

    def __init__(self, names: tuple[str, ...], limits: urdf.Limits, tracking: float = 0.2) -> None:
        self._names, self._limits, self._tracking = names, limits, tracking
        self._last: list[Vector] = []
        self._sent = -np.inf

    @property
    def at_rest(self) -> bool:
        """Whether the last two commands were the same posture."""
        return len(self._last) < 2 or bool(np.all(np.abs(self._last[-1] - self._last[-2]) <= REST_SPEED * PERIOD))

    def begins(self, now: float) -> bool:
        """Whether the next command begins a stream, from rest [s]."""
        return not self._last or (now - self._sent > GAP and self.at_rest)

    def judge(self, q: Vector, v: Vector, a: Vector, state: JointState | None, now: float) -> Refusal | None:
        """Why a command must not be sent; None where it may, and it is then counted as sent.

        Args:
            q: positions (n,) [rad].
            v: velocities (n,) [rad/s].
            a: accelerations (n,) [rad/s^2].
            state: the newest reading of the joints.
            now: [s], on the clock of the state.
        """
        refusal = self._form(q, v, a) or self._arm(q, state, now) or self._beginning(q, v, state, now)
        refusal = refusal or self._limits_of(q, v, a)
        if refusal is None:
            self._last = [*self._last[-2:], np.array(q, dtype=float)] if self._last else [np.array(q, dtype=float)] * 3
            self._sent = now
        return refusal

    def _form(self, q: Vector, v: Vector, a: Vector) -> Refusal | None:
        if any(np.shape(x) != (len(self._names),) for x in (q, v, a)):
            return Refusal(Withheld.WRONG_NUMBER)
        if not all(np.isfinite(x).all() for x in (q, v, a)):
            return Refusal(Withheld.NOT_A_NUMBER)
        return None

    def _arm(self, q: Vector, state: JointState | None, now: float) -> Refusal | None:
        """Is it known where the arm is, and is it there?"""
        if state is None:
            return Refusal(Withheld.NO_STATE)
        age = now - state.time
        if not age <= FRESH:
            return Refusal(Withheld.STALE, f"{1e3 * age:.0f} ms")
        return self._most(Withheld.TRACKING, np.abs(q - state.q), np.full(len(q), self._tracking), "rad")

    def _beginning(self, q: Vector, v: Vector, state: JointState | None, now: float) -> Refusal | None:
        """A stream begins at rest where the arm is; one that paused while the arm moved does not go on."""
        if not self.begins(now):
            late = now - self._sent
            return None if late <= GAP else Refusal(Withheld.GAP, f"{1e3 * late:.0f} ms")
        self._last = []
        assert state is not None, "the state was judged before"
        moving = self._most(Withheld.ELSEWHERE, np.abs(v), np.full(len(q), REST_SPEED), "rad/s")
        return moving or self._most(Withheld.ELSEWHERE, np.abs(q - state.q), np.full(len(q), NEAR), "rad")

    def _limits_of(self, q: Vector, v: Vector, a: Vector) -> Refusal | None:
        limits, more = self._limits, 1.0 + TOLERANCE
        if np.any((q < limits.lower) | (q > limits.upper)):
            joint = int(np.argmax((q < limits.lower) | (q > limits.upper)))
            return Refusal(Withheld.POSITION, f"{self._names[joint]}: {q[joint]:.4g} rad")
        path = np.array([*self._last[-3:], q]) if self._last else np.array([q] * 4)
        velocity, acceleration, jerk = (
            np.abs(np.diff(path, n=order, axis=0)[-1]) / PERIOD**order for order in (1, 2, 3)
        )
        return (
            self._most(Withheld.VELOCITY, np.maximum(velocity, np.abs(v)), more * limits.velocity, "rad/s")
            or self._most(
                Withheld.ACCELERATION, np.maximum(acceleration, np.abs(a)), more * limits.acceleration, "rad/s^2"
            )
            or self._most(Withheld.JERK, jerk, more * limits.jerk, "rad/s^3")
        )

    def _most(self, why: Withheld, value: Vector, bound: Vector, unit: str) -> Refusal | None:
        """A refusal where a value exceeds its bound, naming the joint that exceeds it most."""
        if np.all(value <= bound):
            return None
        joint = int(np.argmax(value / bound))
        return Refusal(why, f"{self._names[joint]}: {value[joint]:.3g} of {bound[joint]:.3g} {unit}")
