"""Columns of a load on a string, a pendulum or a crane: what moves the pivot, how it swings, what the string pulls."""

from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.channels import channel_kind
from armdyn.units import si_factor
from pipeline.imports.foreign import Column
from pipeline.imports.mapping import Entry
from pipeline.imports.sizes import TURNS, largest
from pipeline.imports.words import COMMANDED, Label, is_unit, words_in

FORCE = words_in("force tension loadcell load kraft")
PIVOT = words_in("gripper cart pivot trolley carriage slider hand")
SWING = words_in("swing phi pendulum pend pole theta th angle ang alpha bob winkel encoder")
RATES = words_in("gyro gyroscope omega phidot thetadot dtheta")
HEIGHT = words_in("z height")
DERIVATIVE = {"v": ("swing_rate", "gripper_v"), "a": ("", "gripper_a")}
UPSIDE_DOWN = 0.5
"""rad; within it of half a turn, the mean of an angle shows that it is not counted from hanging."""
FARTHEST = 10.0
"""m beyond which a position is in mm."""
FASTEST = 10.0 * TURNS
"""rad/s beyond which a swing's rate is in degrees."""


def pendulum_entries(labels: Mapping[str, Label], columns: Mapping[str, Sequence[Column]]) -> dict[str, Entry]:
    """The channels that headers seem to be; the first column of a kind counts.

    Args:
        labels: by column.
        columns: of one or more recordings.
    """
    entries: dict[str, Entry] = {}
    swings = any(set(label.words) & SWING for label in labels.values())
    for name, label in labels.items():
        channel = "" if COMMANDED & set(label.words) else _channel(label, swings)
        if channel and channel not in {entry.channel for entry in entries.values()}:
            entries[name] = _entry(channel, label, columns[name])
    return entries


def _channel(label: Label, swings: bool) -> str:
    words, quantity = set(label.words), label.quantity
    if words & RATES:
        return "swing_rate"
    rate, pivot = DERIVATIVE.get(quantity, ("swing_angle", "gripper_x"))
    if words & FORCE and quantity in ("", "force", "tau"):
        return "load_force"
    if words & PIVOT:
        return "gripper_z" if words & HEIGHT and quantity in ("", "q") else pivot
    if words & SWING or (quantity and label.unit and _turns(label.unit)):
        return rate
    if swings and ("x" in words or (quantity in ("q", "v") and len(label.words) == 1)):
        return pivot
    return ""


def _turns(unit: str) -> bool:
    return any(is_unit(unit, kind) and "m" not in unit for kind in ("q", "v"))


def _entry(channel: str, label: Label, columns: Sequence[Column]) -> Entry:
    si, most = channel_kind(channel).units[0], largest(columns)
    unit, why = label.unit, "unit as written"
    if not unit:
        unit, why = si, f"up to {most:.4g}; CHECK: unit assumed"
        if most > {"rad": TURNS, "rad/s": FASTEST}.get(si, np.inf):
            unit, why = si.replace("rad", "deg"), f"up to {most:.4g}"
        elif si == "m" and most > FARTHEST:
            unit = "mm"
    if channel == "swing_angle":
        mean = float(np.nanmean(np.concatenate([column.value for column in columns]))) * si_factor(unit, "rad")
        if abs(abs(mean) - np.pi) < UPSIDE_DOWN:
            why += "; CHECK: it hangs at half a turn; 0 is hanging, give an offset"
    return Entry(channel, unit, why=why)
