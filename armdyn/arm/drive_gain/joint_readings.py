"""Errors of the servos of one kind of drive, and the low-passed columns of the physics that explain them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from armdyn.arm.arm import Arm
from armdyn.arm.drives import Servo
from armdyn.arm.motion import measured_motion
from armdyn.arm.readings import drive_error, is_read_from_commands
from armdyn.arm.rigid import INERTIAL_PARAMETERS_PER_BODY, inverse_dynamics, torque_regressor
from armdyn.estimation.correlation import correlation_time
from armdyn.estimation.covariance import free_covariance
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.solve import BoundedSolution, solve_bounded
from armdyn.object_cache import cached_with_first_argument
from armdyn.run import Run

DRIVE_COMPARISON_CUTOFF_HZ = 6.0
"""Cut-off, Hz, of the low-pass for the servo's error and for the torque of the physics, which are compared:
position-controlled arms hardly move faster."""
LOW_PASSED_INTERVAL_SECONDS = 0.01
"""Interval of the samples that are low-passed."""
LOW_PASSED_SAMPLES_PER_KEPT = 4
"""Number of low-passed samples of which one is kept: at this rate the kept ones are independent."""
MIN_VELOCITY_SIGN_FOR_FRICTION = 0.9
"""Expected sign of a velocity from which its friction is known; other samples are left out."""
MAX_USED_SHARE_OF_SATURATING_ERROR = 0.95
"""Share of the saturating error beyond which a reading says nothing about the gain."""
LOAD_FRICTION_COLUMN, JOINT_OWN_COLUMN_COUNT = 4, 7
LOAD_COLUMNS = slice(JOINT_OWN_COLUMN_COUNT, JOINT_OWN_COLUMN_COUNT + INERTIAL_PARAMETERS_PER_BODY)
"""Columns: that of the friction in proportion to the load, the number of a joint's own, and those of the load."""
NONNEGATIVE_COLUMN_MASK = (True, True, True, True, True, False, True, True) + (INERTIAL_PARAMETERS_PER_BODY - 1) * (
    False,
)
"""Whether the coefficient of each column is not negative."""
FRICTION_FADING_SPEED = 0.1
"""Speed, rad/s or m/s, over which the friction near standstill fades."""
RELATIVE_ROUNDING = 1e-12
"""Ridge, as a share of a column's square, and size of a column, as a share of the largest, below which it is rounding:
that of gravity on a joint with a vertical axis."""
MIN_RESIDUAL_AUTOCORRELATION, MAX_RESIDUAL_CORRELATION_LAGS = 0.05, 60
"""Autocorrelation of a residual from which on it counts in the correlation time, and the largest number of lags."""


@dataclass(frozen=True, eq=False)
class JointReadings:
    """Readings of one joint's drive.

    Attributes:
        drive: name of the joint's kind of drive.
        X: (n, 17) columns of the physics: load, v, a, sign, load friction, offset, friction near standstill, carried.
        y: (n,) errors.
        part: (n,) index of the part of the recordings that contains each sample, ascending.
        square: square of the mean absolute residual of the joint's own regression; 0 without enough samples.
        noise: standard deviation of that residual, times the root of its correlation time.
        compliance: 1/k and its variance, from this joint alone.
    """

    drive: str
    X: np.ndarray
    y: np.ndarray
    part: np.ndarray
    square: float
    noise: float
    compliance: tuple[float, float]

    def equations(self, parts: int, std_factor: float) -> NormalEquations:
        """Sums over each of the `parts` of the recordings, with a factor on the noise."""
        return NormalEquations.of_groups(self.X, self.y, std_factor * self.noise, self.part, parts)


@dataclass(frozen=True, eq=False)
class DriveReadings:
    """Recordings of one kind of drive: its name, the arm, the runs, and the joints with readings in them."""

    name: str
    arm: Arm
    runs: Sequence[Run]
    joints: Sequence[str]

    def of_joints(self, servo: Servo, *, clipped: bool = False) -> list[JointReadings]:
        """Readings of every joint: without errors beyond saturation, or with such errors `clipped`."""
        return [self._of_joint(servo, joint, clipped) for joint in self.joints]

    def _of_joint(self, servo: Servo, joint: str, clipped: bool) -> JointReadings:
        X, y, part = [], [], []
        for number, run in enumerate(self.runs):
            if not is_read_from_commands(run, joint, servo):
                continue
            time, columns, known = _columns(run, self.arm, joint)
            share, reading = self._shared_error(servo, run, joint, time)
            most = share * servo.saturating
            within = (share > 0.0) & (clipped | (np.abs(reading) < MAX_USED_SHARE_OF_SATURATING_ERROR * most))
            used = np.flatnonzero(known & (_low_pass(within.astype(float)) > 0.95))[::LOW_PASSED_SAMPLES_PER_KEPT]
            X.append(columns[used])
            y.append(_low_pass(np.clip(reading, -most, most))[used])
            late = time[used] > 0.5 * (time[0] + time[-1])
            halves = np.where(late, 2 * number + 1, 2 * number)
            part.append(halves if len(self.runs) == 1 else np.full(len(late), number))
        every, read = np.vstack(X), np.concatenate(y)
        return JointReadings(self.name, every, read, np.concatenate(part), *_own_regression(every, read))

    def _shared_error(self, servo: Servo, run: Run, joint: str, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) share of a drive's torque at (n,) times, and (n,) that share of its error over the usual gain."""
        share, scale = servo.torque_share(run, joint, time)
        error = drive_error(run, self.arm.joints, joint, servo, servo.delay or 0.0, time, smooth=True)
        return share, share * scale * error

    def error_sizes(self, servo: Servo, joint: str) -> np.ndarray:
        """Absolute values of all errors of a joint."""
        runs = [run for run in self.runs if is_read_from_commands(run, joint, servo)]
        times = (_columns(run, self.arm, joint)[0] for run in runs)
        return np.concatenate(
            [np.abs(self._shared_error(servo, run, joint, t)[1]) for run, t in zip(runs, times, strict=True)]
        )


