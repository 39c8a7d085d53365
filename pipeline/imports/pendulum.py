"""Columns of a load on a string, a pendulum or a crane: motion of the pivot, swing, tension of the string."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.imports.claims import Claim
from pipeline.imports.joints import Joints, Range
from pipeline.imports.words import COMMANDED, Label, fits, words_in

FORCE = words_in("force tension loadcell load kraft")
PIVOT = words_in("gripper cart pivot trolley carriage slider hand")
SWING = words_in("swing phi pendulum pend pole theta th angle ang alpha bob winkel encoder")
RATES = words_in("gyro gyroscope omega phidot thetadot dtheta")
HEIGHT = words_in("z height")
CHANNELS = {
    ("q", "swing"): "swing_angle", ("v", "swing"): "swing_rate",
    ("q", "gripper"): "gripper_x", ("v", "gripper"): "gripper_v", ("a", "gripper"): "gripper_a",
    ("q", "height"): "gripper_z", ("force", "load"): "load_force",
}  # fmt: skip
"""Channels by quantity and part of a pendulum."""
PARTS = Joints(ranges={part: Range(True, np.inf, np.inf) for part in ("gripper", "height")})
"""The parts that slide; their ranges are unknown."""


def pendulum_claims(labels: Mapping[str, Label]) -> list[Claim]:
    """Claims of headers, by column, of a pendulum."""
    swings = any(set(label.words) & SWING for label in labels.values())
    plane = any("y" in label.words for label in labels.values())  # x beside y is the load's place in a picture
    claims = []
    for column, label in labels.items():
        part = "" if COMMANDED & set(label.words) else _part(label, swings and not plane)
        quantity = "force" if part == "load" else "v" if set(label.words) & RATES else label.quantity
        quantity = quantity if quantity in ("v", "a", "force") else "q"
        if channel := CHANNELS.get((quantity, part)):
            doubts = (label.doubt,) if label.doubt else ()
            claims.append(Claim(column, channel, part, replace(label, quantity=quantity), doubts))
    return claims


def _part(label: Label, swings: bool) -> str:
    words, quantity = set(label.words), label.quantity
    if words & RATES:
        return "swing"
    if words & FORCE and quantity in ("", "force", "tau"):
        return "load"
    if words & PIVOT:
        return "height" if words & HEIGHT and quantity in ("", "q") else "gripper"
    if words & SWING or (quantity and label.unit and fits(label.unit, "rad", "rad/s")):
        return "swing"
    return "gripper" if swings and ("x" in words or (quantity in ("q", "v") and len(label.words) == 1)) else ""
