"""Check without a model that joints follow their commands: in another unit, or the wrong way, a command is no command.

A joint under a position or velocity loop follows its command late, with an error that is small beside its motion:

    q(t) = s c(t - d) + o,       c the commanded position, or the integral of the commanded velocity,

with s = 1 if both have the stated unit and sense. The delay d and the offset o, and of an integral a drift, are fitted.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from armdyn.inspection.check import Check, CheckKind, Severity
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.recording.channels import Channel
from armdyn.recording.noise import noise_std_from_differences
from armdyn.run import Run

TRIED_COMMAND_DELAYS_SECONDS = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.5)
"""Delays, s, with which a joint may follow its command."""
MIN_FOLLOWED_SAMPLES = 60
"""Least number of samples of a joint and of its command for a comparison."""
MIN_FOLLOWING_RANGE_STDS, MIN_FOLLOWING_RANGE = 20.0, 0.02
"""Least motion of a joint that shows which command it follows: in standard deviations of its noise, and in rad or m."""
MIN_UNEXPLAINED_SHARE_OF_NOT_FOLLOWED, MAX_UNEXPLAINED_SHARE_OF_FOLLOWED = 0.75, 0.25
"""Least share of the squares of a joint's motion that a command leaves unexplained which the joint does not follow as
stated, and largest share that one leaves which the joint follows in another unit or sense.

In 38 recordings of real servos, of which some hardly follow their commands, no joint that moved left less than 0.86
unexplained with a wrong unit or sign, and joints that follow leave 0 to 0.5 with the right one.
"""
FACTORS_OF_OTHER_UNITS: Mapping[str, tuple[str, float]] = {"rad": ("deg", np.pi / 180.0), "m": ("mm", 1e-3)}
"""The unit in which a command may be by mistake, and its size, by the unit of the position."""


def command_checks(run: Run) -> Iterator[Check]:
    """Findings on commands that their joints do not follow as stated, but do in another unit or the other way."""
    for joint in run.joints:
        position = run.channels[f"q.{joint}"]
        for name in (f"q_cmd.{joint}", f"v_cmd.{joint}"):
            command = run.channels.get(name)
            if command is None or min(len(command), len(position)) < MIN_FOLLOWED_SAMPLES or not _shows(position):
                continue
            yield from _checks_of(run, joint, name, position, command)


def _checks_of(run: Run, joint: str, name: str, position: Channel, command: Channel) -> Iterator[Check]:
    integral = name.startswith("v_cmd.")
    if unexplained_share(position, command, 1.0, integral) < MIN_UNEXPLAINED_SHARE_OF_NOT_FOLLOWED:
        return
    unit, size = FACTORS_OF_OTHER_UNITS[position.unit]
    tried = (-1.0, size, -size, 1.0 / size, -1.0 / size)
    shares = {factor: unexplained_share(position, command, factor, integral) for factor in tried}
    factor = min(shares, key=lambda s: shares[s])
    if shares[factor] > MAX_UNEXPLAINED_SHARE_OF_FOLLOWED:
        return
    per_s = "/s" if integral else ""
    kind: CheckKind = "position_sign" if factor == -1.0 else "angle_unit" if position.unit == "rad" else "scale"
    other_way = " and counts the other way" if factor < 0.0 else ""
    if factor == -1.0:
        said = f"{name} counts the other way than q.{joint}, which follows it"
        remedy = "turn the sign of the one that is wrong, in the mapping of the import or in the file"
    elif abs(factor) < 1.0:
        said = f"{name} is in {unit}{per_s}, not {command.unit}{other_way}: only so does q.{joint} follow it"
        remedy = f"write '{name} [{unit}{per_s}]' in the header"
    else:
        said = f"q.{joint} is in {unit}, not {position.unit}{other_way}: only so does it follow {name}"
        remedy = f"write 'q.{joint} [{unit}]' in the header"
    correction = Correction({name: CorrectedReading(name, factor)}) if 0.0 < factor < 1.0 else None
    if correction is not None:
        remedy = f"armdyn inspect {run.source or run.name} --fix fixed"
    yield Check(kind, Severity.WRONG, run.name, (name, f"q.{joint}"), said, remedy, correction=correction)


def _shows(position: Channel) -> bool:
    noise = noise_std_from_differences(position.time, position.value)
    return float(np.ptp(position.value)) > max(MIN_FOLLOWING_RANGE_STDS * noise, MIN_FOLLOWING_RANGE)


def unexplained_share(position: Channel, command: Channel, factor: float, integral: bool) -> float:
    """Share of the squares of a joint's motion that its command leaves unexplained, with the delay that suits best.

    Args:
        position: measured position.
        command: commanded position, or velocity, which holds until the next stamp.
        factor: factor on the command.
        integral: whether the command is a velocity, of which the position is the integral up to a drift.
    """
    smooth = np.vander((position.time - position.time.mean()) / np.ptp(position.time), 2 if integral else 1)
    smooth = np.linalg.qr(smooth)[0]

    def motion(values: np.ndarray) -> np.ndarray:
        return np.asarray(values - smooth @ (smooth.T @ values))

    moved = motion(position.value)
    if not moved.any():
        return 0.0
    left = []
    for delay in TRIED_COMMAND_DELAYS_SECONDS:
        told = command.zero_order_hold_values(position.time - delay)
        if integral:
            told = np.concatenate([[0.0], np.cumsum(told[:-1] * np.diff(position.time))])
        left.append(float(np.sum((moved - factor * motion(told)) ** 2)))
    return min(left) / float(moved @ moved)
