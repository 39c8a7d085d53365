r"""An arm with its effects as CasADi functions of one instant, for simulations and exports.

The torques of the rigid bodies are those of the recursive Newton-Euler algorithm (Featherstone, Rigid Body Dynamics
Algorithms, 2008, table 5.1) in the coordinates of each link, with the inertial parameters and the gravity of the
effects; other effects add to the drives' torques. Gain and offset of a drive's reading are functions of their own.
"""

from collections.abc import Sequence
from dataclasses import fields

import casadi as ca
import numpy as np
import pinocchio as pin

from armdyn.arm.composition import composed_joint
from armdyn.arm.control_laws import DriveSignals
from armdyn.arm.model import ArmModel
from armdyn.arm.physics import DriveCommands, Expression
from armdyn.arm.rigid import joint_axes, parent_joints
from armdyn.arm.slots import slots_of
from armdyn.errors import InputError


def inverse_dynamics_function(model: ArmModel) -> ca.Function:
    """``(q, v, a) -> tau``, (n,) each: the drives' torques, N m or N, at the model's parameters.

    Raises:
        InputError: an effect depends on time or has states of its own.
    """
    q, v, a, torques, _ = _torques(model)
    return ca.Function("inverse_dynamics", [q, v, a], [torques], ["q", "v", "a"], ["tau"])


def gravity_compensation_function(model: ArmModel) -> ca.Function:
    """``(q, v) -> (gravity, friction)``, (n,) each: torques at rest with loads and springs, and those of a speed.

    Torques at rest are midway between the frictions of both directions. Friction in proportion to the load is that of
    the load at rest. Centrifugal and Coriolis torques are in neither.

    Raises:
        InputError: an effect depends on time or has states of its own.
    """
    n = len(model.arm.joints)
    q, v, none = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.zeros(n)
    links = [ca.SX(link) for link in model.link_parameters().values()]
    load = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, none, none)
    moving, still = (
        torques_added_by_effects(model, (q, u, none), ca.sign(u), load, ca.SX.ones(n), ca.SX(model.theta()))[0]
        for u in (v, none)
    )
    found = ca.cse([ca.densify(load + still), ca.densify(moving - still)])
    return ca.Function("gravity_compensation", [q, v], found, ["q", "v"], ["gravity", "friction"])


def drive_command_function(model: ArmModel) -> ca.Function:
    """``(q, v, a) -> command``, (n,) each: commands and readings of the drives for the torques of a motion.

    Raises:
        InputError: an effect depends on time or has states of its own.
    """
    q, v, a, torques, readings = _torques(model)
    gains, offsets = (ca.vertcat(*column) for column in zip(*readings, strict=True))
    command = ca.densify(gains * torques + offsets)
    return ca.Function("drive_command", [q, v, a], [command], ["q", "v", "a"], ["command"])


def servo_torque_function(model: ArmModel) -> ca.Function:
    """``(q, v, q_cmd, v_cmd) -> tau``, (n,) each: torques of servos without delay; 0 for joints without one.

    The torque is (R - offset) / gain, with R by the law of the servo.
    """
    joints = model.arm.joints
    q, v, q_cmd, v_cmd = (ca.SX.sym(name, len(joints)) for name in ("q", "v", "q_cmd", "v_cmd"))
    asked, driven = [ca.SX(0)] * len(joints), ca.DM.zeros(len(joints))
    for i, joint in enumerate(joints):
        servo, commands = model.servo(joint), {"q_cmd": q_cmd[i], "v_cmd": v_cmd[i]}
        if servo is None or servo.gain is None or servo.control.channel not in commands:
            continue
        driven[i] = 1
        command, own = commands[servo.control.channel], (servo.gain.value, servo.damping)
        signals = DriveSignals(0.0, command, v_cmd[i], servo.largest, 1.0, *own)
        asked[i] = servo.control.torque(signals, q[i], v[i])
    told = [DriveCommands(R, velocity=v_cmd[i]) for i, R in enumerate(asked)]
    none, on, theta = ca.SX.zeros(len(joints)), ca.SX.ones(len(joints)), ca.SX(model.theta())
    _, gain, offset = torques_added_by_effects(model, (q, v, none), ca.sign(v), none, on, theta, told)
    tau = driven * (ca.vertcat(*asked) - offset) / gain
    names = ["q", "v", "q_cmd", "v_cmd"], ["tau"]
    return ca.Function("servo_torque", [q, v, q_cmd, v_cmd], [ca.densify(tau)], *names)


