"""Effects on the joints of an arm (drive, moved link, torque sensor) and on the arm's base.

In the equations q, v and a are the position, velocity and acceleration of a joint, and tau is its drive's torque. Every
joint has parameters of its own, ``"<effect>.<quantity>[<joint>]"``. Units and typical sizes are written for a turning
joint with an effort limit of 50 N m; they are adapted to joints that slide and to stronger or weaker ones.
"""

import casadi as ca
import numpy as np

from armdyn.arm.physics import Base, Expression, Joint
from armdyn.effects.effect import effect
from armdyn.parameter import quantity

TURN = 2 * np.pi
"""A full turn, rad, as the bound of a mounting angle, so that no real mounting is near a bound."""


@effect(
    summary="Friction in proportion to the joint's speed.",
    source="Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, §7.1",
)
def joint_viscous_friction(
    joint: Joint,
    coefficient: Expression = quantity("N m s/rad", typical=2.0, lower=0.0, summary="torque per speed"),
) -> Joint:
    """Torque tau = c v, v the joint's velocity."""
    return joint.with_torque(coefficient * joint.velocity)


@effect(
    summary="Dry friction of constant size against the motion.",
    source="Coulomb 1785; Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30, 1994",
)
def joint_coulomb_friction(
    joint: Joint,
    torque: Expression = quantity("N m", typical=1.0, lower=0.0, summary="size of the friction"),
) -> Joint:
    """Torque tau = f sign(v), v the joint's velocity."""
    return joint.with_torque(torque * joint.direction)


@effect(
    summary="Dry friction of one size in the positive and of another in the negative direction.",
    source="Armstrong-Hélouvry, Control of Machines with Friction, 1991; with f+ = f- it is joint_coulomb_friction",
)
def joint_asymmetric_friction(
    joint: Joint,
    positive: Expression = quantity("N m", typical=1.0, lower=0.0, summary="friction when v > 0"),
    negative: Expression = quantity("N m", typical=1.0, lower=0.0, summary="friction when v < 0"),
) -> Joint:
    """Torque tau = f+ for a velocity v > 0, -f- for v < 0."""
    return joint.with_torque((positive * (1 + joint.direction) - negative * (1 - joint.direction)) / 2)


@effect(
    summary="Additional dry friction near standstill, fading with speed.",
    source="Stribeck 1902; Bo & Pavelescu, Wear 82, 1982",
)
def joint_stribeck_friction(
    joint: Joint,
    torque: Expression = quantity("N m", typical=1.0, lower=0.0, summary="additional friction at standstill"),
    speed: Expression = quantity(
        "rad/s", typical=0.1, null=0.1, lower=0.005, upper=2.0, spread=0.1, summary="speed at which 1/e of it remains"
    ),
) -> Joint:
    """Torque tau = f sign(v) exp(-(v/v_s)^2), v the joint's velocity."""
    return joint.with_torque(torque * joint.direction * ca.exp(-((joint.velocity / speed) ** 2)))


@effect(
    summary="Dry friction in proportion to the torque that the joint transmits.",
    source="Hamon, Gautier & Garrec, Dynamic Identification of Robots with a Dry Friction Model Depending on Load and "
    "Velocity, IROS 2010, without its dependence on speed",
)
def joint_load_friction(
    joint: Joint,
    coefficient: Expression = quantity(
        "1", typical=0.05, lower=0.0, upper=1.0, summary="friction per transmitted torque"
    ),
) -> Joint:
    """Torque tau = mu |tau_load| sign(v), tau_load the torque that moves the links, v the joint's velocity."""
    return joint.with_torque(coefficient * ca.fabs(joint.load) * joint.direction)


@effect(
    summary="The motor's rotor turns with the joint and adds inertia through the gears.",
    source="Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, §7.1: gear ratio squared times the rotor's inertia",
)
def rotor_inertia(
    joint: Joint,
    inertia: Expression = quantity("kg m^2", typical=0.1, lower=0.0, summary="inertia at the joint, after the gears"),
) -> Joint:
    """Torque tau = I a, a the joint's acceleration."""
    return joint.with_torque(inertia * joint.acceleration)


@effect(
    summary="The torque sensor reads a constant too much.",
    source="offset error: JCGM 200 (VIM), §4.20",
)
def torque_offset(
    joint: Joint,
    torque: Expression = quantity("N m", typical=0.5, summary="reading without torque"),
) -> Joint:
    """Measured torque = tau + b, tau the true one."""
    return joint.with_offset(torque)


