r"""An arm with its effects as one CasADi function: the torques of a motion, for other tools.

The rigid bodies by the recursive Newton-Euler algorithm (Featherstone, Rigid Body Dynamics Algorithms, 2008, table 5.1)
in the coordinates of each link, with the inertial parameters and the gravity that the effects leave; then what the
effects add to the drives. Gain and offset of a drive's torque are no part of that: they stand between the torque and
what the drive is told, and says itself, which is a function of its own.
"""

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin

from armdyn.arm.model import ArmModel
from armdyn.arm.physics import Expression, Joint, Link, Neighbour, Told
from armdyn.arm.rigid import joint_axes, parents
from armdyn.errors import InputError

DRIVE = frozenset({"torque_offset", "torque_gain", "servo_gain"})
"""Effects between a drive's torque and what it is told and reads, whatever that is."""


_Reading = tuple[Expression, Expression]
"""Gain and offset."""


def inverse_dynamics_function(model: ArmModel) -> ca.Function:
    """``(q, v, a) -> tau``, (n,) each: what the drives give, N m or N, at the model's parameters.

    Raises:
        InputError: an effect depends on time or has states of its own, which no function of one instant has.
    """
    q, v, a, torques, _ = _torques(model)
    return ca.Function("inverse_dynamics", [q, v, a], [torques], ["q", "v", "a"], ["tau"])


def drive_command_function(model: ArmModel) -> ca.Function:
    """``(q, v, a) -> command``, (n,) each: what drives are told, and read themselves, while they give these torques.

    Raises:
        InputError: as `inverse_dynamics_function`.
    """
    q, v, a, torques, readings = _torques(model)
    gains, offsets = (ca.vertcat(*column) for column in zip(*readings, strict=True))
    command = ca.densify(gains * torques + offsets)
    return ca.Function("drive_command", [q, v, a], [command], ["q", "v", "a"], ["command"])


def servo_torque_function(model: ArmModel) -> ca.Function:
    """``(q, v, q_cmd, v_cmd) -> tau``, (n,) each: what servos give, on and in time; 0 of joints without one.

    The torque is (R - offset) / gain with R = clip(k (q_cmd - q) + d (v_cmd - v), +-limit), see `Servo`.
    """
    joints = model.arm.joints
    q, v, q_cmd, v_cmd = (ca.SX.sym(name, len(joints)) for name in ("q", "v", "q_cmd", "v_cmd"))
    asked, driven = [ca.SX(0)] * len(joints), ca.DM.zeros(len(joints))
    for i, joint in enumerate(joints):
        servo = model.servo(joint)
        if servo is None or servo.gain is None or servo.law not in ("position", "velocity"):
            continue
        k, d = (servo.gain.value, servo.damping) if servo.law == "position" else (0.0, servo.gain.value)
        driven[i] = 1
        asked[i] = k * (q_cmd[i] - q[i]) + d * (v_cmd[i] - v[i])
        if np.isfinite(servo.largest):
            asked[i] = ca.fmax(-servo.largest, ca.fmin(servo.largest, asked[i]))
    told = [Told(R, velocity=v_cmd[i]) for i, R in enumerate(asked)]
    none, on, theta = ca.SX.zeros(len(joints)), ca.SX.ones(len(joints)), ca.SX(model.theta())
    _, gain, offset = added_torques(model, (q, v, none), ca.sign(v), none, on, theta, told)
    tau = driven * (ca.vertcat(*asked) - offset) / gain
    names = ["q", "v", "q_cmd", "v_cmd"], ["tau"]
    return ca.Function("servo_torque", [q, v, q_cmd, v_cmd], [ca.densify(tau)], *names)


def drive_readings(model: ArmModel) -> list[tuple[float, float]]:
    """For every joint what its drive is told, or reads, per torque, and without torque, N m or N."""
    present = {effect.name for effect in model.effects if effect.name in DRIVE}
    return [(float(gain), float(offset)) for gain, offset in _torques(model.with_only(present))[-1]]


def _torques(model: ArmModel) -> tuple[Expression, Expression, Expression, Expression, list[_Reading]]:
    """Symbols of positions, velocities and accelerations, the drives' torques, and gain and offset of every reading."""
    n = len(model.arm.joints)
    q, v, a = (ca.SX.sym(name, n) for name in ("q", "v", "a"))
    links = [ca.SX(link) for link in model.link_parameters().values()]
    load = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, v, a)
    tau, gains, offsets = added_torques(model, (q, v, a), ca.sign(v), load, ca.SX.ones(n), ca.SX(model.theta()))
    readings = list(zip(ca.vertsplit(gains), ca.vertsplit(offsets), strict=True))
    return q, v, a, ca.densify(load + tau), readings


