"""The symbolic physics of an arm's base and of one joint, as effects read and change them.

Each stage is an immutable bundle of CasADi expressions, scalar unless a shape is given. Units are written for a joint
that turns; one that slides has N for N m, m for rad and kg for kg m^2.
"""

from dataclasses import dataclass, field, replace

import casadi as ca

from armdyn.physics.definition import ZERO, Expression, Timed

__all__ = ["Base", "Expression", "Joint", "Link", "Neighbour", "Told"]

ONE: Expression = ca.SX(1)


@dataclass(frozen=True)
class Link:
    """The link that a joint moves, as a distribution of mass.

    Its pseudo-inertia is J = sum_i m_i p_i p_i' over its particles, p = (x, y, z, 1) in the frame of the joint: it
    holds the ten inertial parameters, and is positive definite exactly when some body has them (Wensing, Kim & Slotine,
    IEEE RA-L 3, 2018).

    Attributes:
        shape: (4, 4) upper triangular U, J = U U' of the link itself, kg^1/2 m and kg^1/2.
        carried: (4, 4) pseudo-inertia of what is fixed to it, kg m^2, kg m and kg.
    """

    shape: Expression
    carried: Expression

    @property
    def pseudo_inertia(self) -> Expression:
        """(4, 4) J."""
        return self.shape @ self.shape.T + self.carried

    def deformed(self, deformation: Expression) -> "Link":
        """Deform the link by an upper triangular affine map (4, 4), in the frame in which J is the identity."""
        return replace(self, shape=self.shape @ deformation)

    def with_point_mass(self, mass: Expression, position: Expression) -> "Link":
        """Fix a mass, kg, to the point (3,) m in the frame of the joint."""
        point = ca.vertcat(position, 1)
        return replace(self, carried=self.carried + mass * point @ point.T)


@dataclass(frozen=True)
class Base:
    """What carries the whole arm.

    Attributes:
        gravity: (3,) acceleration of free fall in the frame of the base, m/s^2.
    """

    gravity: Expression

    def turned(self, roll: Expression, pitch: Expression) -> "Base":
        """Turn the base about its x axis and then about the world's y axis, rad, as ``rpy="<roll> <pitch> 0"`` does."""
        x, y, z = ca.vertsplit(self.gravity)
        # R' g with R = R_y(pitch) R_x(roll): first the pitch is undone, then the roll.
        x, z = ca.cos(pitch) * x - ca.sin(pitch) * z, ca.sin(pitch) * x + ca.cos(pitch) * z
        y, z = ca.cos(roll) * y + ca.sin(roll) * z, ca.cos(roll) * z - ca.sin(roll) * y
        return replace(self, gravity=ca.vertcat(x, y, z))


@dataclass(frozen=True)
class Neighbour:
    """The next joint towards the base.

    Attributes:
        position: rad.
        velocity: rad/s.
        acceleration: rad/s^2.
    """

    position: Expression
    velocity: Expression
    acceleration: Expression


@dataclass(frozen=True)
class Told:
    """What a drive was told; nothing, 0, of one whose torque was measured.

    Attributes:
        torque: that its law asks for, within its limit and while it is on, N m.
        rate: of that, by the command alone, N m/s: what a command that acts later asks for less, per time.
        total: of that since the run's start, N m s.
        velocity: that it was told, rad/s.
        voltage: of its supply over the one at which its gain holds, less one.
    """

    torque: Expression = ZERO
    rate: Expression = ZERO
    total: Expression = ZERO
    velocity: Expression = ZERO
    voltage: Expression = ZERO


@dataclass(frozen=True)
class Joint(Timed):
    """One joint, its drive and its torque sensor.

    Attributes:
        time: s since the start of the run.
        position: rad.
        velocity: rad/s.
        acceleration: rad/s^2.
        direction: sign of the velocity, its expected value where the velocity is uncertain, -1 to 1.
        load: torque that the rigid bodies ask of the joint, N m.
        inner: the next joint towards the base.
        link: the link that the joint moves.
        torque: what the drive gives beyond `load`, N m.
        inner_torque: what the inner neighbour's drive gives beyond its own, N m.
        gain: the sensor's reading per torque; what a drive asks for, per torque that it gives.
        offset: its reading without torque, N m.
        on: 1 while the drive is on, 0 while its windings are open.
        told: what the drive was told.
    """

    time: Expression
    position: Expression
    velocity: Expression
    acceleration: Expression
    direction: Expression
    load: Expression
    inner: Neighbour
    link: Link
    torque: Expression = ZERO
    inner_torque: Expression = ZERO
    gain: Expression = ONE
    offset: Expression = ZERO
    on: Expression = ONE
    told: Told = field(default_factory=Told)

    def with_torque(self, torque: Expression) -> "Joint":
        """Let the drive give this much more, N m: positive where friction opposes a positive velocity."""
        return replace(self, torque=self.torque + torque)

    def with_inner_torque(self, torque: Expression) -> "Joint":
        """Let the inner neighbour's drive give this much more, N m."""
        return replace(self, inner_torque=self.inner_torque + torque)

    def with_link(self, link: Link) -> "Joint":
        """Move another link."""
        return replace(self, link=link)

    def with_gain(self, gain: Expression) -> "Joint":
        """Multiply the sensor's reading; `gain` depends on parameters only."""
        return replace(self, gain=self.gain * gain)

    def with_offset(self, offset: Expression) -> "Joint":
        """Add to the sensor's reading, N m, or to what a drive asks for beyond the torque that it gives."""
        return replace(self, offset=self.offset + offset)
