"""Control laws of servo drives: from the equation of each law follow its torque, its derivatives and its exports.

    R = feed + share clip(u, -limit, limit),        u = gain error(command, q, v) + damping (v_cmd - v)

R is the torque that a drive gives by its law. Equations are written with operators that numpy and CasADi share, so that
the same lines are evaluated over recordings, differentiated in simulations and exported. A new law is a class here with
a line in `CONTROL_LAWS`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, ClassVar

import casadi as ca
import numpy as np

Signal = Any
"""A number, an array, or a CasADi expression."""


@dataclass(frozen=True, eq=False)
class DriveSignals:
    """What drives are told, and their settings: numbers, arrays or expressions.

    Attributes:
        feed: measured torque, or torque that is fed forward, N m or N.
        command: command of the law, in its unit.
        velocity: commanded velocity beside a position command, per s.
        limit: largest torque, N m or N; may be infinite.
        share: share of its torque that a drive gives, which may follow the supply voltage; 0 where it is off.
        gain: torque per error.
        damping: torque per velocity error beside a position error, N m s/rad or N s/m.
    """

    feed: Signal = 0.0
    command: Signal = 0.0
    velocity: Signal = 0.0
    limit: Signal = np.inf
    share: Signal = 1.0
    gain: Signal = 0.0
    damping: Signal = 0.0

    @property
    def all(self) -> tuple[Signal, ...]:
        """All signals, in their order."""
        return tuple(getattr(self, name) for name in DRIVE_SIGNALS)

    def changed(self, change: Callable[[Signal], Signal]) -> "DriveSignals":
        """The signals with a function applied to each."""
        return DriveSignals(*(change(signal) for signal in self.all))


DRIVE_SIGNALS = tuple(one.name for one in fields(DriveSignals))
"""Names of the signals of a drive, in their order."""


class ControlLaw(ABC):
    """Law by which a drive's torque follows its command and its motion.

    Attributes:
        gain_unit: unit of the gain of a joint that turns.
        error_unit: unit of the command and of the error.
        channel: recorded channel of the command.
        senses: ``"position"`` or ``"velocity"``, of which the error is; empty if neither is fed back.
    """

    gain_unit: ClassVar[str]
    error_unit: ClassVar[str]
    channel: ClassVar[str]
    senses: ClassVar[str] = ""

    @property
    def holds_position(self) -> bool:
        """Whether the command is a position, beside which a velocity may be commanded."""
        return self.channel == "q_cmd"

    @abstractmethod
    def error(self, command: Signal, q: Signal, v: Signal) -> Signal:
        """Error of which the drive makes a torque, at positions q and velocities v; by the command its slope is 1."""

    def unlimited_torque(self, told: DriveSignals, q: Signal, v: Signal) -> Signal:
        """Torque u that the law asks for before the limit, N m or N."""
        return told.gain * self.error(told.command, q, v)

    def torque(self, told: DriveSignals, q: Signal, v: Signal) -> Signal:
        """Torque R of the drive, N m or N."""
        return told.feed + told.share * _clipped(self.unlimited_torque(told, q, v), told.limit)

    def integrand(self, told: DriveSignals, q: Signal, v: Signal) -> Signal:
        """What the drive sums up over time for its integral action, N m or N."""
        return self.torque(told, q, v)

    def feedback(self, gain: float, damping: float) -> tuple[float, float]:
        """Torque per error of the position and of the velocity; 0 where it is not fed back."""
        told = DriveSignals(gain=gain, damping=damping)
        return self.unlimited_torque(told, -1.0, 0.0), self.unlimited_torque(told, 0.0, -1.0)


class PositionLaw(ControlLaw):
    """Proportional control of the position, with damping of the velocity error."""

    gain_unit, error_unit, channel, senses = "N m/rad", "rad", "q_cmd", "position"

    def error(self, command: Signal, q: Signal, v: Signal) -> Signal:
        """q_cmd - q."""
        del v
        return command - q

    def unlimited_torque(self, told: DriveSignals, q: Signal, v: Signal) -> Signal:
        """K (q_cmd - q) + d (v_cmd - v)."""
        return super().unlimited_torque(told, q, v) + told.damping * (told.velocity - v)


class VelocityLaw(ControlLaw):
    """Proportional control of the velocity."""

    gain_unit, error_unit, channel, senses = "N m s/rad", "rad/s", "v_cmd", "velocity"

    def error(self, command: Signal, q: Signal, v: Signal) -> Signal:
        """v_cmd - v."""
        del q
        return command - v


class TorqueLaw(ControlLaw):
    """The torque is commanded."""

    gain_unit, error_unit, channel = "1", "N m", "tau_ff"

    def error(self, command: Signal, q: Signal, v: Signal) -> Signal:
        """The command itself."""
        del q, v
        return command


class CurrentLaw(TorqueLaw):
    """The torque is in proportion to the motor's measured current."""

    gain_unit, error_unit, channel = "N m/A", "A", "current"


CONTROL_LAWS: Mapping[str, ControlLaw] = {
    "position": PositionLaw(),
    "velocity": VelocityLaw(),
    "torque": TorqueLaw(),
    "current": CurrentLaw(),
}
"""The laws by their names in model files."""


LawValue = Callable[[ControlLaw], Callable[[DriveSignals, Signal, Signal], Signal]]
"""A value of a law, such as ``lambda law: law.torque``."""


def over_joints(value: LawValue, laws: Sequence[ControlLaw], told: DriveSignals, q: Signal, v: Signal) -> list[Signal]:
    """A value of the law of each joint.

    Args:
        value: the value.
        laws: laws of the n joints.
        told: signals of the joints, (..., n) arrays or (n,) expressions.
        q: positions, likewise.
        v: velocities, likewise.
    """

    def of(joint: int, signal: Signal) -> Signal:
        return signal[..., joint] if isinstance(signal, np.ndarray) else signal[joint]

    return [value(law)(told.changed(partial(of, j)), of(j, q), of(j, v)) for j, law in enumerate(laws)]


def _clipped(torque: Signal, limit: Signal) -> Signal:
    """A torque within +-limit."""
    if isinstance(torque, ca.SX):
        return torque if isinstance(limit, float) and limit == np.inf else ca.fmax(-limit, ca.fmin(limit, torque))
    return np.clip(torque, -limit, limit)
