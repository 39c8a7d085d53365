"""An arm as simulators describe it: inertias, damping, friction, armature, springs; and the effects that do not fit."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.model import Model
from urdf.mend import impossible_inertia_reason

LINKS = frozenset({"link_inertia", "payload"})
HELD = {
    "urdf": LINKS | {"base_tilt", "joint_viscous_friction", "joint_coulomb_friction", "joint_asymmetric_friction"},
    "mujoco": LINKS
    | {
        "base_tilt", "joint_viscous_friction", "joint_coulomb_friction", "joint_asymmetric_friction", "rotor_inertia",
        "gravity_spring", "joint_spring", "torque_offset", "torque_gain", "servo_gain", "back_emf",
        "command_delay",
    },
}  # fmt: skip
"""Effects that a format holds."""
WHY = {
    "torque_offset": "belongs to the drive's command, not to the arm",
    "torque_gain": "belongs to the drive's command, not to the arm",
    "command_delay": "shift the commands by it",
    "servo_integral": "needs what was before",
    "supply_voltage": "the gain is that of the usual voltage",
    "torque_delay": "belongs to the torque sensor, not to the arm",
}
"""Reasons why no format has a place for an effect."""


@dataclass(frozen=True)
class JointParts:
    """One joint, its drive and its link.

    Attributes:
        name: name of the joint.
        link: (10,) inertial parameters of the moved link, in the joint's frame.
        described: (10,) the same as described in the URDF.
        damping: viscous friction and back EMF, N m s/rad.
        friction: dry friction, N m; the mean of both directions.
        uneven: forward minus backward dry friction, halved, N m.
        armature: inertia of the rotor behind the gears, kg m^2.
        spring: factors of sin q and cos q in the torque of the drive, N m.
        stiffness: stiffness of a spring in the joint, N m/rad.
        rest: position at which that spring is free of torque, rad.
    """

    name: str
    link: np.ndarray
    described: np.ndarray
    damping: float
    friction: float
    uneven: float
    armature: float
    spring: tuple[float, float]
    stiffness: float
    rest: float


def parts_of(model: ArmModel) -> tuple[JointParts, ...]:
    """The joints of an arm, from base to tool, as simulators describe them."""
    links = model.link_parameters()
    return tuple(_joint(model, name, links[name], model.arm.described[i]) for i, name in enumerate(model.arm.joints))


def _joint(model: ArmModel, name: str, link: np.ndarray, described: np.ndarray) -> JointParts:
    def value(of: str) -> float:
        parameter = model.parameters.get(f"{of}[{name}]")
        return parameter.value if parameter is not None else 0.0

    forward, backward = (value(f"joint_asymmetric_friction.{side}") for side in ("positive", "negative"))
    return JointParts(
        name,
        link,
        described,
        damping=value("joint_viscous_friction.coefficient") + value("back_emf.coefficient"),
        friction=value("joint_coulomb_friction.torque") + (forward + backward) / 2,
        uneven=(forward - backward) / 2,
        armature=value("rotor_inertia.inertia"),
        spring=(value("gravity_spring.sine"), value("gravity_spring.cosine")),
        stiffness=value("joint_spring.stiffness"),
        rest=value("joint_spring.rest"),
    )


def need_body(link: str, inertia: np.ndarray) -> None:
    """Refuse to write an inertia about the centre, (3, 3) kg m^2, that no body has: other programs refuse to read it.

    Raises:
        InputError: names the link and the condition.
    """
    wrong = impossible_inertia_reason(inertia)
    if wrong:
        raise InputError(f"link '{link}': {wrong}: correct its <inertia>, it is not exported")


def left_over(
    model: ArmModel, held: Collection[str], whose: str, *, symmetric: bool = True, uneven_drives: Collection[str] = ()
) -> list[str]:
    """A sentence for each effect that a format cannot hold, and one for all of the background.

    Args:
        model: the arm.
        held: names of the effects that the format holds.
        whose: name of the format.
        symmetric: whether its friction is the same in both directions.
        uneven_drives: joints whose drives hold the difference of the directions.
    """
    sentences = []
    named = model.named_only()
    for effect in named.effects:
        joints = [joint for joint in named.joints_with(effect.name) if joint]
        why = WHY.get(effect.name, f"{whose} has no place for it") if effect.name not in held else ""
        if not why and symmetric and effect.name == "joint_asymmetric_friction":
            uneven = {joint.name for joint in parts_of(model) if joint.uneven}
            joints = [joint for joint in joints if joint in uneven and joint not in uneven_drives]
            why = f"{whose} has one friction for both directions; their mean is used" if joints else ""
        if why:
            where = f" ({', '.join(joints)})" if joints else ""
            sentences.append(f"{effect.name}{where}: {why}")
    return [*sentences, *background_left_over(model, held, whose)]


def background_left_over(model: Model, held: Collection[str], whose: str) -> list[str]:
    """A sentence on the background's values that a format, called `whose`, cannot hold; empty where it holds all."""
    if model.background is None:
        return []
    lost = [p.effect for p in map(model.parameters.__getitem__, model.background.names) if p.effect not in held]
    effects = ", ".join(dict.fromkeys(lost))
    return [f"{len(lost)} of the {model.background.label} ({effects}): {whose} has no place for them"] if lost else []