def drive_reading_gains_and_offsets(model: ArmModel) -> list[tuple[float, float]]:
    """Gain and offset, N m or N, of each drive's command or reading."""
    present = {effect.name for effect in model.effects if slots_of(effect).scales_reading}
    return [(float(gain), float(offset)) for gain, offset in _torques(model.with_only_effects(present))[-1]]


def _torques(
    model: ArmModel,
) -> tuple[Expression, Expression, Expression, Expression, list[tuple[Expression, Expression]]]:
    """Symbols of position, velocity and acceleration, the drives' torques, and gain and offset of each reading."""
    n = len(model.arm.joints)
    q, v, a = (ca.SX.sym(name, n) for name in ("q", "v", "a"))
    links = [ca.SX(link) for link in model.link_parameters().values()]
    load = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, v, a)
    tau, gains, offsets = torques_added_by_effects(
        model, (q, v, a), ca.sign(v), load, ca.SX.ones(n), ca.SX(model.theta())
    )
    readings = list(zip(ca.vertsplit(gains), ca.vertsplit(offsets), strict=True))
    return q, v, a, ca.densify(load + tau), readings


def torques_added_by_effects(
    model: ArmModel,
    motion: tuple[Expression, Expression, Expression],
    direction: Expression,
    load: Expression,
    on: Expression,
    theta: Expression,
    told: Sequence[DriveCommands] = (),
) -> tuple[Expression, Expression, Expression]:
    """(n,) torques that effects add to those of the drives, and (n,) gains and offsets of the torque readings.

    Args:
        model: the arm; its parameter values are not used.
        motion: (n,) positions, velocities and accelerations.
        direction: (n,) signs of the velocities.
        load: (n,) torques of the rigid bodies.
        on: (n,) 1 where the drive is on, 0 where it is off.
        theta: (p,) parameters of the model.
        told: commands of each joint's drive; empty for none.

    Raises:
        InputError: an effect depends on time or has states of its own.
    """
    n, inward = len(model.arm.joints), parent_joints(model.arm.model)
    torque, gain, offset = [ca.SX(0)] * n, [], []
    for i, (name, inner) in enumerate(zip(model.arm.joints, inward, strict=True)):
        effects = [e.on() for e in model.effects if name in model.joints_having_effect(e.name)]
        for effect in effects:
            if why := composed_joint((effect,)).needs_more_than_an_instant:
                raise InputError(
                    f"effect '{effect.name}' {why}, which a function of one instant lacks: export the model without it"
                )
        joint, neighbour = composed_joint(tuple(effects)), [part[inner] if inner >= 0 else 0 for part in motion]
        own = [part[i] for part in (*motion, direction, load)]
        command = told[i] if told else DriveCommands()
        given = [0, *own, *neighbour, on[i], *(getattr(command, part.name) for part in fields(DriveCommands))]
        values = [theta[model.names.index(f"{quantity}[{name}]")] for quantity in joint.names]
        own_torque, inner_torque, own_gain, own_offset = joint.torques(ca.vertcat(*given), ca.vertcat(*values))
        torque[i] += own_torque
        if inner >= 0:
            torque[inner] += inner_torque
        gain.append(own_gain)
        offset.append(own_offset)
    return ca.vertcat(*torque), ca.vertcat(*gain), ca.vertcat(*offset)


