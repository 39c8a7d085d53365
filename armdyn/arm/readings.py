"""Compute the torque of servo drives from their recorded commands and positions.

A command holds until the next one, or is followed with the drive's largest speed `rate`. It steps at moments that the
delay shifts, so commands are averaged around each time, which makes them smooth in the delay.
"""

from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from armdyn.arm.control_laws import DriveSignals
from armdyn.arm.drives import Servo
from armdyn.arm.motion import measured_motion
from armdyn.errors import InputError
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.channels import DriveReading, SampleError
from armdyn.run import Run

IDENTIFIED_DELAY_STD_SECONDS = 2e-4
"""Usual error of an identified delay, s: the median of 40 generated arms."""
INFORMATIVE_READING_QUANTILES = (0.1, 0.9)
"""Quantiles of a reading that differ where it contains information: a joint at rest has one value, but for a few."""


def mean_command(run: Run, joint: str, servo: Servo, edges: np.ndarray) -> np.ndarray:
    """(n,) mean command that a drive follows in the n intervals between (n + 1,) times `edges`, s."""
    if servo.control.holds_position and np.isfinite(servo.rate):
        return _mean(*_followed(run, servo.command(joint), servo.rate), edges)
    return run.channels[servo.command(joint)].mean_zero_order_hold_values(edges)


