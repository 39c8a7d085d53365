"""Safety gates: they check every command to the joints, and every reference on the line, and refuse unsafe ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

import urdf
from pipeline.motion.limits import LineLimits
from pipeline.motion.trajectory import LineState
from urdf.robot import Array

if TYPE_CHECKING:
    from ik import LineTable
    from pipeline.robot.protocol import JointState

CONTROL_PERIOD_SECONDS = 0.01
"""Duration of a control cycle, the time between two commands [s]."""
MAX_STATE_AGE_SECONDS = 0.05
"""Largest age of the newest joint state at which a command may be sent [s]."""
NEW_STREAM_PAUSE_SECONDS = 0.05
"""Pause after which further commands are a new stream [s]."""
MIN_COMMAND_SPACING_SECONDS = 1e-6
"""Smallest assumed time between two commands [s], because a clock may show the same time twice."""
MAX_STREAM_START_OFFSET = 1e-6
"""Largest distance of a stream's first command from the arm's position [rad]; it allows for rounding only."""
LIMIT_TOLERANCE_SHARE = 1e-3
"""Share by which a limit may be exceeded, because of rounding and interpolation."""
MAX_TRACKING_ERROR = 0.2
"""Largest distance of a joint from its command [rad]; Baxter's own controller stops there too."""
MAX_JOINT_SPEED_AT_REST = 1e-3
"""Commanded speed below which a joint counts as at rest [rad/s]."""


class CommandRefusalReason(Enum):
    """Reason why a gate refused a command or a reference; the value is a sentence with advice."""

    NOT_A_NUMBER = "a command holds a NaN or an infinity, it is not finite: look at the node that made it"
    WRONG_NUMBER = "a command has the wrong number of joints: look at the node that made it"
    NO_STATE = "no joint state has arrived: is the robot on, and is this its topic?"
    STALE = "the newest joint state is too old: check the network, the bridge and the robot"
    POSITION = "a joint would leave its range: choose a nearer target"
    VELOCITY = "a joint would be faster than its limit: slow the motion down"
    ACCELERATION = "a joint would accelerate more than its limit: smooth the motion"
    JERK = "a joint would jerk more than its limit: smooth the motion"
    TRACKING = (
        "the arm is not where it was commanded to be: something holds it, it is not enabled, or it starts elsewhere"
    )
    ELSEWHERE = "a motion would begin away from where the arm is: move it there first"
    GAP = "the commands paused while the arm moved: check the load of this computer"
    OFF_THE_LINE = "the reference leaves the line that the table covers: move the target inwards"
    LINE_SPEED = "the reference is faster along the line than the joints can follow there: smooth it"
    LINE_ACCELERATION = "the reference accelerates more along the line than the joints can follow there: smooth it"
    JUMP = "the reference does not follow from the one before it: smooth it, or start it from where the arm is"
    NO_WAY_TO_REST = "the reference cannot be brought to rest within the limits: slow down earlier"


@dataclass(frozen=True)
class Refusal:
    """Refusal of a command or a reference by a gate.

    Attributes:
        why: the reason.
        detail: the joint, its value and the limit, as a text; may be empty.
    """

    reason: CommandRefusalReason
    detail: str = ""

    @property
    def sentence(self) -> str:
        """The reason and the detail as a sentence."""
        return f"{self.reason.value}{f' ({self.detail})' if self.detail else ''}"


