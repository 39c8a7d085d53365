"""Add the effects that an MJCF describes: friction, damping, armature and springs of joints."""

from collections.abc import Mapping

from armdyn.arm.model import ArmModel
from armdyn.arm.slots import ARMATURE, COSINE, DAMPING, FRICTION, REST_TORQUE, SINE, STIFFNESS, simplest_effect
from armdyn.effects.catalogue import find

DYNAMICS_ATTRIBUTES = {DAMPING: "damping", FRICTION: "friction", ARMATURE: "armature"}
"""Attribute of `urdf.robot.JointDynamics` with the described value of an effect's only slot."""


def _parameters_of(*slots: str) -> list[str]:
    """Parameters of the simplest effect with these slots."""
    effect = simplest_effect(*slots)
    return [f"{effect.name}.{short}" for short in effect.quantities]


def with_described_effects(model: ArmModel) -> ArmModel:
    """The arm with effects for damping, friction, armature and springs of its description, at their values.

    A URDF has none of them, because its ``<dynamics>`` are placeholders; see `urdf.robot.URDF_DYNAMICS`.
    """
    for quantities in _described(model):
        effect = next(iter(quantities)).partition(".")[0]
        joints = [joint for joint in model.joints if any(joint in values for values in quantities.values())]
        model = model.with_effect(find(f"{effect}:{','.join(joints)}"))
        values = {f"{name}[{joint}]": size for name, by_joint in quantities.items() for joint, size in by_joint.items()}
        model = model.with_values(values)
    return model


def _described(model: ArmModel) -> list[Mapping[str, Mapping[str, float]]]:
    """Values by parameter and joint, for each effect with a value that is not zero."""
    robot = model.arm.robot
    found: list[Mapping[str, Mapping[str, float]]] = []
    for slot, name in DYNAMICS_ATTRIBUTES.items():
        (parameter,) = _parameters_of(slot)
        drives = {joint: getattr(dynamics, name) for joint, dynamics in robot.joint_dynamics.items()}
        found.append({parameter: {joint: value for joint, value in drives.items() if value}})
    linear: dict[str, tuple[float, float]] = {}
    turning: dict[str, tuple[float, float]] = {}
    for spring in robot.springs:
        if spring.enabled and spring.stiffness:
            stiffness, rest = linear.get(spring.joint, (0.0, 0.0))
            whole = stiffness + spring.stiffness
            linear[spring.joint] = whole, (stiffness * rest + spring.stiffness * spring.rest) / whole
        elif spring.enabled:
            sine, cosine = turning.get(spring.joint, (0.0, 0.0))
            turning[spring.joint] = sine + spring.sine, cosine + spring.cosine
    for springs, names in (
        (linear, _parameters_of(STIFFNESS, REST_TORQUE)),
        (turning, _parameters_of(SINE, COSINE)),
    ):
        found.append({name: {joint: values[k] for joint, values in springs.items()} for k, name in enumerate(names)})
    return [quantities for quantities in found if any(quantities.values())]