def _mean(time: np.ndarray, value: np.ndarray, slope: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(n,) means between (n + 1,) times of a signal with a value and a slope from each of (m,) times on."""
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
    """(m,) times, values and slopes of a setpoint that approaches a command with the speed `rate`."""
    command = run.channels[name]
    at, rows = float(command.value[0]), list[tuple[float, float, float]]()
    ends = [*command.time[1:].tolist(), np.inf]
    for begin, end, wanted in zip(command.time.tolist(), ends, command.value.tolist(), strict=True):
        arrives = begin + abs(wanted - at) / rate
        if arrives > begin:
            slope = rate if wanted > at else -rate
            rows.append((begin, at, slope))
            at = wanted if arrives < end else at + slope * (end - begin)
        if arrives < end:
            rows.append((arrives, wanted, 0.0))
    time, value, slope = np.array(rows).T
    return time, value, slope


def is_read_from_commands(run: Run, joint: str, servo: Servo) -> bool:
    """Whether a run contains the command or current of a joint's drive, but no measured torque."""
    return f"tau.{joint}" not in run.channels and servo.command(joint) in run.channels


def _midpoints(time: np.ndarray) -> np.ndarray:
    """(n + 1,) edges of intervals around (n,) times."""
    middles = 0.5 * (time[1:] + time[:-1])
    return np.concatenate([[2.0 * time[0] - middles[0]], middles, [2.0 * time[-1] - middles[-1]]])


def drive_error(
    run: Run, joints: tuple[str, ...], joint: str, servo: Servo, delay: float, time: np.ndarray, *, smooth: bool
) -> np.ndarray:
    """(n,) error of a drive at (n,) times, before gain, gate and limit.

    Args:
        run: a recording.
        joints: all joints of the arm.
        joint: joint of the drive.
        servo: the drive.
        delay: delay of the command, s.
        time: (n,) times, s.
        smooth: whether the smoothed position is used instead of the recorded one.
    """
    edges = _midpoints(time)
    command = mean_command(run, joint, servo, edges - delay)
    return servo.control.error(command, *_sensed_motion(run, joints, joint, servo, time, smooth=smooth))


def _sensed_motion(
    run: Run, joints: tuple[str, ...], joint: str, servo: Servo, time: np.ndarray, *, smooth: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) positions and velocities that a drive feeds back around (n,) times; see `drive_error`."""
    q, v, edges, senses = np.zeros(len(time)), np.zeros(len(time)), _midpoints(time), servo.control.senses
    if senses == "position" and not smooth:
        recorded = run.channels[f"q.{joint}"]
        at = [np.interp(t, recorded.time, recorded.value) for t in (edges[:-1], time, edges[1:])]
        q = 0.25 * (at[0] + 2.0 * at[1] + at[2])
    if not senses:
        return q, v
    motion = measured_motion(run, joints)
    curve = motion.joints[joints.index(joint)].curve
    if smooth or senses == "velocity":
        ends, inner = (curve(np.clip(t, motion.start, motion.end), 0)[:, 0] for t in (edges, time))
        if senses == "velocity":
            return q, np.diff(ends) / np.diff(edges)
        q = (ends[:-1] + 4.0 * inner + ends[1:]) / 6.0  # Simpson's rule
    if senses == "position" and servo.damping:
        v = curve(np.clip(time, motion.start, motion.end), 1)[:, 0]
    return q, v


def drive_signals(run: Run, joint: str, servo: Servo, time: np.ndarray, edges: np.ndarray) -> DriveSignals:
    """Signals of a drive at (n,) times; each is (n,) or a constant.

    Args:
        run: a recording.
        joint: joint of the drive.
        servo: the drive, with a gain.
        time: (n,) times, s.
        edges: (n + 1,) edges of intervals around them, delayed, over which commands are averaged, s.
    """
    assert servo.gain is not None
    share, scale = servo.torque_share(run, joint, time)
    beside = {"feed": f"tau_ff.{joint}"} | ({"velocity": f"v_cmd.{joint}"} if servo.control.holds_position else {})
    told = {
        name: run.channels[channel].mean_zero_order_hold_values(edges)
        for name, channel in beside.items()
        if channel in run.channels and channel != servo.command(joint)
    }
    return DriveSignals(
        command=mean_command(run, joint, servo, edges),
        limit=servo.largest,
        share=share,
        gain=scale * servo.gain.value,
        damping=servo.damping,
        **told,
    )


@cached_with_first_argument
def with_servo_torques(run: Run, joints: tuple[str, ...], servos: tuple[Servo, ...]) -> Run:
    """The run with torques `tau.<joint>` computed for drives without a recorded torque; `joints` are all joints."""
    channels = dict(run.channels)
    for servo in servos:
        for joint in servo.joints:
            if is_read_from_commands(run, joint, servo) and servo.gain is not None and f"q.{joint}" in run.channels:
                try:
                    found = _reading(run, joints, joint, servo, servo.gain.value, servo.gain.std or 0.0)
                except SampleError as error:
                    said = (
                        f"{run.source or run.name}: with the drive's gain of {servo.gain.value:.4g} {servo.gain.unit}"
                    )
                    size = error.fault.partition(" is beyond")[0]
                    raise InputError(
                        f"{said}, {servo.command(joint)} and q.{joint} give {size}, more than any arm has: check the "
                        "gain under [drives], and the columns' units"
                    ) from error
                channels |= {} if found is None else {f"tau.{joint}": found}
    return run if len(channels) == len(run.channels) else replace(run, channels=channels)


def _reading(
    run: Run, joints: tuple[str, ...], joint: str, servo: Servo, gain: float, gain_std: float
) -> DriveReading | None:
    """Reading of one drive; None where its command is constant."""
    q, delay = run.channels[f"q.{joint}"], servo.delay or 0.0
    edges = _midpoints(q.time) - delay
    law, signals = servo.control, drive_signals(run, joint, servo, q.time, edges)
    moved, smooth_moved = (_sensed_motion(run, joints, joint, servo, q.time, smooth=smooth) for smooth in (False, True))
    wanted = law.unlimited_torque(signals, *moved)
    given, smooth_given = (law.torque(signals, *motion) for motion in (moved, smooth_moved))
    if not np.ptp(np.quantile(given, INFORMATIVE_READING_QUANTILES)) > 0.0:
        return None
    std = gain_std if servo.unloaded is None else servo.unloaded
    off = np.hypot(servo.determined * std / gain * given, IDENTIFIED_DELAY_STD_SECONDS * np.gradient(wanted, q.time))
    by_command = signals.share * signals.gain * np.gradient(signals.command, q.time)
    rate = np.where(np.abs(wanted) < servo.largest, by_command, 0.0)
    total = cumulative_trapezoid(law.integrand(signals, *moved), q.time, initial=0.0)
    # Effects are functions of the smooth torque: otherwise they would contain the noise of what they predict.
    velocity, voltage = np.zeros(len(q)) + signals.velocity, servo.relative_excess_voltage(run, joint, q.time)
    told = np.array([smooth_given, rate, total, velocity, voltage])
    unit = "N" if q.unit == "m" else "N m"
    return DriveReading(q.time, given, unit, float(np.sqrt(np.mean((signals.share * off) ** 2))), told)