class JointCommandCheck:
    """Checks a single command to the joints against the joint limits and the measured position.

    Args:
        names: names of the joints.
        limits: limits of the joints.
    """

    def __init__(self, names: tuple[str, ...], limits: urdf.Limits) -> None:
        self._names, self._limits = names, limits

    def check(self, q: Array, v: Array, a: Array, measured: Array | None = None) -> Refusal | None:
        """Check a command; returns the first violation, or None if the command may be sent.

        Args:
            q: commanded positions, (n,) [rad].
            v: commanded velocities, (n,) [rad/s].
            a: commanded accelerations, (n,) [rad/s^2].
            measured: measured positions, from which the command may not be far, (n,) [rad]; None to skip this check.
        """
        refusal = self._form(q, v, a) or self._beyond(q, v, a)
        return refusal if refusal is not None or measured is None else self._follows(q, measured)

    def _form(self, q: Array, v: Array, a: Array) -> Refusal | None:
        if any(np.shape(x) != (len(self._names),) for x in (q, v, a)):
            return Refusal(CommandRefusalReason.WRONG_NUMBER, f"{np.size(q)} of {len(self._names)} joints")
        if not all(np.isfinite(x).all() for x in (q, v, a)):
            return Refusal(CommandRefusalReason.NOT_A_NUMBER)
        return None

    def _follows(self, q: Array, measured: Array) -> Refusal | None:
        return self._most(CommandRefusalReason.TRACKING, np.abs(q - measured), MAX_TRACKING_ERROR, "rad")

    def _beyond(self, q: Array, v: Array, a: Array) -> Refusal | None:
        limits, more = self._limits, 1.0 + LIMIT_TOLERANCE_SHARE
        outside = ~((q >= limits.lower) & (q <= limits.upper))
        if np.any(outside):
            joint = int(np.argmax(outside))
            return Refusal(CommandRefusalReason.POSITION, f"{self._names[joint]}: {q[joint]:.4g} rad")
        return self._most(CommandRefusalReason.VELOCITY, np.abs(v), more * limits.velocity, "rad/s") or self._most(
            CommandRefusalReason.ACCELERATION, np.abs(a), more * limits.acceleration, "rad/s^2"
        )

    def _most(self, why: CommandRefusalReason, value: Array, bound: Array | float, unit: str) -> Refusal | None:
        """Refusal if a value exceeds its bound or is nan, for the joint with the largest excess; None otherwise."""
        if np.all(value <= bound):
            return None
        joint = int(np.argmax(value / bound))
        most = np.broadcast_to(bound, value.shape)[joint]
        return Refusal(why, f"{self._names[joint]}: {value[joint]:.3g} of {most:.3g} {unit}")


@dataclass(frozen=True)
class LineReferenceCheck:
    """Checks references on the line against the limits along the line and against the limits of the joints.

    A reference is the state that the tool should have at the end of a control cycle.

    Attributes:
        limits: limits along the line.
        table: IK table of the line.
        joints: gate of the joints.
    """

    limits: LineLimits
    table: LineTable
    joints: JointCommandCheck

    def check(
        self, reference: LineState, previous: LineState | None = None, measured: Array | None = None
    ) -> Refusal | None:
        """Check a reference; returns the first violation, or None if the reference may be sent.

        Args:
            reference: the reference.
            previous: reference of the cycle before, which it must continue smoothly; None for the first one.
            measured: measured joint positions, from which it may not be far, (n,) [rad]; None to skip this check.
        """
        if not reference.is_finite:
            return Refusal(CommandRefusalReason.NOT_A_NUMBER)
        more = 1.0 + LIMIT_TOLERANCE_SHARE
        s, v, a = reference
        # Written in this form, the comparison also refuses for a limit that is nan.
        if not self.limits.s_min - 1e-9 <= s <= self.limits.s_max + 1e-9:
            return Refusal(CommandRefusalReason.OFF_THE_LINE, f"s = {s:.4g} m")
        if not abs(v) <= more * self.limits.speed_at(s):
            return Refusal(CommandRefusalReason.LINE_SPEED, f"{v:.3g} m/s")
        if not abs(a) <= more * self.limits.acceleration_at(s):
            return Refusal(CommandRefusalReason.LINE_ACCELERATION, f"{a:.3g} m/s^2")
        if previous is not None and not self._follows(reference, previous):
            return Refusal(CommandRefusalReason.JUMP)
        s = min(max(s, float(self.table.s[0])), float(self.table.s[-1]))
        return self.joints.check(*self.table.joint_motion(s, v, a), measured)

    def _follows(self, reference: LineState, previous: LineState) -> bool:
        """Whether a motion with bounded jerk leads from one reference to the next in a cycle."""
        h, jerk = CONTROL_PERIOD_SECONDS, (1.0 + LIMIT_TOLERANCE_SHARE) * self.limits.jerk
        s, v, a = (now - before for now, before in zip(reference, previous, strict=True))
        # Bounds on the change in one cycle of bounded jerk, from the Taylor series at its beginning.
        return (
            abs(a) <= jerk * h + 1e-9
            and abs(v - previous.a * h) <= jerk * h**2 / 2.0 + 1e-9
            and abs(s - previous.v * h - previous.a * h**2 / 2.0) <= jerk * h**3 / 6.0 + 1e-9
        )