@effect(
    summary="The torque sensor, or the motor's torque constant, is wrong by a constant share.",
    source="sensitivity error: JCGM 200 (VIM), §4.12",
)
def torque_gain(
    joint: Joint,
    error: Expression = quantity("1", typical=0.05, lower=-0.5, upper=1.0, summary="relative error of the reading"),
) -> Joint:
    """Measured torque = (1 + e) tau, tau the true one."""
    return joint.with_gain(1 + error)


@effect(
    summary="The samples of the torque arrive late by a constant time.",
    source="pure dead time: Åström & Murray, Feedback Systems, 2008, §9.2",
)
def torque_delay(
    joint: Joint,
    time: Expression = quantity("s", typical=0.01, lower=0.0, upper=0.5, summary="delay"),
) -> Joint:
    """Measured torque(t) = tau(t - T), tau the true one."""
    return joint.with_delay(time)


@effect(
    summary="Play between the drive, which reads its own position, and the link, whose position is recorded.",
    source="dead-zone model of a gear without inertia in its gap: Nordin & Gutman, Automatica 38(10), 2002, §2",
    needs=("q_cmd",),
)
def backlash(
    joint: Joint,
    play: Expression = quantity("rad", typical=0.01, lower=0.0, summary="way of the link to either side"),
) -> Joint:
    """Recorded position = q - b sign(load), q the drive's position, load the torque that moves the link."""
    del play  # no torque changes: what is read does, see `armdyn.arm.closed_loop.play`
    return joint


@effect(
    summary="A spring, such as one that carries the arm's weight, adds to the effort of the joint.",
    source="spring of zero free length between link and frame: Herder, Energy-free Systems, TU Delft, 2001",
    reach="turning",
)
def gravity_spring(
    joint: Joint,
    sine: Expression = quantity("N m", typical=10.0, summary="factor of sin q"),
    cosine: Expression = quantity("N m", typical=10.0, summary="factor of cos q"),
) -> Joint:
    """Torque tau = s sin(q) + c cos(q), q the joint's position."""
    return joint.with_torque(sine * ca.sin(joint.position) + cosine * ca.cos(joint.position))


@effect(
    summary="A spring in the joint pulls it back to a position of rest.",
    source="linear spring in a hinge or slide, as MuJoCo's stiffness and springref; a spring of zero free length "
    "between link and frame is gravity_spring",
)
def joint_spring(
    joint: Joint,
    stiffness: Expression = quantity("N m/rad", typical=10.0, lower=0.0, summary="torque per displacement"),
    rest: Expression = quantity("rad", typical=0.5, spread=2.0, summary="position at which it does not pull"),
) -> Joint:
    """Torque tau = k (q - q0), q the joint's position."""
    return joint.with_torque(stiffness * (joint.position - rest))


@effect(
    summary="The joint and its neighbour towards the base share a transmission: each feels the other's motion.",
    source="coupled wrist of the Stäubli TX40: Gautier, Janot & Vandanjon, IEEE T-CST 21(2), 2013",
    reach="coupled",
)
def joint_coupling(
    joint: Joint,
    viscous: Expression = quantity("N m s/rad", typical=0.5, summary="torque on each per speed of the other"),
    inertia: Expression = quantity("kg m^2", typical=0.05, summary="torque on each per acceleration of the other"),
) -> Joint:
    """Torques tau_i = c v_j + I a_j and tau_j = c v_i + I a_i of two joints with velocities v and accelerations a."""
    own = viscous * joint.velocity + inertia * joint.acceleration
    other = viscous * joint.inner.velocity + inertia * joint.inner.acceleration
    return joint.with_torque(other).with_inner_torque(own)


@effect(
    summary="The last link carries a small body that the robot's description does not contain.",
    source="Khalil, Gautier & Lemoine, Identification of the Payload Inertial Parameters of Industrial Manipulators, "
    "ICRA 2007, for a point mass",
    reach="last",
)
def payload(
    joint: Joint,
    mass: Expression = quantity("kg", typical=1.0, lower=0.0, summary="mass of the body"),
    x: Expression = quantity("m", typical=0.1, spread=0.2, summary="position of the body in the last joint's frame"),
    y: Expression = quantity("m", typical=0.1, spread=0.2, summary="position of the body in the last joint's frame"),
    z: Expression = quantity("m", typical=0.1, spread=0.2, summary="position of the body in the last joint's frame"),
) -> Joint:
    """Pseudo-inertia J = J_link + m p p' of the last link, with the mass m at p = (x, y, z, 1)."""
    return joint.with_link(joint.link.with_point_mass(mass, ca.vertcat(x, y, z)))


