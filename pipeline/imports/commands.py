"""Columns that say what joints were told: found beside measurements, or in a file of their own."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import Channel
from pipeline.imports.claims import best_claims
from pipeline.imports.joint_claims import joint_claims, labels_of_joints
from pipeline.imports.joints import RobotJoints
from pipeline.imports.mapping import ColumnEntry
from pipeline.imports.units import joined_doubts
from pipeline.imports.words import ColumnHeaderParts

LEROBOT_COMMAND = "action"
"""LeRobot's name of the commands."""
COMMAND_OF = {"q": "q_cmd", "v": "v_cmd", "tau": "tau_ff"}
"""Quantity of the command of each measured quantity."""
LONG_HOLD = 0.1
"""Share of a recording after its last command from which the answer says so; recordings usually end with a command."""


def command_entries(
    labels: Mapping[str, ColumnHeaderParts],
    entries: Mapping[str, ColumnEntry],
    known: RobotJoints,
    texts: Mapping[str, str],
) -> dict[str, ColumnEntry]:
    """Mapping entries of the commanded positions and speeds of joints whose positions are measured.

    Args:
        labels: parsed headers by column; those of commands become entries.
        entries: entries of the measured columns.
        known: joints of the robot.
        texts: text of columns of text, see `ForeignRecording`.
    """
    by_channel = {entry.channel: entry for entry in entries.values()}
    arm = tuple(entry.joint for entry in by_channel.values() if entry.quantity == "q")
    commands = {}
    for name, label in labels.items():
        if label.commanded:
            is_action = re.split(r"[/.]", name, maxsplit=1)[0] == LEROBOT_COMMAND
            commands[name] = replace(label, measured=True, quantity=label.quantity or "q" * is_action)
    of_joints = labels_of_joints(commands, replace(known, arm=known.arm or arm))
    found = {}
    for claim in best_claims(joint_claims(of_joints, replace(known, arm=arm), texts)):
        quantity, _, joint = claim.channel.partition(".")
        position, channel = by_channel.get(f"q.{joint}"), f"{COMMAND_OF.get(quantity)}.{joint}"
        if quantity not in ("q", "v") or position is None or channel in by_channel:
            continue
        unit = claim.label.unit or position.unit + ("/s" if quantity == "v" else "")
        same = position if quantity == "q" else ColumnEntry("", sign=position.sign, gear_ratio=position.gear_ratio)
        why = "the joint's command" + (", in its position's unit" if not claim.label.unit else "")
        doubts = position.check.split("; ") if quantity == "q" and not claim.label.unit else []
        found[claim.column] = replace(
            same, channel=channel, unit=unit, check=joined_doubts([*doubts, *claim.doubts]), why=why
        )
    return found


def as_command(entry: ColumnEntry) -> ColumnEntry:
    """Entry of the same column in a file of commands: its position is the commanded one.

    Raises:
        InputError: nothing commands this quantity.
    """
    if entry.quantity in COMMAND_OF.values():
        return entry
    if entry.quantity not in COMMAND_OF:
        raise InputError(f"{entry.channel} is not a command: a file of commands has {_KINDS}")
    return replace(entry, channel=f"{COMMAND_OF[entry.quantity]}.{entry.joint}")


_KINDS = "q_cmd.<joint>, v_cmd.<joint> or tau_ff.<joint>"


def with_commands(
    measured: Mapping[str, Channel], told: Mapping[str, Channel], name: str
) -> tuple[dict[str, Channel], list[str]]:
    """Channels of a recording with the commands of another file, which has stamps of its own on the same clock.

    A command holds until the next one. The last one before the first measurement is therefore the first command, at
    most one usual step of the commands earlier; commands before it, or after the last measurement, are left out.

    Args:
        measured: channels of the recording, times in s.
        told: channels of the file of commands, times in s.
        name: name of the file of commands, for messages.

    Returns:
        All channels, and sentences on stretches without a new command.

    Raises:
        InputError: the clocks do not overlap, a channel is in both files, or is not a command.
    """
    begin = min(channel.time[0] for channel in measured.values())
    end = max(channel.time[-1] for channel in measured.values())
    found, notes = dict(measured), list[str]()
    for channel, commands in told.items():
        if channel.partition(".")[0] not in COMMAND_OF.values():
            raise InputError(f"{channel} is not a command: a file of commands has {_KINDS}")
        if channel in measured:
            raise InputError(f"{channel} is also in the file of measurements: leave it out of one")
        first, last = float(commands.time[0]), float(commands.time[-1])
        if last < begin or first > end:
            raise InputError(
                f"{channel} was commanded from {first:.6g} to {last:.6g} s, and what was measured is from {begin:.6g} "
                f"to {end:.6g} s: stamp both with one clock, or state the difference with 'late' in a mapping"
            )
        inside = commands.time <= end
        inside[: max(np.searchsorted(commands.time, begin, side="right") - 1, 0)] = False
        time, value = commands.time[inside], commands.value[inside]
        if time[0] < begin:
            time[0] = max(time[0], begin - np.median(np.diff(commands.time)))
        found[channel] = Channel(time, value, commands.unit)
        if first > begin:
            notes.append(f"{name}: the first {channel} comes {first - begin:.3g} s after the first measurement")
        if end - last > LONG_HOLD * (end - begin):
            notes.append(f"{name}: the last {channel} holds for the last {end - last:.3g} s")
    return found, notes
