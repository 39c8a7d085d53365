"""The stages of a load on a string: symbolic gripper, string, load, tension and sensor.

Each stage is an immutable bundle of CasADi expressions; an effect takes a stage and returns a changed one. Vectors are
(3,) in the frame of the line: x along the line, y across it, z up. The angle is 0 where the load hangs straight down,
and the load is at x = -l sin(angle): a positive angle puts the load on the negative side.
"""

from dataclasses import dataclass, replace

import casadi as ca

from armdyn.physics.definition import ZERO, Expression, Stage

__all__ = [
    "STANDARD_GRAVITY", "Expression", "Gripper", "Load", "Sensor", "Stage", "String", "Tension", "smooth_sign",
    "smooth_speed", "torque_with_smooth_friction",
]  # fmt: skip

ZERO_VECTOR: Expression = ca.SX.zeros(3)
STANDARD_GRAVITY = 9.81
"""Default gravity of a pendulum, m/s^2."""
GRAVITY_STD = 0.02
"""Standard deviation of gravity on Earth about `STANDARD_GRAVITY`, m/s^2: 9.780 at the equator and 9.832 at the poles,
less 0.003 for every kilometre of height."""
DRY_FRICTION_SMOOTHING_SWING_RATE = 0.02
"""Swing rate, rad/s, over which a smooth approximation of dry friction changes its sign."""
LOAD_SPEED_ADDED_IN_QUADRATURE = 1e-9
"""Speed, m/s, whose square is added to the squared speed of a load, so that the derivative exists at rest."""


def smooth_sign(rate: Expression, width: float) -> Expression:
    """Smooth sign function tanh(rate / width), which has derivatives everywhere."""
    return ca.tanh(rate / width)


def torque_with_smooth_friction(torque: Expression, dry: Expression, rate: Expression) -> Expression:
    """A torque, N m, less a smooth approximation of dry friction of size `dry`, N m, at a swing rate, rad/s."""
    return torque - dry * smooth_sign(rate, DRY_FRICTION_SMOOTHING_SWING_RATE)


@dataclass(frozen=True)
class Gripper(Stage):
    """Stage of a pendulum: the gripper, which holds the string's upper end.

    Attributes:
        time: time since the start of the run, s.
        x: measured position along the line, m.
        v: velocity along the line, m/s.
        z: measured height, m.
        angle: swing angle, rad.
        position: (3,) point at which the string is attached, m.
        lag: first-order time constant of the real gripper behind the measured one, s.
        compliance: displacement along the line per force, m/N.
        tilt: angle of the line against the horizontal, rad; with a positive angle gravity pulls towards +.
    """

    time: Expression
    x: Expression
    v: Expression
    z: Expression
    angle: Expression
    position: Expression
    lag: Expression = ZERO
    compliance: Expression = ZERO
    tilt: Expression = ZERO

    def with_position(self, position: Expression) -> "Gripper":
        """Attach the string at another point, (3,) m."""
        return replace(self, position=position)

    def with_lag(self, time_constant: Expression) -> "Gripper":
        """Add `time_constant`, s, to the first-order lag of the gripper behind its measured position."""
        return replace(self, lag=self.lag + time_constant)

    def with_compliance(self, compliance: Expression) -> "Gripper":
        """Add a compliance, m/N, with which the gripper yields to the tension along its line."""
        return replace(self, compliance=self.compliance + compliance)

    def with_tilt(self, angle: Expression) -> "Gripper":
        """Tilt the line by an angle, rad, so that gravity pulls towards its positive end."""
        return replace(self, tilt=self.tilt + angle)


@dataclass(frozen=True)
class String(Stage):
    """Stage of a pendulum: the string, which connects gripper and load.

    Attributes:
        time: time since the start of the run, s.
        angle: swing angle, rad.
        rate: swing rate, rad/s.
        load_mass: mass of the load, kg.
        length: pivot to the load's centre, m.
        gravity: acceleration of free fall, m/s^2.
        torque: sum of the torques about the pivot that act along the angle, N m.
        dry: sum of the sizes of the dry frictions at the pivot, N m.
        mass: mass of the string, uniform along its length, kg.
        compliance: stretch per tension, m/N.
        damped: compliance times the damping ratio of the load's bounce on the string, m/N.
    """

    time: Expression
    angle: Expression
    rate: Expression
    load_mass: Expression
    length: Expression
    gravity: Expression
    torque: Expression = ZERO
    dry: Expression = ZERO
    mass: Expression = ZERO
    compliance: Expression = ZERO
    damped: Expression = ZERO

    @property
    def pull(self) -> Expression:
        """Force on the pivot, N, for a pivot at rest and a rigid string: m (g cos phi + l phi'^2)."""
        weight = (self.load_mass + self.mass) * self.gravity * ca.cos(self.angle)
        return weight + (self.load_mass + self.mass / 2) * self.length * self.rate**2

    def with_length(self, length: Expression) -> "String":
        """Replace the length, m; it may depend on time and angle."""
        return replace(self, length=length)

    def with_torque(self, torque: Expression) -> "String":
        """Add a torque about the pivot, N m."""
        return replace(self, torque=self.torque + torque)

    def with_dry_torque(self, size: Expression) -> "String":
        """Add dry friction of this size, >= 0 N m, at the pivot: it resists the swing and holds a load at rest."""
        return replace(self, dry=self.dry + size)

    def with_mass(self, mass: Expression) -> "String":
        """Add mass spread evenly along the string, kg."""
        return replace(self, mass=self.mass + mass)

    def with_compliance(self, compliance: Expression, damping: Expression = ZERO) -> "String":
        """Let the string stretch by `compliance`, m/N, and damp the bounce with a damping ratio."""
        return replace(self, compliance=self.compliance + compliance, damped=self.damped + compliance * damping)


