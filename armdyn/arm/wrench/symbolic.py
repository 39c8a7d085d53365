"""What force/torque sensors read, as CasADi expressions of one instant."""

import casadi as ca

from armdyn.arm.model import ArmModel
from armdyn.arm.physics import Expression, Wrench
from armdyn.arm.rigid import joint_axes, parent_joints
from armdyn.arm.symbolic import joint_placement, rigid_torques
from armdyn.arm.wrench.prediction import SensorWithEffects
from armdyn.arm.wrench.reading import read_wrench
from armdyn.effects.effect import Effect


def sensor_reading(
    model: ArmModel,
    sensor: str,
    motion: tuple[Expression, Expression, Expression],
    more: Expression | None = None,
    beside: tuple[Effect, Expression] | None = None,
) -> Expression:
    """(6,) forces, N, and torques, N m, that a sensor reads at an instant, at the model's parameters.

    Args:
        model: the arm.
        sensor: name of the sensor.
        motion: (nj,) positions, velocities and accelerations of the arm's joints.
        more: (4,) mass, kg, and mass times position, kg m, of a body on the last link, in the frame of its joint.
        beside: a further effect of the sensor, after those of the model, and its parameters.
    """
    found = next(one for one in model.sensors_at(model.theta()) if one.sensor.name == sensor)
    cut, links, arm = found.cut, [ca.SX(link) for link in found.links], found.cut.model
    last = model.arm.joints.index(model.joints[-1])
    if more is not None and last == cut.host:
        links[cut.tool] += ca.SX(cut.transfer[:, : more.numel()]) @ more
    elif more is not None and cut.behind(last):
        links[cut.moved[last]] += ca.vertcat(more, ca.SX.zeros(links[0].numel() - more.numel()))
    whole = [ca.SX.zeros(arm.nv) for _ in motion]
    for values, given in zip(whole, motion, strict=True):
        for at, value in zip(cut.moved, ca.vertsplit(given), strict=True):
            values[at] = value
    rotation, place = _pose(found, whole[0])
    true = rigid_torques(arm, links, ca.SX(model.gravity()), *whole)[list(cut.axes)]
    effects = [e.on() for e in model.effects if e.acts_on == "wrench" and sensor in model.joints_having_effect(e.name)]
    given = {f"{e.name}.{short}": model.value(f"{e.name}.{short}[{sensor}]") for e in effects for short in e.quantities}
    parameters = {name: ca.SX(value) for name, value in given.items()}
    if beside is not None:
        effect, values = beside
        effects.append(effect)
        names = (f"{effect.name}.{short}" for short in effect.quantities)
        parameters |= dict(zip(names, ca.vertsplit(values), strict=True))
    read = read_wrench(effects, found.sensor.axes, Wrench(ca.SX(0), rotation, place, true[:3], true[3:]), parameters)
    return ca.vertcat(read.force, read.torque)


def needs_more_than_an_instant(effect: Effect) -> bool:
    """Whether a sensor's reading with an effect is delayed, or depends on the time since the start of the run."""
    time, rest = ca.SX.sym("time"), ca.SX.sym("rest", 18)
    axes, place, force, torque = ca.vertsplit(rest, [0, 9, 12, 15, 18])
    given = {f"{effect.name}.{short}": ca.SX.sym(short) for short in effect.quantities}
    read = effect.on().apply(Wrench(time, ca.reshape(axes, 3, 3), place, force, torque), given)
    return not ca.simplify(read.delay).is_zero() or ca.depends_on(ca.vertcat(read.force, read.torque), time)


def _pose(sensor: SensorWithEffects, q: Expression) -> tuple[Expression, Expression]:
    """(3, 3) rotation from the base's frame to that of a sensor, and its (3,) position, m."""
    arm, chain = sensor.cut.model, [sensor.cut.tool]
    while (inner := parent_joints(arm)[chain[-1]]) >= 0:
        chain.append(inner)
    rotation, place, axes = ca.SX.eye(3), ca.SX.zeros(3), joint_axes(arm)
    for i in reversed(chain):
        own, offset = joint_placement(arm, i, axes[i], q[i])
        rotation, place = rotation @ own, place + rotation @ offset
    return rotation.T, place