def _own_regression(X: np.ndarray, y: np.ndarray) -> tuple[float, float, tuple[float, float]]:
    """The last three attributes of `JointReadings`, from a regression of one joint alone."""
    if len(y) <= X.shape[1] or not np.any(y):
        return 0.0, 0.0, (0.0, np.inf)
    A = X.T @ X
    solution = _nonnegative(A, X.T @ y)
    residual = y - X @ solution.x
    lags = min(MAX_RESIDUAL_CORRELATION_LAGS, len(y) // 4)
    correlated = correlation_time([residual - residual.mean()], lags, MIN_RESIDUAL_AUTOCORRELATION)
    noise = float(np.sqrt(np.mean(residual**2) * correlated))
    compliance = float(solution.x[0]), float(variance(A, solution.on_bound == 0)[0]) * noise**2
    return float(np.mean(np.abs(residual)) ** 2), noise, compliance


def _nonnegative(A: np.ndarray, b: np.ndarray) -> BoundedSolution:
    """Least squares in which some unknowns are not negative; an unknown without information is 0."""
    return solve_bounded(A + np.diag(ridge(A)), b, np.where(NONNEGATIVE_COLUMN_MASK, 0.0, -np.inf), np.inf)


def ridge(A: np.ndarray) -> np.ndarray:
    """(P,) information that is added to unknowns of which a (P, P) matrix tells hardly more than rounding errors."""
    size = np.diag(A)
    shown = size > RELATIVE_ROUNDING**2 * size.max()
    return np.where(shown, RELATIVE_ROUNDING * size, 1.0)


def variance(A: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Diagonal of the inverse of the `free` part of an information matrix; infinite elsewhere."""
    use = free & (np.diag(A) > 0.0)
    return np.where(use, np.diag(free_covariance(A, use)), np.inf)


@cached_with_first_argument
def _columns(run: Run, arm: Arm, joint: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) times, (n, 17) low-passed columns of the physics, and (n,) where the friction's sign is known."""
    motion, j = measured_motion(run, arm.joints), arm.joints.index(joint)
    time, torque, carried = _bodies(run, arm)
    at = motion.at(time)
    way, load, v = at.direction[:, j], torque[:, j], at.v[:, j]
    fading = way * np.exp(-((v / FRICTION_FADING_SPEED) ** 2))
    own = [load, v, at.a[:, j], way, way * np.abs(load), np.ones(len(time)), fading]
    inner = (time > time[0] + 2.0 / DRIVE_COMPARISON_CUTOFF_HZ) & (time < time[-1] - 2.0 / DRIVE_COMPARISON_CUTOFF_HZ)
    return (
        time,
        _low_pass(np.column_stack([*own, carried[:, j]])),
        inner & (_low_pass(np.abs(way)) > MIN_VELOCITY_SIGN_FOR_FRICTION),
    )


@cached_with_first_argument
def _bodies(run: Run, arm: Arm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) times, (n, nj) torques of the described arm, (n, nj, 10) torques per inertial parameter of the last link."""
    motion = measured_motion(run, arm.joints)
    time = np.arange(motion.start, motion.end, LOW_PASSED_INTERVAL_SECONDS)
    at = motion.at(time)
    return time, inverse_dynamics(arm.model, at.q, at.v, at.a), torque_regressor(arm.model, at.q, at.v, at.a)[:, :, -1]


def _low_pass(signal: np.ndarray) -> np.ndarray:
    sos = butter(2, DRIVE_COMPARISON_CUTOFF_HZ, fs=1.0 / LOW_PASSED_INTERVAL_SECONDS, output="sos")
    return np.asarray(
        sosfiltfilt(sos, signal, axis=0, padlen=min(len(signal) - 1, round(1.0 / LOW_PASSED_INTERVAL_SECONDS)))
    )
