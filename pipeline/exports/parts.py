"""An arm as simulators describe it: inertias, damping, friction, armature, springs; and the effects that do not fit."""

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.arm.slots import (
    ARMATURE,
    COMMAND_DELAY,
    COSINE,
    DAMPING,
    FADING_FRICTION,
    FADING_SPEED,
    FRICTION,
    GAIN,
    GRAVITY,
    LINK,
    OFFSET,
    PAST_COMMANDS,
    PLAY,
    READING_DELAY,
    REST_TORQUE,
    SINE,
    STIFFNESS,
    TORQUE,
    VOLTAGE,
    WRENCH_READING,
    slots_of,
)
from armdyn.effects.effect import Effect
from armdyn.errors import InputError
from armdyn.model import Model
from urdf.mend import impossible_inertia_reason

URDF_SLOTS = frozenset({LINK, GRAVITY, DAMPING, FRICTION})
MUJOCO_SLOTS = URDF_SLOTS | {
    ARMATURE, STIFFNESS, REST_TORQUE, SINE, COSINE, FADING_FRICTION, FADING_SPEED, GAIN, OFFSET, COMMAND_DELAY, PLAY,
}  # fmt: skip
"""Parameters of a joint that a format has; see `armdyn.arm.slots`."""
INEXPRESSIBLE_REASONS = {
    GAIN: "belongs to the drive's command, not to the arm",
    OFFSET: "belongs to the drive's command, not to the arm",
    COMMAND_DELAY: "shift the commands by it",
    READING_DELAY: "belongs to the torque sensor, not to the arm",
    WRENCH_READING: "belongs to the force/torque sensor, not to the arm",
    PAST_COMMANDS: "needs what was before",
    VOLTAGE: "the gain is that of the usual voltage",
}
"""Reason why a format cannot express an effect, by the slot that it lacks, or by what the effect depends on."""


def held_effects(effects: Iterable[Effect], slots: Collection[str]) -> frozenset[str]:
    """Names of those of some effects that a format with some slots can express.

    Of a friction that differs by direction, a format with friction alone expresses the mean.
    """
    found = set[str]()
    for effect in effects:
        lacking = (own := slots_of(effect).names) - set(slots)
        if own and (not lacking or (lacking == {TORQUE} and FRICTION in own)):
            found.add(effect.name)
    return frozenset(found)


@dataclass(frozen=True)
class ExportedJointDynamics:
    """One joint of an arm with its drive and its link, in the parameters of simulators.

    Attributes:
        name: name of the joint.
        link: inertial parameters of the moved link in the model, in the joint's frame (10,).
        described: inertial parameters of this link in the URDF (10,).
        damping: viscous friction and back EMF [N m s/rad].
        friction: dry friction, mean of both directions [N m].
        uneven: torque without motion: half the difference of forward and backward dry friction [N m].
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
    total, fading_speed = Counter[str](), 0.0
    for effect in model.effects:
        if name in model.joints_having_effect(effect.name):
            quantities = [f"{effect.name}.{short}[{name}]" for short in effect.quantities]
            own = slots_of(effect).at([model.parameters[quantity].value for quantity in quantities])
            fading_speed = own.pop(FADING_SPEED, fading_speed)
            total.update(own)
    stiffness = total[STIFFNESS]
    return ExportedJointDynamics(
        name,
        link,
        described,
        damping=total[DAMPING],
        friction=total[FRICTION],
        uneven=total[TORQUE],
        armature=total[ARMATURE],
        spring=(total[SINE], total[COSINE]),
        stiffness=stiffness,
        rest=-total[REST_TORQUE] / stiffness if stiffness else 0.0,
        play=total[PLAY],
        stribeck=(total[FADING_FRICTION], fading_speed),
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
        why = _reason(effect, f"{whose} has no place for it") if effect.name not in held else ""
        if not why and symmetric and TORQUE in slots_of(effect).names:
            uneven = {joint.name for joint in exported_joint_dynamics(model) if joint.uneven}
            joints = [joint for joint in joints if joint in uneven and joint not in uneven_drives]
            why = f"{whose} has one friction for both directions; their mean is used" if joints else ""
        if why:
            where = f" ({', '.join(joints)})" if joints else ""
            sentences.append(f"{effect.name}{where}: {why}")
    return [*sentences, *inexpressible_background(model, held, whose)]


def _reason(effect: Effect, usual: str) -> str:
    """Why a format cannot express an effect."""
    slots = slots_of(effect)
    known = (
        INEXPRESSIBLE_REASONS[what]
        for what in (*sorted(slots.names), slots.depends_on)
        if what in INEXPRESSIBLE_REASONS
    )
    return next(known, usual)


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
