"""Columns of a load on a string, a pendulum or a crane: motion of the pivot, swing, tension of the string."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.imports.claims import Claim
from pipeline.imports.joints import JointRange, RobotJoints
from pipeline.imports.words import COMMAND_WORDS, ColumnHeaderParts, is_unit_like, word_set

FORCE_WORDS = word_set("force tension loadcell load kraft")
PIVOT_WORDS = word_set("gripper cart pivot trolley carriage slider hand")
SWING_WORDS = word_set("swing phi pendulum pend pole theta th angle ang alpha bob winkel encoder")
RATE_WORDS = word_set("gyro gyroscope omega phidot thetadot dtheta")
HEIGHT_WORDS = word_set("z height")
"""Words of a column's header that name a part or a quantity of a pendulum."""
PENDULUM_CHANNELS = {
    ("q", "swing"): "swing_angle", ("v", "swing"): "swing_rate",
    ("q", "gripper"): "gripper_x", ("v", "gripper"): "gripper_v", ("a", "gripper"): "gripper_a",
    ("q", "height"): "gripper_z", ("force", "load"): "load_force",
}  # fmt: skip
"""Channels of a pendulum's recording, by quantity and part of the pendulum."""
PENDULUM_PARTS = RobotJoints(ranges={part: JointRange(True, np.inf, np.inf) for part in ("gripper", "height")})
"""Moving parts of a pendulum in the form of prismatic joints with unknown ranges."""


def pendulum_claims(labels: Mapping[str, ColumnHeaderParts]) -> list[Claim]:
    """Possible meanings of columns in the recording of a pendulum, from their parsed headers."""
    swings = any(set(label.words) & SWING_WORDS for label in labels.values())
    plane = any("y" in label.words for label in labels.values())  # x beside y is the load's place in a picture
    claims = []
    for column, label in labels.items():
        part = "" if COMMAND_WORDS & set(label.words) else _part(label, swings and not plane)
        quantity = "force" if part == "load" else "v" if set(label.words) & RATE_WORDS else label.quantity
        quantity = quantity if quantity in ("v", "a", "force") else "q"
        if channel := PENDULUM_CHANNELS.get((quantity, part)):
            doubts = (label.doubt,) if label.doubt else ()
            claims.append(Claim(column, channel, part, replace(label, quantity=quantity), doubts))
    return claims


def _part(label: ColumnHeaderParts, swings: bool) -> str:
    words, quantity = set(label.words), label.quantity
    if words & RATE_WORDS:
        return "swing"
    if words & FORCE_WORDS and quantity in ("", "force", "tau"):
        return "load"
    if words & PIVOT_WORDS:
        return "height" if words & HEIGHT_WORDS and quantity in ("", "q") else "gripper"
    if words & SWING_WORDS or (quantity and label.unit and is_unit_like(label.unit, "rad", "rad/s")):
        return "swing"
    return "gripper" if swings and ("x" in words or (quantity in ("q", "v") and len(label.words) == 1)) else ""