@dataclass(frozen=True)
class Load(Stage):
    """Stage of a pendulum: the load on the string.

    Attributes:
        time: time since the start of the run, s.
        mass: mass, kg.
        position: (3,) of its centre, m.
        velocity: (3,) velocity, m/s.
        angle: swing angle, rad.
        rate: swing rate, rad/s.
        force: (3,) sum of the forces besides weight and string, N.
        inertia: moment of inertia about the load's centre, which turns with the string, kg m^2.
        transverse: (3,) second moments of the swing across the line at the start of the run: angle squared, angle times
            rate, and rate squared.
    """

    time: Expression
    mass: Expression
    position: Expression
    velocity: Expression
    angle: Expression
    rate: Expression
    force: Expression = ZERO_VECTOR
    inertia: Expression = ZERO
    transverse: Expression = ZERO_VECTOR

    @property
    def speed(self) -> Expression:
        """Size of the load's velocity, m/s."""
        return smooth_speed(self.velocity)

    def with_force(self, force: Expression) -> "Load":
        """Add a force on the load, (3,) N."""
        return replace(self, force=self.force + force)

    def with_inertia(self, inertia: Expression) -> "Load":
        """Add a moment of inertia about the load's centre, kg m^2."""
        return replace(self, inertia=self.inertia + inertia)

    def with_transverse(self, square_angle: Expression, product: Expression, square_rate: Expression) -> "Load":
        """Start the load with a swing across the line, by second moments: rad^2, rad^2/s, rad^2/s^2."""
        return replace(self, transverse=self.transverse + ca.vertcat(square_angle, product, square_rate))


@dataclass(frozen=True)
class Tension(Stage):
    """Stage of a pendulum: the tension of the string, which follows from the equations of motion.

    Attributes:
        value: tension, N.
        angle: swing angle, rad.
        rate: swing rate, rad/s.
        mass: mass of the load, kg.
        length: length of the string, m.
        acceleration: acceleration of the gripper along its line, m/s^2.
        gravity: acceleration of free fall, m/s^2.
    """

    value: Expression
    angle: Expression
    rate: Expression
    mass: Expression
    length: Expression
    acceleration: Expression
    gravity: Expression

    def with_value(self, value: Expression) -> "Tension":
        """Replace the formula of the tension, N."""
        return replace(self, value=value)


@dataclass(frozen=True)
class Sensor(Stage):
    """Stage of a pendulum: its sensors, a load cell, an angle sensor and a rate sensor.

    Attributes:
        time: time since the start of the run, s.
        tension: tension of the string, N.
        true_angle: angle of the string, rad.
        force: reading of the load cell, N.
        angle: reading of the angle sensor, rad.
        rate: reading of the rate sensor, rad/s.
        lag: (3,) first-order time constants of the readings of force, angle and rate, s.
        delay: (3,) delays of these readings, s.
    """

    time: Expression
    tension: Expression
    true_angle: Expression
    force: Expression
    angle: Expression
    rate: Expression
    lag: Expression = ZERO_VECTOR
    delay: Expression = ZERO_VECTOR

    def with_lag(self, force: Expression = ZERO, angle: Expression = ZERO, rate: Expression = ZERO) -> "Sensor":
        """Add to the first-order lags, s, of the readings of force, angle and rate."""
        return replace(self, lag=self.lag + ca.vertcat(force, angle, rate))

    def with_delay(self, force: Expression = ZERO, angle: Expression = ZERO, rate: Expression = ZERO) -> "Sensor":
        """Add to the delays, s, of the readings of force, angle and rate."""
        return replace(self, delay=self.delay + ca.vertcat(force, angle, rate))

    def with_force(self, force: Expression) -> "Sensor":
        """Replace the reading of the load cell, N."""
        return replace(self, force=force)

    def with_angle(self, angle: Expression) -> "Sensor":
        """Replace the reading of the angle sensor, rad."""
        return replace(self, angle=angle)

    def with_rate(self, rate: Expression) -> "Sensor":
        """Replace the reading of the rate sensor, rad/s."""
        return replace(self, rate=rate)


def smooth_speed(velocity: Expression) -> Expression:
    """Size of a velocity, m/s, smoothed at rest so that its derivative exists there."""
    return ca.sqrt(ca.sumsqr(velocity) + LOAD_SPEED_ADDED_IN_QUADRATURE**2)
