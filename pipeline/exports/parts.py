"""An arm as simulators describe it: inertias, damping, friction, armature, springs; and the effects that do not fit."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from armdyn.arm.closed_loop.play import PLAY_PARAMETER
from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.model import Model
from urdf.mend import impossible_inertia_reason

LINK_EFFECTS = frozenset({"link_inertia", "payload"})
EXPRESSIBLE_EFFECTS = {
    "urdf": LINK_EFFECTS
    | {"base_tilt", "joint_viscous_friction", "joint_coulomb_friction", "joint_asymmetric_friction"},
    "mujoco": LINK_EFFECTS
    | {
        "base_tilt", "joint_viscous_friction", "joint_coulomb_friction", "joint_asymmetric_friction",
        "joint_stribeck_friction", "rotor_inertia",
        "gravity_spring", "joint_spring", "torque_offset", "torque_gain", "servo_gain", "back_emf",
        "command_delay", "backlash",
    },
}  # fmt: skip
"""Effects that a format can express, by format."""
INEXPRESSIBLE_REASONS = {
    "torque_offset": "belongs to the drive's command, not to the arm",
    "torque_gain": "belongs to the drive's command, not to the arm",
    "command_delay": "shift the commands by it",
    "servo_integral": "needs what was before",
    "supply_voltage": "the gain is that of the usual voltage",
    "torque_delay": "belongs to the torque sensor, not to the arm",
}
"""Reason why no simulator's format can express an effect, by effect."""


@dataclass(frozen=True)
class ExportedJointDynamics:
    """One joint of an arm with its drive and its link, in the parameters of simulators.

    Attributes:
        name: name of the joint.
        link: inertial parameters of the moved link in the model, in the joint's frame (10,).
        described: inertial parameters of this link in the URDF (10,).
        damping: viscous friction and back EMF [N m s/rad].
        friction: dry friction, mean of both directions [N m].
        uneven: half the difference of forward and backward dry friction [N m].
        armature: inertia of the rotor behind the gears [kg m^2].
        spring: factors of sin q and cos q in the torque of a gravity spring [N m].
        stiffness: stiffness of a spring in the joint [N m/rad].
        rest: position at which the spring in the joint has no torque [rad].
        play: way of the link to either side of the drive's position [rad].
        stribeck: additional dry friction at standstill [N m], and the speed at which 1/e of it remains [rad/s].
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
    play: float
    stribeck: tuple[float, float]


def exported_joint_dynamics(model: ArmModel) -> tuple[ExportedJointDynamics, ...]:
    """The joints of an arm, from base to tool, in the parameters of simulators."""
    links = model.link_parameters()
    return tuple(_joint(model, name, links[name], model.arm.described[i]) for i, name in enumerate(model.arm.joints))


def _joint(model: ArmModel, name: str, link: np.ndarray, described: np.ndarray) -> ExportedJointDynamics:
    def value(of: str) -> float:
        parameter = model.parameters.get(f"{of}[{name}]")
        return parameter.value if parameter is not None else 0.0

    forward, backward = (value(f"joint_asymmetric_friction.{side}") for side in ("positive", "negative"))
    return ExportedJointDynamics(
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
        play=value(PLAY_PARAMETER),
        stribeck=(value("joint_stribeck_friction.torque"), value("joint_stribeck_friction.speed")),
    )


def require_physical_inertia(link: str, inertia: np.ndarray) -> None:
    """Refuse an inertia that no rigid body can have, because other programs cannot read it.

    Args:
        link: name of the link.
        inertia: inertia about the centre of mass (3, 3) [kg m^2].

    Raises:
        InputError: the inertia is not physical; the message names the link and the violated condition.
    """
    wrong = impossible_inertia_reason(inertia)
    if wrong:
        raise InputError(f"link '{link}': {wrong}: correct its <inertia>, it is not exported")


def inexpressible_effects(
    model: ArmModel, held: Collection[str], whose: str, *, symmetric: bool = True, uneven_drives: Collection[str] = ()
) -> list[str]:
    """Sentences on the effects that a format cannot express: one for each effect, and one for the background.

    Args:
        model: the arm.
        held: names of the effects that the format can express.
        whose: name of the format.
        symmetric: whether the format's friction is the same in both directions.
        uneven_drives: joints for which the format can express different frictions in the two directions.
    """
    sentences = []
    named = model.without_background()
    for effect in named.effects:
        joints = [joint for joint in named.joints_having_effect(effect.name) if joint]
        why = INEXPRESSIBLE_REASONS.get(effect.name, f"{whose} has no place for it") if effect.name not in held else ""
        if not why and symmetric and effect.name == "joint_asymmetric_friction":
            uneven = {joint.name for joint in exported_joint_dynamics(model) if joint.uneven}
            joints = [joint for joint in joints if joint in uneven and joint not in uneven_drives]
            why = f"{whose} has one friction for both directions; their mean is used" if joints else ""
        if why:
            where = f" ({', '.join(joints)})" if joints else ""
            sentences.append(f"{effect.name}{where}: {why}")
    return [*sentences, *inexpressible_background(model, held, whose)]


def inexpressible_background(model: Model, held: Collection[str], whose: str) -> list[str]:
    """Sentence on the small values without a name (the background) that a format cannot express, or an empty list.

    Args:
        model: the model.
        held: names of the effects that the format can express.
        whose: name of the format.
    """
    if model.background is None:
        return []
    lost = [p.effect for p in map(model.parameters.__getitem__, model.background.names) if p.effect not in held]
    effects = ", ".join(dict.fromkeys(lost))
    return [f"{len(lost)} of the {model.background.label} ({effects}): {whose} has no place for them"] if lost else []
