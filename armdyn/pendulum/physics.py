"""The symbolic physics of a load on a string, stage by stage: gripper, string, load, tension, sensor.

Each stage is an immutable bundle of CasADi expressions; an effect takes one and returns a changed one.
Vectors are (3,) in the frame of the line: x along it, y across it, z up. The angle is 0 hanging, and the
load is at x = -l sin(angle): a positive angle puts it on the negative side.
"""

from dataclasses import dataclass, replace

import casadi as ca

from armdyn.physics.definition import NONE, Expression, Stage

__all__ = [
    "STANDARD_GRAVITY", "Expression", "Gripper", "Load", "Sensor", "Stage", "String", "Tension", "smooth_sign",
    "smoothly_resisted", "speed",
]  # fmt: skip

NO_VECTOR: Expression = ca.SX.zeros(3)
STANDARD_GRAVITY = 9.81
"""m/s^2; of a pendulum where nobody says where it stands."""
GRAVITY_SPREAD = 0.02
"""m/s^2; standard deviation of gravity on Earth about that: 9.780 at the equator and 9.832 at the poles, less 0.003 for
every kilometre of height."""
STANDSTILL = 0.02
"""rad/s; where forces must be smooth, dry friction changes its sign over about this swing rate."""
SPEED_FLOOR = 1e-9
"""m/s added in quadrature to the speed, so that its derivative exists at rest."""


def smooth_sign(rate: Expression, width: float) -> Expression:
    """tanh(rate / width): the sign with a transition that has derivatives."""
    return ca.tanh(rate / width)


def smoothly_resisted(torque: Expression, dry: Expression, rate: Expression) -> Expression:
    """A torque less dry friction of size `dry`, N m, where derivatives are needed and a slow creep does no harm."""
    return torque - dry * smooth_sign(rate, STANDSTILL)


@dataclass(frozen=True)
class Gripper(Stage):
    """The string's upper end.

    Attributes:
        time: s since the start of the run.
        x: measured position along the line, m.
        v: its velocity, m/s.
        z: measured height, m.
        angle: swing angle, rad.
        position: (3,) where the string is attached, m.
        lag: first-order time constant with which the real gripper trails the measured one, s.
        compliance: displacement along the line per force, m/N.
        tilt: of the line against the horizontal, rad; positive lets gravity pull towards +.
    """

    time: Expression
    x: Expression
    v: Expression
    z: Expression
    angle: Expression
    position: Expression
    lag: Expression = NONE
    compliance: Expression = NONE
    tilt: Expression = NONE

    def with_position(self, position: Expression) -> "Gripper":
        """Attach the string at another point, (3,) m."""
        return replace(self, position=position)

    def with_lag(self, time_constant: Expression) -> "Gripper":
        """Let the gripper trail its measured position, s."""
        return replace(self, lag=self.lag + time_constant)

    def with_compliance(self, compliance: Expression) -> "Gripper":
        """Let the gripper give way along the line to the string's pull, m/N."""
        return replace(self, compliance=self.compliance + compliance)

    def with_tilt(self, angle: Expression) -> "Gripper":
        """Turn gravity towards the positive end of the line, rad."""
        return replace(self, tilt=self.tilt + angle)


@dataclass(frozen=True)
class String(Stage):
    """What connects gripper and load.

    Attributes:
        time: s since the start of the run.
        angle: rad.
        rate: rad/s.
        load_mass: kg.
        length: pivot to the load's centre, m.
        gravity: of free fall, m/s^2.
        torque: sum of the torques about the pivot that act along the angle, N m.
        dry: sum of the sizes of the dry frictions at the pivot, N m.
        mass: of the string, uniform along its length, kg.
        compliance: by how much it stretches, m/N.
        damped: compliance times the damping of the load's bounce on it over the critical damping, m/N.
    """

    time: Expression
    angle: Expression
    rate: Expression
    load_mass: Expression
    length: Expression
    gravity: Expression
    torque: Expression = NONE
    dry: Expression = NONE
    mass: Expression = NONE
    compliance: Expression = NONE
    damped: Expression = NONE

    @property
    def pull(self) -> Expression:
        """What the pivot carries, N, as if it stood still and the string were rigid: m (g cos phi + l phi'^2)."""
        weight = (self.load_mass + self.mass) * self.gravity * ca.cos(self.angle)
        return weight + (self.load_mass + self.mass / 2) * self.length * self.rate**2

    def with_length(self, length: Expression) -> "String":
        """Another length, m; it may depend on time and angle."""
        return replace(self, length=length)

    def with_torque(self, torque: Expression) -> "String":
        """Add a torque about the pivot, N m."""
        return replace(self, torque=self.torque + torque)

    def with_dry_torque(self, size: Expression) -> "String":
        """Add dry friction at the pivot: a torque of this size, >= 0 N m, against the swing, which holds it at rest."""
        return replace(self, dry=self.dry + size)

    def with_mass(self, mass: Expression) -> "String":
        """Add mass spread evenly along the string, kg."""
        return replace(self, mass=self.mass + mass)

    def with_compliance(self, compliance: Expression, damping: Expression = NONE) -> "String":
        """Let the string stretch in proportion to its tension, m/N, and damp the bounce, over the critical damping."""
        return replace(self, compliance=self.compliance + compliance, damped=self.damped + compliance * damping)