def added_torques(
    model: ArmModel,
    motion: tuple[Expression, Expression, Expression],
    direction: Expression,
    load: Expression,
    on: Expression,
    theta: Expression,
    told: Sequence[Told] = (),
) -> tuple[Expression, Expression, Expression]:
    """What effects add to the drives' torques, (n,), and gain and offset, (n,) each, of the readings of these.

    Args:
        model: the arm; its own values are not read.
        motion: (n,) positions, velocities and accelerations.
        direction: (n,) signs of the velocities.
        load: (n,) torques that the rigid bodies ask of the joints.
        on: (n,) 1 where the drive is on, 0 where it is off.
        theta: (p,) parameters of the model.
        told: what the drive of each joint was told; nothing if not given.

    Raises:
        InputError: an effect depends on time or has states of its own.
    """
    n = len(model.arm.joints)
    torque, gain, offset = [ca.SX(0)] * n, [], []
    for i in range(n):
        joint, inner = _with_effects(model, i, motion, direction[i], load[i], on[i], theta, told[i] if told else Told())
        torque[i] += joint.torque
        if inner >= 0:
            torque[inner] += joint.inner_torque
        gain.append(joint.gain)
        offset.append(joint.offset)
    return ca.vertcat(*torque), ca.vertcat(*gain), ca.vertcat(*offset)


def rigid_torques(
    arm: pin.Model, links: Sequence[Expression], gravity: Expression, q: Expression, v: Expression, a: Expression
) -> Expression:
    """(n,) torques that rigid bodies ask of the joints.

    Args:
        arm: placements and axes of the joints.
        links: (10,) inertial parameters of the link that each joint moves.
        gravity: (3,) in the frame of the base, m/s^2.
        q: (n,) rad or m.
        v: (n,) per s.
        a: (n,) per s^2.
    """
    inner = parents(arm)
    placements = list(arm.jointPlacements)[1:]
    axes = joint_axes(arm)
    rotations: list[tuple[Expression, Expression]] = []
    moves: list[tuple[Expression, Expression, Expression]] = []
    forces: list[tuple[Expression, Expression]] = []
    for i, axis in enumerate(axes):
        linear, angular = axis[:3], axis[3:]
        R = ca.SX(np.asarray(placements[i].rotation)) @ _turned(angular, q[i])
        p = ca.SX(placements[i].translation) + ca.SX(np.asarray(placements[i].rotation) @ linear) * q[i]
        w, dw, acceleration = (ca.SX(3, 1), ca.SX(3, 1), -gravity) if inner[i] < 0 else moves[inner[i]]
        # Acceleration of the link's origin, less gravity, then everything in the link's own axes.
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


def _with_effects(
    model: ArmModel,
    i: int,
    motion: tuple[Expression, Expression, Expression],
    direction: Expression,
    load: Expression,
    on: Expression,
    theta: Expression,
    told: Told,
) -> tuple[Joint, int]:
    """A joint with its effects at (p,) parameters, and its neighbour towards the base, -1 for none."""
    name, zero, time = model.arm.joints[i], ca.SX(0), ca.SX.sym("time")
    inner = parents(model.arm.model)[i]
    neighbour = Neighbour(*(part[inner] if inner >= 0 else zero for part in motion))
    q, v, a = (part[i] for part in motion)
    joint = Joint(time, q, v, a, direction, load, neighbour, Link(ca.SX(4, 4), ca.SX(4, 4)), on=on, told=told)
    for effect in model.effects:
        if effect.reach == "base" or name not in model.joints_with(effect.name):
            continue
        full = (f"{effect.name}.{short}" for short in effect.quantities)
        values = {quantity: theta[model.names.index(f"{quantity}[{name}]")] for quantity in full}
        # What an effect does to the link is in the link's parameters already.
        joint = replace(effect.apply(joint, values), link=joint.link)
        if joint.memory or ca.depends_on(ca.vertcat(joint.torque, joint.inner_torque), time):
            why = "has a state of its own" if joint.memory else "depends on time"
            raise InputError(
                f"effect '{effect.name}' {why}, which a function of one instant lacks: export the model without it"
            )
    return joint, inner


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
