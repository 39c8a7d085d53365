r"""Identify unknown gains, delays and saturation of servo drives from recordings.

With the servo's error e on the left and the physics on the right, both low-passed,

    e(t - d) = c [T(q, v, a) + P(q, v, a) m] + D v + I a + (F + mu |T| + S exp(-(v/v_s)^2)) sign(v) + b,      c = 1/k,

where m are the ten inertial parameters of an unknown load on the last link, and P is its regressor. The equation is
linear except for the product c m; frictions and inertias are not negative. The noise is in the error: on the right-hand
side it would bias the gain towards zero.

- **Delay**: the d for which all joints of a kind of drives together have the smallest residual.
- **Saturation**: drives beyond their limit give the torque of a smaller error s. The s for which the physics leaves the
  smallest share of the clipped error is used; larger errors are left out.
- **Gain**: only the weight of known masses determines c. Where a joint's motion does not show it, joints with the same
  kind of drive do. An unknown load looks like a gain where few joints carry it, so the reported standard deviation
  includes a usual load, as far as the recordings do not exclude one.
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from armdyn.arm.arm import Arm
from armdyn.arm.control_laws import CONTROL_LAWS
from armdyn.arm.drive_gain.joint_fit import compliances
from armdyn.arm.drive_gain.joint_readings import DriveReadings, JointReadings
from armdyn.arm.drives import Servo, gain_unit
from armdyn.arm.readings import is_read_from_commands
from armdyn.errors import InputError
from armdyn.recording.units import KnownQuantity
from armdyn.run import Run

DRIVE_DELAYS_TRIED_SECONDS, DRIVE_DELAY_TOLERANCE_SECONDS = np.arange(0.0, 0.0651, 0.0025), 5e-5
"""Delays that are tried, s, and the accuracy of the best one: a delay of a millisecond looks like an inertia of the
rotor of a millisecond times the gain (velocity command), or like as much friction (position command)."""
SATURATING_ERROR_QUANTILES_TRIED, SATURATING_ERROR_TOLERANCE_SHARE = np.linspace(0.3, 1.0, 15), 1e-3
"""Quantiles of the errors that are tried as the saturating error, and the accuracy of the best one, as a share of the
largest error. Nothing else is identifiable of a drive that is at its limit most of the time."""
ENTROPY_POWER_PER_SQUARED_MEAN_ABS = np.pi**2 * np.e
"""(2 pi e) (pi / 2): squared exponential of a normal density's entropy, over the square of its mean absolute value."""
MAX_IDENTIFIED_GAIN_RELATIVE_STD = 0.1
"""Relative standard deviation of 1/k below which a gain is identifiable. On recordings of an SO-101, joints under the
load of gravity have 1 to 4 %, the others 30 % and more."""


def drives_with_identified_gains(drives: Mapping[str, Servo], arm: Arm, runs: Sequence[Run]) -> dict[str, Servo]:
    """The drives with their unknown gains, delays and saturations identified from recordings.

    Raises:
        InputError: the recordings determine no gain.
    """
    for name, servo in drives.items():
        for run in runs:
            _require_command(name, servo, run)
    found, rows = {name: _with_reference(servo, runs) for name, servo in drives.items()}, list[JointReadings]()
    for name, servo in list(found.items()):
        kind = DriveReadings(
            name,
            arm,
            runs,
            [joint for joint in servo.joints if any(is_read_from_commands(run, joint, servo) for run in runs)],
        )
        known = servo.gain is not None and servo.gain.std is None and servo.delay is not None
        if kind.joints and not (known and np.isfinite(servo.saturating)):
            timed = _with_delay(kind, servo)
            if not np.isfinite(servo.saturating) and (full_at := _saturation(kind, timed)) < np.inf:
                timed = _with_delay(kind, replace(timed, full_at=full_at))
            found[name] = replace(timed, full_at=servo.full_at if np.isfinite(servo.limit) else timed.full_at)
            rows += [row for row in kind.of_joints(timed) if row.noise > 0.0]
    if not rows:
        return found
    gains = {name: found[name].gain for name in dict.fromkeys(row.drive for row in rows)}
    for name, (compliance, std, loaded_std) in compliances(rows, gains).items():
        servo = found[name]
        if servo.gain is not None and servo.gain.std is None:
            continue
        unit = gain_unit(servo.law, arm.sliding[servo.joints[0]])
        if not 0.0 < std < compliance:
            raise InputError(
                f"[drives.{name}]: without its gain every value would be a ratio to it, and no joint of "
                f"{', '.join(servo.joints)} moves a known weight against gravity far enough to tell: write gain = "
                f'"... {unit}", or {recordings_that_identify_gains(arm, servo.joints)}'
            )
        stated = (
            servo.gain is not None and (servo.gain.std or 0.0) <= MAX_IDENTIFIED_GAIN_RELATIVE_STD * servo.gain.value
        )
        gain, relative = 1.0 / compliance, std / compliance
        found[name] = replace(
            servo,
            gain=KnownQuantity(gain, loaded_std / compliance * gain, unit),
            unloaded=relative * gain,
            determined=stated or relative < MAX_IDENTIFIED_GAIN_RELATIVE_STD,
        )
    return found