@dataclass(frozen=True)
class Load(Stage):
    """What hangs on the string.

    Attributes:
        time: s since the start of the run.
        mass: kg.
        position: (3,) of its centre, m.
        velocity: (3,) m/s.
        angle: rad.
        rate: rad/s.
        force: (3,) sum of the forces besides weight and string, N.
        inertia: about its own centre, turning with the string, kg m^2.
        transverse: (3,) of the swing across the line at the start of the run: angle squared, angle times rate, rate
            squared.
    """

    time: Expression
    mass: Expression
    position: Expression
    velocity: Expression
    angle: Expression
    rate: Expression
    force: Expression = NO_VECTOR
    inertia: Expression = NONE
    transverse: Expression = NO_VECTOR

    @property
    def speed(self) -> Expression:
        """|velocity|, m/s."""
        return speed(self.velocity)

    def with_force(self, force: Expression) -> "Load":
        """Add a force on the load, (3,) N."""
        return replace(self, force=self.force + force)

    def with_inertia(self, inertia: Expression) -> "Load":
        """Add a moment of inertia about the load's centre, kg m^2."""
        return replace(self, inertia=self.inertia + inertia)

    def with_transverse(self, square_angle: Expression, product: Expression, square_rate: Expression) -> "Load":
        """Start the load with a swing across the line: second moments, rad^2, rad^2/s, rad^2/s^2."""
        return replace(self, transverse=self.transverse + ca.vertcat(square_angle, product, square_rate))


@dataclass(frozen=True)
class Tension(Stage):
    """The string's pull, which follows from the equations of motion.

    Attributes:
        value: N.
        angle: rad.
        rate: rad/s.
        mass: of the load, kg.
        length: of the string, m.
        acceleration: of the gripper along its line, m/s^2.
        gravity: of free fall, m/s^2.
    """

    value: Expression
    angle: Expression
    rate: Expression
    mass: Expression
    length: Expression
    acceleration: Expression
    gravity: Expression

    def with_value(self, value: Expression) -> "Tension":
        """Another formula, N."""
        return replace(self, value=value)


@dataclass(frozen=True)
class Sensor(Stage):
    """What is measured.

    Attributes:
        time: s since the start of the run.
        tension: of the string, N.
        true_angle: of the string, rad.
        force: reading of the load cell, N.
        angle: reading of the angle sensor, rad.
        rate: reading of the rate sensor, rad/s.
        lag: (3,) first-order time constants of the readings of force, angle and rate, s.
        delay: (3,) how late these are, s.
    """

    time: Expression
    tension: Expression
    true_angle: Expression
    force: Expression
    angle: Expression
    rate: Expression
    lag: Expression = NO_VECTOR
    delay: Expression = NO_VECTOR

    def with_lag(self, force: Expression = NONE, angle: Expression = NONE, rate: Expression = NONE) -> "Sensor":
        """Let the readings of force, angle and rate pass a first-order lag each, s."""
        return replace(self, lag=self.lag + ca.vertcat(force, angle, rate))

    def with_delay(self, force: Expression = NONE, angle: Expression = NONE, rate: Expression = NONE) -> "Sensor":
        """Let the readings of force, angle and rate arrive late, s."""
        return replace(self, delay=self.delay + ca.vertcat(force, angle, rate))

    def with_force(self, force: Expression) -> "Sensor":
        """Let the load cell read `force`, N."""
        return replace(self, force=force)

    def with_angle(self, angle: Expression) -> "Sensor":
        """Let the angle sensor read `angle`, rad."""
        return replace(self, angle=angle)

    def with_rate(self, rate: Expression) -> "Sensor":
        """Let the rate sensor read `rate`, rad/s."""
        return replace(self, rate=rate)


def speed(velocity: Expression) -> Expression:
    """|velocity| with a derivative at rest, m/s."""
    return ca.sqrt(ca.sumsqr(velocity) + SPEED_FLOOR**2)
