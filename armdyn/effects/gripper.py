"""Effects on the motion of the gripper, which carries the upper end of a pendulum's string."""

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.pendulum.physics import Expression, Gripper


@effect(
    summary="The gripper moves farther than measured, by a constant share.",
    source="scale error of a position sensor: JCGM 200 (VIM), §4.31",
    needs=("gripper_x",),
)
def gripper_scale(
    gripper: Gripper,
    error: Expression = quantity("1", typical=0.03, lower=-0.9, upper=5.0, summary="relative error of the measurement"),
) -> Gripper:
    """x_true = (1 + s) x, x the measured position."""
    along, across, up = ca.vertsplit(gripper.position)
    return gripper.with_position(ca.vertcat((1 + error) * along, across, up))


@effect(
    summary="The gripper trails its measured position as a first-order lag.",
    source="first-order lag: Franklin, Powell & Emami-Naeini, Feedback Control of Dynamic Systems, §3.3",
    needs=("gripper_x",),
)
def gripper_lag(
    gripper: Gripper,
    time: Expression = quantity("s", typical=0.02, lower=0.0, upper=1.0, summary="time constant"),
) -> Gripper:
    """First-order lag: tau dx_true/dt + x_true = x, x the measured position."""
    return gripper.with_lag(time)


@effect(
    summary="The gripper is compliant along its line: it moves in proportion to the string's pull.",
    source="joint and link compliance seen at the tool: Siciliano et al., Robotics, 2009, §9.1",
    needs=("gripper_x",),
)
def gripper_compliance(
    gripper: Gripper,
    compliance: Expression = quantity("m/N", typical=5e-3, lower=0.0, upper=0.2, summary="displacement per force"),
) -> Gripper:
    """x_true = x - c T sin(phi), x the measured position, T the string's tension, phi the swing angle."""
    return gripper.with_compliance(compliance)


@effect(
    summary="The gripper rises and falls as it moves: its path is an arc instead of a line.",
    source="second-order term of a path that is not straight: do Carmo, Differential Geometry, §1-5",
    needs=("gripper_x",),
)
def gripper_bob(
    gripper: Gripper,
    curvature: Expression = quantity("1/m", typical=0.5, lower=-20.0, upper=20.0, summary="height = curvature x^2"),
) -> Gripper:
    """Height z = k x^2 of the gripper at the position x along its way."""
    return gripper.with_position(gripper.position + ca.vertcat(0, 0, curvature * gripper.position[0] ** 2))


@effect(
    summary="The line is not level: gravity has a component along it.",
    source="rotation of the frame; Goldstein, Classical Mechanics, 3rd ed., §4.4",
    needs=("gripper_x",),
)
def path_tilt(
    gripper: Gripper,
    angle: Expression = quantity("rad", typical=0.01, lower=-0.7, upper=0.7, summary="gravity leans towards +"),
) -> Gripper:
    """Up = (-sin a, 0, cos a) in the frame of the line, in which the swing angle is measured."""
    return gripper.with_tilt(angle)
