"""The stages of an arm on which effects act: its base and each joint, as symbolic expressions.

Each stage is an immutable bundle of CasADi expressions, scalar unless a shape is given. Units are those of a joint that
turns; a joint that slides has N for N m, m for rad and kg for kg m^2.
"""

from dataclasses import dataclass, field, replace

import casadi as ca

from armdyn.physics.definition import ZERO, Expression, SensorStage

__all__ = ["Base", "DriveCommands", "Expression", "Joint", "Link", "Neighbour", "Wrench"]

ONE: Expression = ca.SX(1)


@dataclass(frozen=True)
class Link:
    """Stage of an arm: the link that a joint moves, as a distribution of mass.

    Its pseudo-inertia is J = sum_i m_i p_i p_i' over its particles, with p = (x, y, z, 1) in the frame of the joint. It
    contains the ten inertial parameters, and is positive definite exactly if a body with them can exist (Wensing, Kim &
    Slotine, IEEE RA-L 3, 2018).

    Attributes:
        shape: (4, 4) upper triangular U with J = U U' of the link itself, kg^1/2 m and kg^1/2.
        carried: (4, 4) pseudo-inertia of bodies that are fixed to it, kg m^2, kg m and kg.
    """

    shape: Expression
    carried: Expression

    @property
    def pseudo_inertia(self) -> Expression:
        """(4, 4) pseudo-inertia J of the link with the fixed bodies."""
        return self.shape @ self.shape.T + self.carried

    def deformed(self, deformation: Expression) -> "Link":
        """The link with its mass moved by an affine map (4, 4), upper triangular; it stays physically possible.

        The map acts in the coordinates in which the link's pseudo-inertia is the identity; see `armdyn.arm.rigid`.
        """
        return replace(self, shape=self.shape @ deformation)

    def with_second_moments(self, moments: Expression) -> "Link":
        """Add the second moments (3, 3), kg m^2, that the mass of fixed bodies has about their own centres."""
        return replace(self, carried=self.carried + ca.diagcat(moments, 0))

    def with_point_mass(self, mass: Expression, position: Expression) -> "Link":
        """Fix a mass, kg, to the point (3,) m in the frame of the joint."""
        point = ca.vertcat(position, 1)
        return replace(self, carried=self.carried + mass * point @ point.T)


@dataclass(frozen=True)
class Base:
    """Stage of an arm: its base.

    Attributes:
        gravity: (3,) acceleration of free fall in the frame of the base, m/s^2.
    """

    gravity: Expression

    def turned(self, roll: Expression, pitch: Expression) -> "Base":
        """Turn the base about its x axis and then about the world's y axis, rad, as ``rpy="<roll> <pitch> 0"`` does."""
        x, y, z = ca.vertsplit(self.gravity)
        # R' g with R = R_y(pitch) R_x(roll): first the inverse of the pitch, then that of the roll.
        x, z = ca.cos(pitch) * x - ca.sin(pitch) * z, ca.sin(pitch) * x + ca.cos(pitch) * z
        y, z = ca.cos(roll) * y + ca.sin(roll) * z, ca.cos(roll) * z - ca.sin(roll) * y
        return replace(self, gravity=ca.vertcat(x, y, z))


@dataclass(frozen=True)
class Neighbour:
    """Motion of the next joint towards the base: position, rad, velocity, rad/s, and acceleration, rad/s^2."""

    position: Expression
    velocity: Expression
    acceleration: Expression


@dataclass(frozen=True)
class DriveCommands:
    """Commands of a servo drive; 0 for a joint whose torque was measured.

    Attributes:
        torque: torque by the drive's control law, within its limit and while it is on, N m.
        rate: time derivative of this torque by the command alone, N m/s.
        total: integral of this torque since the start of the run, N m s.
        velocity: commanded velocity, rad/s.
        voltage: relative excess of the supply voltage over that of the gain.
    """

    torque: Expression = ZERO
    rate: Expression = ZERO
    total: Expression = ZERO
    velocity: Expression = ZERO
    voltage: Expression = ZERO


@dataclass(frozen=True)
class Joint(SensorStage):
    """Stage of an arm: one joint with its drive and its torque sensor.

    Attributes:
        time: time since the start of the run, s.
        position: position, rad.
        velocity: velocity, rad/s.
        acceleration: acceleration, rad/s^2.
        direction: expected sign of the velocity, -1 to 1.
        load: torque that the rigid bodies need, N m.
        inner: the next joint towards the base.
        link: the link that the joint moves.
        torque: torque of the drive beyond `load`, N m.
        inner_torque: further torque of the drive of the `inner` joint, N m.
        gain: reading of the torque sensor, or torque by the drive's law, per torque of the drive.
        offset: reading of the sensor without torque, N m.
        on: 1 while the drive is on, 0 while its windings are open.
        told: commands of the drive.
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
    told: DriveCommands = field(default_factory=DriveCommands)

    def with_torque(self, torque: Expression) -> "Joint":
        """Add a torque, N m, to that of the drive; friction against a positive velocity is positive."""
        return replace(self, torque=self.torque + torque)

    def with_inner_torque(self, torque: Expression) -> "Joint":
        """Add a torque, N m, to that of the drive of the next joint towards the base."""
        return replace(self, inner_torque=self.inner_torque + torque)

    def with_link(self, link: Link) -> "Joint":
        """Replace the link that the joint moves."""
        return replace(self, link=link)

    def with_gain(self, gain: Expression) -> "Joint":
        """Multiply the reading of the torque sensor by `gain`, which depends on parameters only."""
        return replace(self, gain=self.gain * gain)

    def with_offset(self, offset: Expression) -> "Joint":
        """Add an offset, N m, to the reading of the torque sensor, or to the torque by the drive's control law."""
        return replace(self, offset=self.offset + offset)


@dataclass(frozen=True)
class Wrench:
    """Stage of an arm: the wrench on a force/torque sensor, as the sensor reads it, in the axes of its frame.

    Attributes:
        time: time since the start of the run, s.
        axes: (3, 3) rotation from the base's frame to that of the sensor.
        position: (3,) position of the sensor in the base's frame, m.
        force: (3,) force on the sensor, N.
        torque: (3,) torque on the sensor about the origin of its frame, N m.
        delay: delay of the reading, s.
    """

    time: Expression
    axes: Expression
    position: Expression
    force: Expression
    torque: Expression
    delay: Expression = ZERO

    def with_wrench(self, force: Expression, torque: Expression) -> "Wrench":
        """Add a force (3,), N, and a torque (3,), N m, in the axes of the sensor."""
        return replace(self, force=self.force + force, torque=self.torque + torque)

    def mixed(self, matrix: Expression) -> "Wrench":
        """Multiply force and torque, in this order, by a matrix (6, 6)."""
        force, torque = ca.vertsplit(matrix @ ca.vertcat(self.force, self.torque), 3)
        return replace(self, force=force, torque=torque)

    def with_delay(self, time: Expression) -> "Wrench":
        """Add `time`, s, which depends on parameters only, to the delay of the reading."""
        return replace(self, delay=self.delay + time)
