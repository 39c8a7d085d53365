"""Effects that the simulated robot can have and the model lacks, by the catalogue's names.

Every value is zero where the effect is absent. How each one acts on MuJoCo's model or state is written in
`scene`, `load_forces`, `joint_effects`, `cell` and `readings`; none of it shares code with the model under test.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from armdyn.errors import InputError, UnknownNameError


class HiddenEffect(NamedTuple):
    """One effect that the plant can have.

    Attributes:
        unit: unit of its value.
        typical: value that it has when none is given.
        summary: one sentence.
        lower: smallest value that makes sense.
        upper: largest value that the 1 ms integration stays accurate for.
    """

    unit: str
    typical: float
    summary: str
    lower: float = 0.0
    upper: float = math.inf


_BOTH = -math.inf

HIDDEN_EFFECTS: Mapping[str, HiddenEffect] = MappingProxyType({
    # gripper
    "gripper_lag": HiddenEffect(
        "s", 0.02, "The gripper trails what the encoders report, as a first-order lag.", 0.0, 0.2),
    "path_tilt": HiddenEffect(
        "rad", 0.01, "The robot stands tilted: gravity has a component along the line, towards + for > 0.", -0.5, 0.5),
    # string
    "pivot_viscous_friction": HiddenEffect(
        "N m s/rad", 1e-3, "A torque at the string's upper end, proportional to the swing rate.", 0.0, 0.5),
    "pivot_coulomb_friction": HiddenEffect(
        "N m", 1e-3, "A torque of constant size at the string's upper end, against the swing.", 0.0, 0.5),
    "string_elasticity": HiddenEffect(
        "m/N", 2e-3, "The string stretches in proportion to its tension (replaces the nearly rigid one).", 1e-4, 0.05),
    "string_creep": HiddenEffect("m/s", 5e-5, "The string grows longer at a constant rate.", -0.01, 0.01),
    # load
    "linear_drag": HiddenEffect("N s/m", 5e-3, "Air drag proportional to the load's speed.", 0.0, 5.0),
    "quadratic_drag": HiddenEffect(
        "N s^2/m^2", 3e-3, "Air drag growing with the square of the load's speed.", 0.0, 5.0),
    "wind": HiddenEffect("N", 5e-3, "A constant horizontal force on the load, along the line.", -1.0, 1.0),
    "load_inertia": HiddenEffect(
        "kg m^2", 2e-4, "The load turns with the string and has this moment of inertia about its centre.", 0.0, 0.1),
    "out_of_plane_swing": HiddenEffect(
        "rad", 0.05, "The load starts displaced across the line by this angle.", -1.0, 1.0),
    # sensor
    "sensor_bias": HiddenEffect("N", 0.02, "A constant added to the force (on top of the drawn bias).", _BOTH),
    "sensor_gain": HiddenEffect("1", 0.03, "Relative error of the force's scale.", -0.9),
    "sensor_drift": HiddenEffect("N/s", 1e-3, "The force's zero moves at a constant rate.", _BOTH),
    "sensor_lag": HiddenEffect("s", 0.02, "The cell follows the force as a first-order lag.", 0.0, 1.0),
    "sensor_delay": HiddenEffect("s", 0.02, "The force arrives late (on top of the drawn latency).", 0.0, 1.0),
    "vertical_sensing_axis": HiddenEffect(
        "1", 1.0, "The cell measures the vertical part of the string's pull; between 0 and 1 a mixture.", 0.0, 1.0),
    "cross_axis_sensitivity": HiddenEffect(
        "1", 0.02, "The cell also feels this share of the string's pull along the line, T sin(angle).", -1.0, 1.0),
    "sensor_nonlinearity": HiddenEffect(
        "1/N", 0.02, "The reading curves: this times the force squared is added.", _BOTH),
    # joint; the effort limit scales the value, so that Baxter's wrist has 0.3 of the shoulder's
    "joint_viscous_friction": HiddenEffect("N m s/rad", 3.0, "More viscous friction in every joint.", 0.0, 50.0),
    "joint_coulomb_friction": HiddenEffect("N m", 1.0, "More dry friction in every joint.", 0.0, 20.0),
    "joint_asymmetric_friction": HiddenEffect(
        "N m", 1.0, "More dry friction in every joint while it turns positively.", 0.0, 20.0),
    "joint_stribeck_friction": HiddenEffect(
        "N m", 1.0, "More dry friction in every joint near standstill, fading as exp(-(v/0.1 rad/s)^2).", 0.0, 20.0),
    "joint_load_friction": HiddenEffect(
        "1", 0.05, "Dry friction in every joint proportional to the gravity torque that it carries.", 0.0, 1.0),
    "rotor_inertia": HiddenEffect(
        "kg m^2", 0.1, "More rotor inertia in every joint, as seen behind the gears.", 0.0, 10.0),
    "torque_offset": HiddenEffect("N m", 0.5, "A constant added to every measured effort.", _BOTH),
    "torque_gain": HiddenEffect("1", 0.05, "Relative error of the scale of every measured effort.", -0.9),
    "gravity_spring": HiddenEffect(
        "1", 1.0, "Baxter's gravity springs on s1, as a share of the real ones: 8.2 sin q + 35.3 cos q N m.", 0.0, 2.0),
    "payload": HiddenEffect("kg", 0.5, "A mass at the gripper's frame that the arm's model does not know.", 0.0, 5.0),
    "link_inertia": HiddenEffect("1", 0.1, "Mass and inertia of every arm link are larger by this share.", -0.9, 5.0),
})  # fmt: skip


def resolve_hidden(hidden: Mapping[str, float | None]) -> Mapping[str, float]:
    """Value of every effect: typical where ``None`` was given, zero where the effect was not named.

    Args:
        hidden: name to value in the effect's unit, or ``None`` for the typical value.

    Returns:
        All names of `HIDDEN_EFFECTS` with their value, read-only.

    Raises:
        UnknownNameError: a name that the plant does not have.
        InputError: a value that is not finite or outside the effect's range.
    """
    values = dict.fromkeys(HIDDEN_EFFECTS, 0.0)
    for name, value in hidden.items():
        if name not in HIDDEN_EFFECTS:
            raise UnknownNameError("hidden effect", name, HIDDEN_EFFECTS)
        effect = HIDDEN_EFFECTS[name]
        number = effect.typical if value is None else float(value)
        if number != 0.0 and not (math.isfinite(number) and effect.lower <= number <= effect.upper):
            raise InputError(
                f"hidden effect '{name}' is {number:g} {effect.unit}: give 0 or a value from {effect.lower:g} to "
                f"{effect.upper:g} (typical {effect.typical:g})"
            )
        values[name] = number
    return MappingProxyType(values)