def _require_command(name: str, servo: Servo, run: Run) -> None:
    """Refuse a recording with commands of a kind of drive that are all of another law than the drive's.

    Raises:
        InputError: the recording has neither a torque nor the command of any of these joints, but another command.
    """
    if any(f"tau.{joint}" in run.channels or servo.command(joint) in run.channels for joint in servo.joints):
        return
    others = {
        law: control.channel
        for law, control in CONTROL_LAWS.items()
        if any(f"{control.channel}.{joint}" in run.channels for joint in servo.joints)
    }
    if others:
        law, channel = next(iter(others.items()))
        raise InputError(
            f'{run.source or run.name}: [drives.{name}] has law = "{servo.law}", whose command is '
            f"{servo.control.channel}.<joint>, and the recording holds {channel} of its joints alone: record "
            f'{servo.control.channel}, or write law = "{law}" if this is what the drive follows'
        )


def _with_reference(servo: Servo, runs: Sequence[Run]) -> Servo:
    """Drives with the mean voltage of their recordings, unless a voltage is stated."""
    volts = [run.channels[n].value for run in runs for j in servo.joints if (n := f"voltage.{j}") in run.channels]
    if not volts or servo.supply is not None or servo.reference is not None:
        return servo
    return replace(servo, reference=float(np.mean(np.abs(np.concatenate(volts)))))


def recordings_that_identify_gains(arm: Arm, joints: Sequence[str]) -> str:
    """Describe recordings that would make the gain of these joints' drives identifiable."""
    heavy = " or ".join(joints)
    described = shlex.join(["--robot", arm.robot.name] if arm.file is None else ["--urdf", str(arm.file)])
    return (
        f"record a known load on the last link, written into the description, or {heavy} lifting the arm's own weight "
        f"through its range: armdyn excite {described} --for torque_gain:{','.join(joints)} --output lift.csv"
    )


def _with_delay(kind: DriveReadings, servo: Servo) -> Servo:
    """Drives with the delay for which all their joints together have the smallest residual, unless it is known."""
    if servo.delay is not None:
        return servo

    def cost(delay: float) -> float:
        rows = kind.of_joints(replace(servo, delay=delay))
        return float(sum(np.log(row.square) for row in rows if row.square > 0.0))

    return replace(servo, delay=_minimum(cost, DRIVE_DELAYS_TRIED_SECONDS, DRIVE_DELAY_TOLERANCE_SECONDS))


def _saturation(kind: DriveReadings, servo: Servo) -> float:
    """The saturating error; infinite where saturation does not make the errors more probable.

    It minimises the residual as a share of the clipped errors: errors clipped at zero leave no residual, but contain no
    information. Below it errors have the probability of their residual, beyond it any size up to the largest is equally
    probable.
    """
    unlimited, sizes = (
        kind.of_joints(replace(servo, full_at=np.inf), clipped=True),
        [kind.error_sizes(servo, j) for j in kind.joints],
    )
    count = [len(row.y) * row.square / row.noise**2 if row.square > 0.0 else 0.0 for row in unlimited]

    def cost(full_at: float) -> float:
        rows = kind.of_joints(replace(servo, full_at=full_at), clipped=True)
        return float(
            np.array(count) @ np.log([min(r.square / np.var(r.y), 1.0) if r.square > 0.0 else 1.0 for r in rows])
        )

    every = np.concatenate(sizes)
    best = _minimum(
        cost,
        np.quantile(every, SATURATING_ERROR_QUANTILES_TRIED),
        SATURATING_ERROR_TOLERANCE_SHARE * float(every.max()),
    )
    gained, limited = 0.0, kind.of_joints(replace(servo, full_at=best), clipped=True)
    for without, row, size in zip(unlimited, limited, sizes, strict=True):
        if row.square > 0.0 and without.square > 0.0:
            beyond = float(np.mean(size > best))
            nats = 0.5 * np.log(ENTROPY_POWER_PER_SQUARED_MEAN_ABS * without.square)
            nats -= 0.5 * (1.0 - beyond) * np.log(ENTROPY_POWER_PER_SQUARED_MEAN_ABS * row.square)
            nats -= beyond * np.log(max(float(size.max()) - best, np.finfo(float).tiny)) if beyond else 0.0
            gained += len(row.y) * row.square / row.noise**2 * nats
    return best if gained > 0.5 * np.log(max(sum(count), 1.0)) else np.inf


def _minimum(cost: Callable[[float], float], tried: np.ndarray, tolerance: float) -> float:
    """Minimum of a cost near the best of (n,) increasing values."""
    i = int(np.argmin([cost(float(value)) for value in tried]))
    bounds = float(tried[max(i - 1, 0)]), float(tried[min(i + 1, len(tried) - 1)])
    # Bounds of the coefficients give the cost a kink: no parabola.
    return float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": tolerance}).x)
