"""What Baxter's controller makes of commands, for the twin; and what it was sent, for whoever tests a commander."""

from dataclasses import dataclass, field

import numpy as np

import urdf
from pipeline.robot.protocol import Vector


@dataclass
class Tally:
    """What the twin was sent, for whoever tests a commander.

    Attributes:
        commands: that were followed.
        ignored: commands that were not: not a number, unknown joints, another mode, or while it was disabled.
        clipped: commands beyond a joint's range.
        largest_step: of a position from one command to the next (n,) [rad].
        timeouts: how often no command came for the timeout.
        after_timeout: commands that came after a timeout and moved the arm again.
        behind: time that this computer lost [s].
        received: time of each command on this computer's monotonic clock [s].
        positions: that each command asked for (n,) [rad].
    """

    commands: int = 0
    ignored: int = 0
    clipped: int = 0
    largest_step: Vector = field(default_factory=lambda: np.zeros(0))
    timeouts: int = 0
    after_timeout: int = 0
    behind: float = 0.0
    received: list[float] = field(default_factory=list)
    positions: list[Vector] = field(default_factory=list)


class CommandedArm:
    """What the robot's controller makes of commands: a posture to hold, its feed-forward, timeout and speed ratio."""

    def __init__(self, q: Vector, limits: urdf.Limits) -> None:
        self._limits = limits
        self.timeout, self.ratio = 0.2, 0.3
        self.target = q
        self._reference = q
        self._v = self._a = np.zeros_like(q)
        self._raw, self._changed = True, False
        self._last: float | None = None

    @property
    def waiting(self) -> bool:
        """Whether no command is being followed."""
        return self._last is None

    def hold(self, q: Vector) -> None:
        """Stay where the arm is, until the next command."""
        if self._last is not None:
            self.target = self._reference = q
            self._last, self._changed = None, True
            self._v = self._a = np.zeros_like(q)

    def feed(self, v: Vector, a: Vector) -> None:
        """Velocity and acceleration that go with the next command (n,), within the limits."""
        self._v = np.clip(v, -self._limits.velocity, self._limits.velocity)
        self._a = np.clip(a, -self._limits.acceleration, self._limits.acceleration)

    def command(self, q: Vector, now: float, raw: bool) -> None:
        """Go to a posture (n,) [rad], at once or within the speed ratio."""
        self.target, self._last, self._raw, self._changed = q, now, raw, True

    def timed_out(self, now: float) -> bool:
        """Whether the last command is too old."""
        return self._last is not None and now - self._last > self.timeout

    def advance(self, duration: float) -> tuple[Vector, Vector, Vector] | None:
        """The reference for the next `duration` seconds; None where it stays as it is."""
        if self._raw:
            self._reference = self.target
        else:
            step = self.ratio * self._limits.velocity * duration
            moved = self._reference + np.clip(self.target - self._reference, -step, step)
            self._changed |= bool(np.any(moved != self._reference))
            self._reference = moved
        changed, self._changed = self._changed, False
        return (self._reference, self._v, self._a) if changed else None