@effect(
    summary="The body that the last link carries is not a point: it has an inertia about its own centre.",
    source="second moments of mass in the pseudo-inertia: Wensing, Kim & Slotine, IEEE RA-L 3, 2018",
    reach="last",
    needs=("tx", "ty", "tz"),
)
def payload_inertia(
    joint: Joint,
    xx: Expression = quantity("kg m^2", typical=0.02, lower=0.0, summary="mean x^2 about its centre, times its mass"),
    yy: Expression = quantity("kg m^2", typical=0.02, lower=0.0, summary="mean y^2 about its centre, times its mass"),
    zz: Expression = quantity("kg m^2", typical=0.02, lower=0.0, summary="mean z^2 about its centre, times its mass"),
    xy: Expression = quantity("kg m^2", typical=0.01, summary="mean x y about its centre, times its mass"),
    xz: Expression = quantity("kg m^2", typical=0.01, summary="mean x z about its centre, times its mass"),
    yz: Expression = quantity("kg m^2", typical=0.01, summary="mean y z about its centre, times its mass"),
) -> Joint:
    """Pseudo-inertia J = J_link + S of the last link, with the second moments S of the body: I = tr(S) - S."""
    rows = (ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))
    return joint.with_link(joint.link.with_second_moments(ca.vertcat(*rows)))


def _extent(stretch: Expression) -> Expression:
    """1 + s to first order, positive for every s; its square grows like 4 s, so a fit needs few steps."""
    return ca.sqrt(2 * stretch + ca.sqrt(1 + 4 * stretch**2))


@effect(
    summary="The moved link has another mass or mass distribution than described; it stays a possible body.",
    source="Cholesky parameters of the pseudo-inertia, relative to the described one: Rucker & Wensing, IEEE RA-L 7, "
    "2022",
)
def link_inertia(
    joint: Joint,
    mass: Expression = quantity("1", typical=0.3, lower=-7.0, upper=7.0, spread=2.0, summary="log of the mass ratio"),
    stretch_x: Expression = quantity("1", typical=0.3, spread=0.5, summary="growth of the link's extent"),
    stretch_y: Expression = quantity("1", typical=0.3, spread=0.5, summary="growth of the link's extent"),
    stretch_z: Expression = quantity("1", typical=0.3, spread=0.5, summary="growth of the link's extent"),
    shear_xy: Expression = quantity("1", typical=0.3, spread=0.5, summary="shear, in extents of the link"),
    shear_xz: Expression = quantity("1", typical=0.3, spread=0.5, summary="shear, in extents of the link"),
    shear_yz: Expression = quantity("1", typical=0.3, spread=0.5, summary="shear, in extents of the link"),
    shift_x: Expression = quantity("1", typical=0.3, spread=0.5, summary="of the centre of mass, in extents"),
    shift_y: Expression = quantity("1", typical=0.3, spread=0.5, summary="of the centre of mass, in extents"),
    shift_z: Expression = quantity("1", typical=0.3, spread=0.5, summary="of the centre of mass, in extents"),
) -> Joint:
    """Pseudo-inertia J = e^mass U L L' U', J_described = U U', L = [[extent, shear, shift], [0, ..., 1]]."""
    rows = [
        ca.horzcat(_extent(stretch_x), shear_xy, shear_xz, shift_x),
        ca.horzcat(0, _extent(stretch_y), shear_yz, shift_y),
        ca.horzcat(0, 0, _extent(stretch_z), shift_z),
        ca.horzcat(0, 0, 0, 1),
    ]
    return joint.with_link(joint.link.deformed(ca.exp(mass / 2) * ca.vertcat(*rows)))


@effect(
    acts_on="joint",
    summary="The arm's base is not upright: it is inclined, or mounted on a wall or a ceiling.",
    source="gravity in the frame of the base: Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, §7.3.2; a turn "
    "about the vertical changes no torque, which leaves two angles",
    reach="base",
)
def base_tilt(
    base: Base,
    roll: Expression = quantity("rad", typical=0.1, lower=-TURN, upper=TURN, summary="of the base about its x axis"),
    pitch: Expression = quantity("rad", typical=0.1, lower=-TURN, upper=TURN, summary="then about the level y axis"),
) -> Base:
    """Gravity in the base's frame = (R_y(pitch) R_x(roll))' g, for a base mounted with ``rpy="<roll> <pitch> 0"``."""
    return base.turned(roll, pitch)
