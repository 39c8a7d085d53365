"""Effects that the description of an arm holds already: what an MJCF says of its drives and springs."""

from collections.abc import Mapping

from armdyn.arm.model import ArmModel
from armdyn.effects.catalogue import find

DRIVES = {
    "joint_viscous_friction.coefficient": "damping",
    "joint_coulomb_friction.torque": "friction",
    "rotor_inertia.inertia": "armature",
}
"""By parameter of an effect: what `urdf.robot.JointDynamics` calls it."""


def with_described_effects(model: ArmModel) -> ArmModel:
    """The arm with an effect for everything but rigid bodies that its description counts in, at the values there.

    That is nothing for a URDF, whose ``<dynamics>`` are placeholders; see `urdf.robot.IN_A_URDF`.
    """
    for quantities in _described(model):
        effect = next(iter(quantities)).partition(".")[0]
        joints = [joint for joint in model.joints if any(joint in values for values in quantities.values())]
        model = model.with_effect(find(f"{effect}:{','.join(joints)}"))
        values = {f"{name}[{joint}]": size for name, by_joint in quantities.items() for joint, size in by_joint.items()}
        model = model.with_values(values)
    return model


def _described(model: ArmModel) -> list[Mapping[str, Mapping[str, float]]]:
    """Per effect, by parameter and joint, the values; only effects and joints where one is not zero."""
    robot = model.arm.robot
    found: list[Mapping[str, Mapping[str, float]]] = []
    for parameter, name in DRIVES.items():
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
        (linear, ("joint_spring.stiffness", "joint_spring.rest")),
        (turning, ("gravity_spring.sine", "gravity_spring.cosine")),
    ):
        found.append({name: {joint: values[k] for joint, values in springs.items()} for k, name in enumerate(names)})
    return [quantities for quantities in found if any(quantities.values())]