class CommandStreamCheck(JointCommandCheck):
    """Checks each command of a stream against the commands before it and the arm's measured position.

    The arm follows a sequence of positions. The first, second and third divided differences of the positions are the
    velocity, acceleration and jerk that are checked; velocities and accelerations that are sent as feed-forward are
    checked too. A command that comes early is checked with the true time since the last one. A command that comes late
    is checked with the duration of a cycle, for which it was computed.

    Args:
        names: names of the joints.
        limits: limits of the joints.
    """

    def __init__(self, names: tuple[str, ...], limits: urdf.Limits) -> None:
        super().__init__(names, limits)
        self._last: list[Array] = []
        self._spacings = [CONTROL_PERIOD_SECONDS] * 3
        self._sent = -np.inf

    @property
    def at_rest(self) -> bool:
        """Whether the last two commands of the stream were the same position."""
        return len(self._last) < 2 or bool(
            np.all(np.abs(self._last[-1] - self._last[-2]) <= MAX_JOINT_SPEED_AT_REST * self._spacings[-1])
        )

    def begins_stream(self, now: float) -> bool:
        """Whether a command at the time `now` [s] begins a new stream, because there was none before or a pause."""
        return not self._last or (now - self._sent > NEW_STREAM_PAUSE_SECONDS and self.at_rest)

    def check_next(self, q: Array, v: Array, a: Array, state: JointState | None, now: float) -> Refusal | None:
        """Check the next command; returns a refusal, or None if it may be sent; then it counts as sent.

        Args:
            q: commanded positions, (n,) [rad].
            v: commanded velocities, (n,) [rad/s].
            a: commanded accelerations, (n,) [rad/s^2].
            state: newest measured state of the joints; None if there is none.
            now: present time on the clock of the measured states [s].
        """
        refusal = self._form(q, v, a) or self._arm(q, state, now) or self._beginning(q, v, state, now)
        spacings = (
            [*self._spacings[-2:], min(max(now - self._sent, MIN_COMMAND_SPACING_SECONDS), CONTROL_PERIOD_SECONDS)]
            if self._last
            else [CONTROL_PERIOD_SECONDS] * 3
        )
        refusal = refusal or self._continued(q, v, a, np.array(spacings))
        if refusal is None:
            self._last = [*self._last[-2:], np.array(q, dtype=float)] if self._last else [np.array(q, dtype=float)] * 3
            self._spacings, self._sent = spacings, now
        return refusal

    def _arm(self, q: Array, state: JointState | None, now: float) -> Refusal | None:
        """Refusal if the arm's position is unknown or too far from the commanded one; None otherwise."""
        if state is None:
            return Refusal(CommandRefusalReason.NO_STATE)
        age = now - state.time
        if not age <= MAX_STATE_AGE_SECONDS:
            return Refusal(CommandRefusalReason.STALE, f"{1e3 * age:.0f} ms")
        return self._follows(q, state.q)

    def _beginning(self, q: Array, v: Array, state: JointState | None, now: float) -> Refusal | None:
        """Refusal if a stream does not begin at rest at the arm's position, or continues after a pause."""
        if not self.begins_stream(now):
            late = now - self._sent
            return (
                None if late <= NEW_STREAM_PAUSE_SECONDS else Refusal(CommandRefusalReason.GAP, f"{1e3 * late:.0f} ms")
            )
        self._last = []
        assert state is not None, "the state was judged before"
        moving = self._most(CommandRefusalReason.ELSEWHERE, np.abs(v), MAX_JOINT_SPEED_AT_REST, "rad/s")
        return moving or self._most(CommandRefusalReason.ELSEWHERE, np.abs(q - state.q), MAX_STREAM_START_OFFSET, "rad")

    def _continued(self, q: Array, v: Array, a: Array, spacings: Array) -> Refusal | None:
        """Refusal if differences of positions, or feed-forward values, exceed a limit; None otherwise."""
        path = np.array([*self._last[-3:], q]) if self._last else np.array([q] * 4)
        velocities = np.diff(path, axis=0) / spacings[:, None]
        accelerations = np.diff(velocities, axis=0) / (0.5 * (spacings[1:] + spacings[:-1]))[:, None]
        jerk = np.abs(accelerations[1] - accelerations[0]) / np.mean(spacings)
        refusal = self._beyond(
            q, np.maximum(np.abs(velocities[-1]), np.abs(v)), np.maximum(np.abs(accelerations[-1]), np.abs(a))
        )
        refusal = refusal or self._most(
            CommandRefusalReason.JERK, jerk, (1.0 + LIMIT_TOLERANCE_SHARE) * self._limits.jerk, "rad/s^3"
        )
        early = spacings[-1] < (1.0 - LIMIT_TOLERANCE_SHARE) * CONTROL_PERIOD_SECONDS
        if refusal is None or not early:
            return refusal
        return replace(refusal, detail=f"{refusal.detail}, {1e3 * spacings[-1]:.3g} ms after the command before")
