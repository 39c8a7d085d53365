"""Effects of servo drives (`[drives]` of a model file), with parameters of their own for every joint.

The table of a drive in a model file gives its control law (gain, supply, limit, delay and rate), from which the torque
R follows. The effects describe how the actual torque tau of a joint differs from R. Typical sizes are written for an
effort limit of 50 N m; see `joint`.
"""

import casadi as ca

from armdyn.arm.physics import Expression, Joint
from armdyn.effects.effect import effect
from armdyn.parameter import quantity


@effect(
    acts_on="drive",
    summary="The gain of a joint's drive differs from the gain of its group of drives by a constant factor.",
    source="sensitivity error: JCGM 200 (VIM), §4.12, of the servo as a torque sensor",
)
def servo_gain(
    joint: Joint,
    error: Expression = quantity("1", typical=0.05, lower=-0.5, upper=1.0, summary="relative error of the gain"),
) -> Joint:
    """Torque from the drive's control law R = (1 + e) tau, tau the actual torque."""
    return joint.with_gain(1 + error)


@effect(
    acts_on="drive",
    summary="A position servo gives a torque in proportion to the error of the commanded velocity.",
    source="proportional-derivative control: Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, §8.5.1; of one "
    "without a velocity command it is joint_viscous_friction",
    needs=("v_cmd",),
)
def servo_damping(
    joint: Joint,
    coefficient: Expression = quantity("N m s/rad", typical=2.0, lower=0.0, summary="torque per velocity error"),
) -> Joint:
    """Torque tau = R + d (v_cmd - v) while the drive is on, R from its control law, v_cmd the commanded velocity."""
    return joint.with_offset(coefficient * (joint.velocity - joint.told.velocity) * joint.on)


@effect(
    acts_on="drive",
    summary="The drive integrates its error over time, and gives torque in proportion to the integral.",
    source="integral action: Åström & Murray, Feedback Systems, 2008, §10.1; the sum is none when a recording begins",
)
def servo_integral(
    joint: Joint,
    rate: Expression = quantity("1/s", typical=0.5, lower=0.0, upper=50.0, summary="integral over proportional gain"),
) -> Joint:
    """Torque tau = R + r int R dt, R from the drive's control law."""
    return joint.with_offset(-rate * joint.told.total)


@effect(
    acts_on="drive",
    summary="While the drive is on, its motor brakes in proportion to the speed; with open windings it does not.",
    source="k_t^2/R behind the gears: Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, §5.2.1; while the drive "
    "is always on, it is joint_viscous_friction",
    needs=("enabled",),
)
def back_emf(
    joint: Joint,
    coefficient: Expression = quantity("N m s/rad", typical=2.0, lower=0.0, summary="torque per speed"),
) -> Joint:
    """Torque tau = c v while the drive is on."""
    return joint.with_torque(coefficient * joint.velocity * joint.on)


@effect(
    acts_on="drive",
    summary="A command of a joint acts later than those of the other joints in its group of drives.",
    source="pure dead time: Åström & Murray, Feedback Systems, 2008, §9.2; in what is read to first order, in motion "
    "whole",
)
def command_delay(
    joint: Joint,
    time: Expression = quantity("s", typical=0.005, lower=-0.05, upper=0.2, summary="additional delay"),
) -> Joint:
    """Torque tau = R - T dR/dt, R from the drive's control law, dR/dt its change by the command alone."""
    return joint.with_offset(time * joint.told.rate)


@effect(
    acts_on="drive",
    summary="The torque of a drive depends on the voltage of its supply.",
    source="a duty cycle is a share of the supply: Mohan, Undeland & Robbins, Power Electronics, 2003, §7.7; with "
    "[drives] supply it follows wholly",
    needs=("voltage",),
)
def supply_voltage(
    joint: Joint,
    share: Expression = quantity("1", typical=0.5, lower=-2.0, upper=2.0, summary="1: in proportion to the voltage"),
) -> Joint:
    """Torque tau = R (1 + s (V/V_0 - 1)), R from the drive's control law at the supply voltage V_0."""
    return joint.with_offset(-share * joint.told.voltage * joint.told.torque)


@effect(
    acts_on="drive",
    summary="Above some torque a drive gives less torque than its control law demands.",
    source="saturation: Khalil, Nonlinear Systems, 2002, §1.2.7",
)
def torque_limit(
    joint: Joint,
    lost: Expression = quantity(
        "1", typical=0.5, lower=0.0, upper=1.0, summary="share of the torque above the limit that is lost"
    ),
    torque: Expression = quantity(
        "N m", typical=50.0, null=50.0, lower=0.1, upper=50.0, spread=25.0, summary="limit above which torque is lost"
    ),
) -> Joint:
    """Torque tau = R - l (R - clip(R, +-L)), R from the drive's control law."""
    asked = joint.told.torque
    return joint.with_offset(lost * (asked - ca.fmax(-torque, ca.fmin(torque, asked))))


@effect(
    acts_on="drive",
    summary="A small error gives no torque: the drive has a dead zone around its command.",
    source="dead zone: Khalil, Nonlinear Systems, 2002, §1.2.7",
)
def dead_band(
    joint: Joint,
    torque: Expression = quantity("N m", typical=1.0, lower=0.0, summary="largest demanded torque that has no effect"),
) -> Joint:
    """Torque tau = R - clip(R, +-B), R from the drive's control law."""
    asked = joint.told.torque
    return joint.with_offset(ca.fmax(-torque, ca.fmin(torque, asked)))


@effect(
    acts_on="drive",
    summary="The smallest error already gives a torque that starts the motor.",
    source="against friction, as registers of hobby servos set it: Armstrong-Hélouvry, Dupont & Canudas de Wit, "
    "Automatica 30, 1994, §4.3",
)
def starting_duty(
    joint: Joint,
    torque: Expression = quantity("N m", typical=1.0, lower=0.0, summary="torque in addition to the demanded one"),
) -> Joint:
    """Torque tau = R + S sign(R), R from the drive's control law."""
    return joint.with_offset(-torque * ca.sign(joint.told.torque))
