"""An arm as simulators describe it: inertias, damping, friction, armature, springs; and which effects do not fit."""

from collections.abc import Collection
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.model import Model
from urdf.mend import no_body

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
"""Effects that a format holds, by format."""
WHY = {
    "torque_offset": "belongs to the drive's command, not to the arm",
    "torque_gain": "belongs to the drive's command, not to the arm",
    "command_delay": "shift the commands by it",
    "servo_integral": "needs what was before",
    "supply_voltage": "the gain is that of the usual voltage",
    "torque_delay": "belongs to the torque sensor, not to the arm",
}


@dataclass(frozen=True)
class JointParts:
    """One joint, its drive and its link.

    Attributes:
        name: of the joint.
        link: (10,) inertial parameters of what it moves, in its frame.
        described: (10,) as the URDF has them.
        damping: torque per speed, N m s/rad; with that of a motor that is on.
        friction: size of the dry friction, N m.
        uneven: what it is more forwards than that, and less backwards, N m.
        armature: of the rotor behind the gears, kg m^2.
        spring: factors of sin q and of cos q in what the drive gives, N m.
        stiffness: of a spring in the joint, N m/rad.
        rest: position at which that does not pull, rad.
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


@dataclass(frozen=True)
class ArmParts:
    """All joints, and gravity.

    Attributes:
        joints: from base to tool.
        gravity: (3,) in the frame of the base, m/s^2.
    """

    joints: tuple[JointParts, ...]
    gravity: np.ndarray


def parts_of(model: ArmModel) -> ArmParts:
    """The parts of an arm; an asymmetric friction counts with the mean of its sizes."""

    def of(effect: str, short: str, joint: str) -> float:
        parameter = model.parameters.get(f"{effect}.{short}[{joint}]")
        return parameter.value if parameter is not None else 0.0

    links = model.link_parameters()
    joints = tuple(
        JointParts(
            name=name,
            link=links[name],
            described=model.arm.described[i],
            damping=of("joint_viscous_friction", "coefficient", name) + of("back_emf", "coefficient", name),
            friction=of("joint_coulomb_friction", "torque", name)
            + (of("joint_asymmetric_friction", "positive", name) + of("joint_asymmetric_friction", "negative", name))
            / 2,
            uneven=(
                of("joint_asymmetric_friction", "positive", name) - of("joint_asymmetric_friction", "negative", name)
            )
            / 2,
            armature=of("rotor_inertia", "inertia", name),
            spring=(of("gravity_spring", "sine", name), of("gravity_spring", "cosine", name)),
            stiffness=of("joint_spring", "stiffness", name),
            rest=of("joint_spring", "rest", name),
        )
        for i, name in enumerate(model.arm.joints)
    )
    return ArmParts(joints, model.gravity())


def need_body(link: str, inertia: np.ndarray) -> None:
    """Refuse to write an inertia about the centre, (3, 3) kg m^2, that no body has: other programs refuse to read it.

    Raises:
        InputError: names the link and the condition.
    """
    wrong = no_body(inertia)
    if wrong:
        raise InputError(f"link '{link}': {wrong}: correct its <inertia>, it is not exported")


def left_over(
    model: ArmModel, held: Collection[str], whose: str, *, symmetric: bool = True, told: Collection[str] = ()
) -> list[str]:
    """A sentence for each effect that a format cannot hold, and one for all of the background.

    Args:
        model: the arm.
        held: names of effects that it holds.
        whose: what the format is called.
        symmetric: whether its friction is the same in both directions.
        told: joints whose drives hold what differs.
    """
    sentences = []
    named = model.named_only()
    for effect in named.effects:
        joints = [joint for joint in named.joints_with(effect.name) if joint]
        where = f" ({', '.join(joints)})" if joints else ""
        if effect.name not in held:
            why = WHY.get(effect.name, f"{whose} has no place for it")
            sentences.append(f"{effect.name}{where}: {why}")
        elif symmetric and effect.name == "joint_asymmetric_friction":
            unequal = [j for j in joints if j not in told and _of(model, "positive", j) != _of(model, "negative", j)]
            if unequal:
                sentences.append(
                    f"{effect.name} ({', '.join(unequal)}): {whose} has one friction for both directions; their mean "
                    "is used"
                )
    return [*sentences, *background_left_over(model, held, whose)]


def background_left_over(model: Model, held: Collection[str], whose: str) -> list[str]:
    """A sentence on the values of a model's background that a format cannot hold; none where it holds them all.

    Args:
        model: with its background.
        held: names of effects that the format holds.
        whose: what the format is called.
    """
    if model.background is None:
        return []
    lost = [p.effect for p in map(model.parameters.__getitem__, model.background.names) if p.effect not in held]
    effects = ", ".join(dict.fromkeys(lost))
    return [f"{len(lost)} of the {model.background.label} ({effects}): {whose} has no place for them"] if lost else []


def child_link(joint: ET.Element) -> str:
    """Name of the link that a joint of a URDF moves; empty where it names none."""
    child = joint.find("child")
    return "" if child is None else child.get("link", "")


def _of(model: ArmModel, short: str, joint: str) -> float:
    return model.parameters[f"joint_asymmetric_friction.{short}[{joint}]"].value