def rigid_torques(
    arm: pin.Model, links: Sequence[Expression], gravity: Expression, q: Expression, v: Expression, a: Expression
) -> Expression:
    """(n,) torques of the rigid bodies in a motion with (n,) positions q, velocities v and accelerations a.

    Args:
        arm: placements and axes of the joints.
        links: (10,) inertial parameters of each joint's link.
        gravity: (3,) gravity in the frame of the base, m/s^2.
        q: (n,) rad or m.
        v: (n,) per s.
        a: (n,) per s^2.
    """
    inner = parent_joints(arm)
    axes = joint_axes(arm)
    rotations: list[tuple[Expression, Expression]] = []
    moves: list[tuple[Expression, Expression, Expression]] = []
    forces: list[tuple[Expression, Expression]] = []
    for i, axis in enumerate(axes):
        linear, angular = axis[:3], axis[3:]
        R, p = joint_placement(arm, i, axis, q[i])
        w, dw, acceleration = (ca.SX(3, 1), ca.SX(3, 1), -gravity) if inner[i] < 0 else moves[inner[i]]
        # Acceleration of the link's origin minus gravity, then everything in the link's own axes.
        acceleration = acceleration + ca.cross(dw, p) + ca.cross(w, ca.cross(w, p))
        w, dw, acceleration = R.T @ w, R.T @ dw, R.T @ acceleration
        slide, turn = ca.SX(linear), ca.SX(angular)
        acceleration = acceleration + slide * a[i] + 2 * ca.cross(w, slide * v[i])
        dw = dw + turn * a[i] + ca.cross(w, turn * v[i])
        w = w + turn * v[i]
        m, h, inertia = links[i][0], links[i][1:4], _inertia_matrix(links[i])
        force = m * acceleration + ca.cross(dw, h) + ca.cross(w, ca.cross(w, h))
        moment = inertia @ dw + ca.cross(w, inertia @ w) + ca.cross(h, acceleration)
        rotations.append((R, p))
        moves.append((w, dw, acceleration))
        forces.append((force, moment))
    tau = [ca.SX(0)] * len(axes)
    for i in reversed(range(len(axes))):
        force, moment = forces[i]
        tau[i] = ca.dot(ca.SX(axes[i][:3]), force) + ca.dot(ca.SX(axes[i][3:]), moment)
        if inner[i] >= 0:
            R, p = rotations[i]
            outer, (inner_force, inner_moment) = R @ force, forces[inner[i]]
            forces[inner[i]] = inner_force + outer, inner_moment + R @ moment + ca.cross(p, outer)
    return ca.vertcat(*tau)


def joint_placement(
    arm: pin.Model, joint: int, axis: np.ndarray, position: Expression
) -> tuple[Expression, Expression]:
    """(3, 3) rotation to the link before a joint from the joint's link, and (3,) origin of the latter in the former, m.

    Args:
        arm: placements of the joints.
        joint: index of the joint.
        axis: (6,) its linear and angular axis, see `joint_axes`.
        position: of the joint, rad or m.
    """
    placement = arm.jointPlacements[joint + 1]
    rotation = np.asarray(placement.rotation)
    R = ca.SX(rotation) @ _turned(axis[3:], position)
    return R, ca.SX(placement.translation) + ca.SX(rotation @ axis[:3]) * position


def _inertia_matrix(link: Expression) -> Expression:
    """(3, 3) about the origin of (10,) inertial parameters; see `rigid.inertia_matrix`."""
    xx, xy, yy, xz, yz, zz = ca.vertsplit(link[4:])
    return ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))


def _turned(axis: np.ndarray, angle: Expression) -> Expression:
    """(3, 3) rotation by an angle about a unit axis; the identity where the axis is zero (Rodrigues)."""
    if not np.any(axis):
        return ca.SX.eye(3)
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return ca.SX.eye(3) + ca.sin(angle) * ca.SX(K) + (1 - ca.cos(angle)) * ca.SX(K @ K)
