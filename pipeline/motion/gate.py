"""The gate before every cycle: nothing is sent to the arm that has not passed it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from pipeline.motion.limits import LineLimits
from pipeline.motion.trajectory import LineState
from urdf.robot import Array

if TYPE_CHECKING:
    import urdf
    from ik import LineTable


class Refusal(Enum):
    """Why the gate refuses the next reference; the value is the sentence for a person."""

    NOT_A_NUMBER = "The reference holds a NaN or an infinity: stop, and look at the node that made it."
    OFF_THE_LINE = "The reference leaves the line that the table covers: stop, and move the target inwards."
    TOO_FAST = "The reference is faster along the line than the joints can follow there: smooth it."
    TOO_STRONG = "The reference accelerates more along the line than the joints can follow there: smooth it."
    JUMP = "The reference does not follow from the one before it: smooth it, or start it from where the arm is."
    JOINT_POSITION = "A joint would leave its range: the table does not belong to this robot; build it again."
    JOINT_VELOCITY = "A joint would be faster than its limit: slow the motion down."
    JOINT_ACCELERATION = "A joint would accelerate more than its limit: smooth the motion."
    NO_WAY_TO_REST = "The reference cannot be brought to rest within the limits: slow down earlier."
    ARM_ELSEWHERE = "The arm is not where the reference is: something holds it, or the motion starts elsewhere."


@dataclass(frozen=True)
class Gate:
    """Cheap check of the next reference, once per control cycle.

    Attributes:
        limits: along the line.
        table: from the line to the joints.
        joints: limits of the joints.
        dt: control cycle [s].
        tracking: farthest that any joint may be from its reference [rad]. Baxter's own server stops at 0.2.
        tolerance: share by which a limit may be exceeded, for rounding and for tables between nodes [1].
    """

    limits: LineLimits
    table: LineTable
    joints: urdf.Limits
    dt: float
    tracking: float = 0.2
    tolerance: float = 1e-3

    def check(
        self,
        reference: LineState,
        previous: LineState | None = None,
        measured: Array | None = None,
    ) -> Refusal | None:
        """Judge the next reference.

        Args:
            reference: of the next cycle.
            previous: that of the cycle before, from which it must follow; None at the start of a motion.
            measured: joint positions now (n,); None where they are not watched [rad].

        Returns:
            The first limit that is broken; None where the reference may be sent.
        """
        if not reference.is_finite:
            return Refusal.NOT_A_NUMBER
        more = 1.0 + self.tolerance
        s, v, a = reference
        if not self.limits.s_min - 1e-9 <= s <= self.limits.s_max + 1e-9:
            return Refusal.OFF_THE_LINE
        if abs(v) > more * self.limits.speed_at(s):
            return Refusal.TOO_FAST
        if abs(a) > more * self.limits.acceleration_at(s):
            return Refusal.TOO_STRONG
        if previous is not None and not self._follows(reference, previous):
            return Refusal.JUMP
        return self._joints(reference, measured)

    def _follows(self, reference: LineState, previous: LineState) -> bool:
        """Whether two references belong to one motion whose jerk is bounded."""
        h, jerk = self.dt, (1.0 + self.tolerance) * self.limits.jerk
        s, v, a = (now - before for now, before in zip(reference, previous, strict=True))
        # Within one cycle of bounded jerk, from the Taylor series about its beginning.
        return (
            abs(a) <= jerk * h + 1e-9
            and abs(v - previous.a * h) <= jerk * h**2 / 2.0 + 1e-9
            and abs(s - previous.v * h - previous.a * h**2 / 2.0) <= jerk * h**3 / 6.0 + 1e-9
        )

    def _joints(self, reference: LineState, measured: Array | None) -> Refusal | None:
        s = min(max(reference.s, float(self.table.s[0])), float(self.table.s[-1]))
        q, v, a = self.table.joint_motion(s, reference.v, reference.a)
        more = 1.0 + self.tolerance
        if np.any((q < self.joints.lower) | (q > self.joints.upper)):
            return Refusal.JOINT_POSITION
        if np.any(np.abs(v) > more * self.joints.velocity):
            return Refusal.JOINT_VELOCITY
        if np.any(np.abs(a) > more * self.joints.acceleration):
            return Refusal.JOINT_ACCELERATION
        if measured is not None and not np.all(np.abs(measured - q) <= self.tracking):
            return Refusal.ARM_ELSEWHERE
        return None
