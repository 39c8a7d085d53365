r"""What recordings say of a drive itself: its gain, from the weight that it holds, and its delay.

A servo's error e stands on the left and the physics on the right, both low-passed:

    e(t - d) = c [T(q, v, a) + D v + I a + (F + mu |T|) sign(v) + b],      c = 1/k,

linear in c and its products, which are not negative; the delay d is the one that leaves least of all joints together.
The error is what is noisy: on the right its noise would shrink the gain towards zero. Only gravity, of masses that are
known, says how large c is: where the motion of a joint does not show it, joints with the same drive say it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

from armdyn.arm.arm import Arm
from armdyn.arm.drives import UNITS, Servo, error, reads
from armdyn.arm.motion import measured_motion
from armdyn.arm.rigid import inverse_dynamics
from armdyn.errors import InputError
from armdyn.kept import kept_alongside
from armdyn.linear.solve import scaled, solve_bounded
from armdyn.run import Run
from armdyn.units import Known

BAND = 6.0
"""Hz below which both sides are compared: arms that are told where to go hardly move faster."""
STEP = 0.004
"""s between the instants that are low-passed."""
THINNED = 10
"""Of these, of which one is kept: at this rate the low-pass leaves independent samples."""
CERTAIN = 0.9
"""Expected sign of a velocity from which its friction is known; below, samples are left out."""
DELAYS = np.arange(0.0, 0.0625, 0.0025)
"""s that are tried."""
DETERMINED = 0.1
"""Relative standard deviation of 1/k below which a joint says what it is. On recordings of an SO-101 joints that
gravity loads have 1 to 4 %, those that it does not 30 % and more."""
SATURATED = 0.95
"""Of the limit; beyond it a reading says nothing of the gain."""
LOAD, USUAL_LOSS = 4, 0.1
"""Column of the friction that grows with the load, and its usual size: without it, a joint that lifts as much as it
lowers would take any gain for any friction."""
ROUNDS = 3
"""In which the width of that friction follows the gain."""
ROUNDING = 1e-12
"""Of the columns' squares, for those that the motion does not show."""


@dataclass(frozen=True)
class _Said:
    """1/k of a joint by its own motion, its standard deviation, and the mean square of what is left."""

    compliance: float
    std: float
    left: float
    power: float


def settled(servo: Servo, arm: Arm, runs: Sequence[Run], name: str) -> Servo:
    """The drive with its gain and its delay, those that were not known from recordings.

    Raises:
        InputError: nothing says how large its gain is.
    """
    joints = [joint for joint in servo.joints if any(reads(run, joint, servo) for run in runs)]
    if not joints or (servo.gain is not None and servo.gain.std is None and servo.delay is not None):
        return servo
    tried = DELAYS if servo.delay is None else np.array([servo.delay])
    found = [{joint: _said(servo, arm, runs, joint, float(delay)) for joint in joints} for delay in tried]
    worth = [sum(np.log(said.left / said.power) for said in each.values() if said.power > 0.0) for each in found]
    best = int(np.argmin(worth))
    servo = replace(servo, delay=float(tried[best]))
    told = [said for said in found[best].values() if 0.0 < said.std < DETERMINED * said.compliance]
    unit = UNITS[servo.law][arm.slides[arm.joints.index(joints[0])]]
    weights, values = [1.0 / said.std**2 for said in told], [said.compliance for said in told]
    given = servo.gain
    if given is not None:
        if given.std is None:
            return servo
        weights.append(given.value**4 / given.std**2)
        values.append(1.0 / given.value)
    if not weights:
        raise InputError(
            f"[drives.{name}]: without its gain every value would be a ratio to it, and no joint of "
            f"{', '.join(joints)} moves a known weight against gravity far enough to tell: write gain = "
            f'"... {unit}", or record postures that lift a known load'
        )
    compliance = float(np.average(values, weights=weights))
    spread = float(np.sqrt(1.0 / sum(weights) + np.average((np.array(values) - compliance) ** 2, weights=weights)))
    return replace(servo, gain=Known(1.0 / compliance, spread / compliance**2, unit))


