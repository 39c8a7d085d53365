"""What drives read while they work: by their own errors the torque that they ask for, and what they were told with it.

A command holds until its next stamp, or is approached no faster than the drive's `rate`. Between stamps it steps, at a
moment that the delay moves: what was told is a mean around each time, smooth in the delay.
"""

from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from armdyn.arm.drives import TOLD, Servo
from armdyn.arm.motion import measured_motion
from armdyn.kept import cached_with_first_argument
from armdyn.recording.channels import Channel, Reading
from armdyn.run import Run

TIMED = 2e-4
"""s by which a delay is usually off that recordings say: the median of 40 generated arms."""
INFORMATIVE = (0.1, 0.9)
"""Quantiles of a reading that differ where it says anything: a joint that stands reads one value, but for a few."""


def mean_held(channel: Channel, edges: np.ndarray) -> np.ndarray:
    """(n,) means between (n + 1,) rising times of what holds from its stamp to the next one, smooth in the times."""
    return _mean(channel.time, channel.value, np.append(np.zeros(len(channel) - 1), 0.0), edges)


def mean_told(run: Run, joint: str, servo: Servo, edges: np.ndarray) -> np.ndarray:
    """(n,) means between (n + 1,) rising times, less its delay, of what a drive of a run is told, as it follows it."""
    name = f"{TOLD[servo.law]}.{joint}"
    if servo.law == "position" and np.isfinite(servo.rate):
        return _mean(*_followed(run, name, servo.rate), edges)
    return mean_held(run.channels[name], edges)


def _mean(time: np.ndarray, value: np.ndarray, slope: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(n,) means between (n + 1,) times of what begins at each (m,) time with a value and changes with a slope."""
    lasts = np.diff(time)
    area = np.concatenate([[0.0], np.cumsum(lasts * (value[:-1] + 0.5 * slope[:-1] * lasts))])
    inside = np.clip(edges, time[0], time[-1])
    i = np.clip(np.searchsorted(time, inside, "right") - 1, 0, len(time) - 1)
    since = inside - time[i]
    whole = area[i] + since * (value[i] + 0.5 * slope[i] * since)
    whole += np.where(edges < time[0], value[0] * (edges - time[0]), 0.0)
    whole += np.where(edges > time[-1], value[-1] * (edges - time[-1]), 0.0)
    return np.asarray(np.diff(whole) / np.diff(edges))


@cached_with_first_argument
def _followed(run: Run, name: str, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(m,) times, values and slopes of what approaches a command no faster than `rate`."""
    told = run.channels[name]
    at, rows = float(told.value[0]), list[tuple[float, float, float]]()
    ends = [*told.time[1:].tolist(), np.inf]
    for begin, end, wanted in zip(told.time.tolist(), ends, told.value.tolist(), strict=True):
        arrives = begin + abs(wanted - at) / rate
        if arrives > begin:
            slope = rate if wanted > at else -rate
            rows.append((begin, at, slope))
            at = wanted if arrives < end else at + slope * (end - begin)
        if arrives < end:
            rows.append((arrives, wanted, 0.0))
    time, value, slope = np.array(rows).T
    return time, value, slope


def reads(run: Run, joint: str, servo: Servo) -> bool:
    """Whether a run holds what a drive's reading is made of, and no measured torque."""
    return f"tau.{joint}" not in run.channels and f"{TOLD[servo.law]}.{joint}" in run.channels


def around(time: np.ndarray) -> np.ndarray:
    """(n + 1,) edges of (n,) times: half way to their neighbours."""
    middles = 0.5 * (time[1:] + time[:-1])
    return np.concatenate([[2.0 * time[0] - middles[0]], middles, [2.0 * time[-1] - middles[-1]]])


def error(
    run: Run, joints: tuple[str, ...], joint: str, servo: Servo, delay: float, time: np.ndarray, *, smooth: bool
) -> np.ndarray:
    """(n,) what a drive reads at (n,) times before its gain, its share of the torque and its limit.

    Args:
        run: a recording.
        joints: all joints of the arm.
        joint: which.
        servo: its drive.
        delay: s.
        time: (n,) s.
        smooth: whether a position is taken as smoothed rather than as recorded.
    """
    edges = around(time)
    told = mean_told(run, joint, servo, edges - delay)
    if servo.law == "position" and not smooth:
        q = run.channels[f"q.{joint}"]
        at = [np.interp(t, q.time, q.value) for t in (edges[:-1], time, edges[1:])]
        return told - 0.25 * (at[0] + 2.0 * at[1] + at[2])
    if servo.law in ("position", "velocity"):
        motion = measured_motion(run, joints)
        curve = motion.joints[joints.index(joint)].curve
        ends, inner = (curve(np.clip(t, motion.start, motion.end), 0)[:, 0] for t in (edges, time))
        if servo.law == "velocity":
            return told - np.diff(ends) / np.diff(edges)
        return told - (ends[:-1] + 4.0 * inner + ends[1:]) / 6.0  # Simpson's rule
    return told


@cached_with_first_argument
def with_readings(run: Run, joints: tuple[str, ...], servos: tuple[Servo, ...]) -> Run:
    """The run with `tau.<joint>` of the drives that recorded no torque.

    Args:
        run: a recording.
        joints: all joints of the arm.
        servos: with their gains and delays.
    """
    channels = dict(run.channels)
    for servo in servos:
        for joint in servo.joints:
            if reads(run, joint, servo) and servo.gain is not None and f"q.{joint}" in run.channels:
                found = _reading(run, joints, joint, servo)
                channels |= {} if found is None else {f"tau.{joint}": found}
    return run if len(channels) == len(run.channels) else replace(run, channels=channels)


def _reading(run: Run, joints: tuple[str, ...], joint: str, servo: Servo) -> Reading | None:
    """What the drive of one joint read; None where it was told nothing."""
    assert servo.gain is not None
    q, late = run.channels[f"q.{joint}"], servo.delay or 0.0
    share, scale = servo.gate(run, joint, q.time)
    by_error = scale * servo.gain.value * error(run, joints, joint, servo, late, q.time, smooth=False)
    asked = by_error
    velocity = np.zeros(len(q))
    if servo.law == "position" and f"v_cmd.{joint}" in run.channels:
        velocity = mean_held(run.channels[f"v_cmd.{joint}"], around(q.time) - late)
    if servo.damping and servo.law == "position":
        v = measured_motion(run, joints).at(q.time).v[:, joints.index(joint)]
        asked = asked + servo.damping * (velocity - v)
    given = share * np.clip(asked, -servo.largest, servo.largest)
    if not np.ptp(np.quantile(given, INFORMATIVE)) > 0.0:
        return None
    slope = np.gradient(asked, q.time)
    std = (servo.gain.std or 0.0) if servo.unloaded is None else servo.unloaded
    off = np.hypot(servo.determined * std / servo.gain.value * given, TIMED * slope)
    by_command = np.gradient(mean_told(run, joint, servo, around(q.time) - late), q.time)
    rate = np.where(np.abs(asked) < servo.largest, share * scale * servo.gain.value * by_command, 0.0)
    total = cumulative_trapezoid(given, q.time, initial=0.0)
    # What effects are made of has not the noise of what they are to predict.
    smooth = scale * servo.gain.value * error(run, joints, joint, servo, late, q.time, smooth=True)
    known = share * np.clip(smooth + asked - by_error, -servo.largest, servo.largest)
    told = np.array([known, rate, total, velocity, servo.over_reference(run, joint, q.time)])
    unit = "N" if q.unit == "m" else "N m"
    return Reading(q.time, given, unit, float(np.sqrt(np.mean((share * off) ** 2))), told)