def _said(servo: Servo, arm: Arm, runs: Sequence[Run], joint: str, delay: float) -> _Said:
    parts = [_rows(run, arm, joint, servo, delay) for run in runs if reads(run, joint, servo)]
    X, y = np.vstack([X for X, _ in parts]), np.concatenate([y for _, y in parts])
    if len(y) <= X.shape[1] or not np.any(y):
        return _Said(0.0, np.inf, 1.0, 0.0)
    most, held, free = np.inf, 0.0, np.ones(X.shape[1], dtype=bool)
    for _ in range(ROUNDS):
        A = X.T @ X
        A[LOAD, LOAD] += held
        A += ROUNDING * max(float(np.trace(A)), ROUNDING) * np.eye(len(A))
        low = np.where(np.arange(len(A)) < len(A) - 1, 0.0, -np.inf)
        solution = solve_bounded(A, X.T @ y, low, np.inf)
        values, free = solution.x, solution.held == 0
        left = y - X @ values
        most = float(left @ left) / len(y) * _correlated(left)
        held = most / max(USUAL_LOSS * values[0], 1e-12) ** 2
    found = np.zeros(len(A))
    size, unit = scaled(A)
    found[free] = np.diag(np.linalg.inv(unit[np.ix_(free, free)])) / size[free] ** 2 * most
    return _Said(float(values[0]), float(np.sqrt(found[0])), float(left @ left) / len(y), float(y @ y) / len(y))


def _correlated(residual: np.ndarray) -> float:
    """Factor by which correlation of a residual enlarges a variance, its positive lags added up."""
    centred = residual - residual.mean()
    square, total = float(centred @ centred), 1.0
    for lag in range(1, min(60, len(centred) // 4)):
        share = float(centred[lag:] @ centred[:-lag]) / square
        if share < 0.05:
            break
        total += 2.0 * share
    return total


def _rows(run: Run, arm: Arm, joint: str, servo: Servo, delay: float) -> tuple[np.ndarray, np.ndarray]:
    """(n, 6) columns and (n,) errors of one joint in a run."""
    time, columns, known = _columns(run, arm, joint)
    share, scale = servo.gate(run, joint, time)
    reading = share * scale * error(run, arm.joints, joint, servo, delay, time)
    used = known & (
        _low(((share > 0.0) & (np.abs(reading) < SATURATED * share * servo.saturating)).astype(float)) > 0.95
    )
    return columns[used][::THINNED], _low(reading)[used][::THINNED]


@kept_alongside
def _columns(run: Run, arm: Arm, joint: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) times, (n, 6) columns of the physics, low-passed, and (n,) where the friction's sign is known."""
    motion, j = measured_motion(run, arm.joints), arm.joints.index(joint)
    time, torque = _bodies(run, arm)
    at = motion.at(time)
    way, load = at.direction[:, j], torque[:, j]
    columns = [load, at.v[:, j], at.a[:, j], way, way * np.abs(load), np.ones(len(time))]
    inner = (time > time[0] + 2.0 / BAND) & (time < time[-1] - 2.0 / BAND)
    return time, _low(np.column_stack(columns)), inner & (_low(np.abs(way)) > CERTAIN)


@kept_alongside
def _bodies(run: Run, arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    """(n,) times and (n, nj) torques of the arm as described."""
    motion = measured_motion(run, arm.joints)
    time = np.arange(motion.start, motion.end, STEP)
    at = motion.at(time)
    return time, inverse_dynamics(arm.model, at.q, at.v, at.a)


def _low(signal: np.ndarray) -> np.ndarray:
    sos = butter(2, BAND, fs=1.0 / STEP, output="sos")
    return np.asarray(sosfiltfilt(sos, signal, axis=0, padlen=min(len(signal) - 1, round(1.0 / STEP))))
