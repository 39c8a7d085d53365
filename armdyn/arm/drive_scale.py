r"""Identify unknown gains, delays and saturation of servo drives from recordings.

With the servo's error e on the left and the physics on the right, both low-passed,

    e(t - d) = c [T(q, v, a) + P(q, v, a) m] + D v + I a + (F + mu |T| + S exp(-(v/v_s)^2)) sign(v) + b,      c = 1/k,

where m are the ten inertial parameters of an unknown load on the last link, and P is its regressor. The equation is
linear except for the product c m, for which Gauss-Newton steps are taken; frictions and inertias are not negative. The
noise is in the error: on the right-hand side it would bias the gain towards zero.

- **Delay**: the d for which all joints of a kind of drives together have the smallest residual.
- **Saturation**: drives beyond their limit give the torque of a smaller error s. The s for which the physics leaves the
  smallest share of the clipped error is used; larger errors are left out.
- **Gain**: only the weight of known masses determines c. Where a joint's motion does not show it, joints with the same
  kind of drive do. An unknown load looks like a gain where few joints carry it, so the reported standard deviation
  includes a usual load, as far as the recordings do not exclude one.
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfiltfilt

from armdyn.arm.arm import Arm
from armdyn.arm.drives import Servo, gain_unit
from armdyn.arm.motion import measured_motion
from armdyn.arm.readings import drive_error, is_read_from_commands
from armdyn.arm.rigid import INERTIAL_PARAMETERS_PER_BODY, inverse_dynamics, torque_regressor
from armdyn.effects.joint import payload
from armdyn.errors import InputError
from armdyn.estimation.correlation import correlation_time
from armdyn.estimation.solve import BoundedSolution, inverse_positive, solve_bounded
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.units import KnownQuantity
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
MAX_USED_SHARE_OF_SATURATING_ERROR = 0.95
"""Share of the saturating error beyond which a reading says nothing about the gain."""
GAIN_STD_FACTOR_FOR_MODEL_ERROR = 3.0
"""Factor on the standard deviations for frictions that no column describes: gains of a Go2's thighs had errors of 28 %
with a standard deviation of 2 to 3 %; the reported one of an SO-101 hardly changes by it."""
LOAD_FRICTION_COLUMN, JOINT_OWN_COLUMN_COUNT = 4, 7
LOAD_COLUMNS = slice(JOINT_OWN_COLUMN_COUNT, JOINT_OWN_COLUMN_COUNT + INERTIAL_PARAMETERS_PER_BODY)
"""Columns: that of the friction in proportion to the load, the number of a joint's own, and those of the load."""
UNKNOWN_LOAD_MASS_STD_KG, UNKNOWN_LOAD_DISTANCE_STD_METRES = (
    payload.quantities["mass"].typical,
    payload.quantities["x"].spread or 0.0,
)
UNKNOWN_LOAD_PRIOR_STDS = UNKNOWN_LOAD_MASS_STD_KG * UNKNOWN_LOAD_DISTANCE_STD_METRES ** np.array(
    [0, 1, 1, 1, 2, 2, 2, 2, 2, 2]
)
"""Standard deviations of an unknown load's mass, first and second moments, about the frame's origin."""
FRICTION_PER_LOAD_PRIOR_STD = 0.1
"""Standard deviation of the friction per load: without it, a joint that lifts as much as it lowers determines no gain,
because friction could have any size."""
FRICTION_FADING_SPEED = 0.1
"""Speed, rad/s or m/s, over which the friction near standstill fades."""
MIN_RESIDUAL_REDUCTION_BY_LOAD = 1.5
"""Factor by which a load must reduce the residual of parts of the recordings that were not fitted, to be assumed; with
it, the gain is less certain. Of 40 generated arms, those with a load had 6.3 and more, those without at most 1.05."""
GAUSS_NEWTON_STEPS = 6
RELATIVE_ROUNDING = 1e-12
"""Ridge, as a share of a column's square, and size of a column, as a share of the largest, below which it is rounding:
that of gravity on a joint with a vertical axis."""
MIN_RESIDUAL_AUTOCORRELATION, MAX_RESIDUAL_CORRELATION_LAGS = 0.05, 60
"""Autocorrelation of a residual from which on it counts in the correlation time, and the largest number of lags."""
NONNEGATIVE_COLUMN_MASK = (True, True, True, True, True, False, True, True) + (INERTIAL_PARAMETERS_PER_BODY - 1) * (
    False,
)
"""Whether the coefficient of each column is not negative."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Regression rows of one joint.

    Attributes:
        drive: name of the joint's kind of drive.
        X: (n, 17) columns of the physics: load, v, a, sign, load friction, offset, friction near standstill, carried.
        y: (n,) errors.
        part: (n,) index of the part of the recordings that contains each sample.
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


@dataclass(frozen=True, eq=False)
class _Kind:
    """Recordings of one kind of drive: its name, the arm, the runs, and the joints with readings in them."""

    name: str
    arm: Arm
    runs: Sequence[Run]
    joints: Sequence[str]

    def rows(self, servo: Servo, *, clipped: bool = False) -> list[_Rows]:
        """Rows of every joint: without errors beyond saturation, or with such errors `clipped`."""
        return [_rows_of(self, servo, joint, clipped) for joint in self.joints]


def drives_with_identified_gains(drives: Mapping[str, Servo], arm: Arm, runs: Sequence[Run]) -> dict[str, Servo]:
    """The drives with their unknown gains, delays and saturations identified from recordings.

    Raises:
        InputError: the recordings determine no gain.
    """
    found, rows = {name: _with_reference(servo, runs) for name, servo in drives.items()}, list[_Rows]()
    for name, servo in list(found.items()):
        kind = _Kind(
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
            rows += [row for row in kind.rows(timed) if row.noise > 0.0]
    if not rows:
        return found
    gains = {name: found[name].gain for name in dict.fromkeys(row.drive for row in rows)}
    for name, (compliance, std, loaded_std) in _compliances(rows, gains).items():
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


def _with_delay(kind: _Kind, servo: Servo) -> Servo:
    """Drives with the delay for which all their joints together have the smallest residual, unless it is known."""
    if servo.delay is not None:
        return servo

    def cost(delay: float) -> float:
        rows = kind.rows(replace(servo, delay=delay))
        return float(sum(np.log(row.square) for row in rows if row.square > 0.0))

    return replace(servo, delay=_minimum(cost, DRIVE_DELAYS_TRIED_SECONDS, DRIVE_DELAY_TOLERANCE_SECONDS))


def _saturation(kind: _Kind, servo: Servo) -> float:
    """The saturating error; infinite where saturation does not make the errors more probable.

    It minimises the residual as a share of the clipped errors: errors clipped at zero leave no residual, but contain no
    information. Below it errors have the probability of their residual, beyond it any size up to the largest is equally
    probable.
    """
    unlimited, sizes = (
        kind.rows(replace(servo, full_at=np.inf), clipped=True),
        [_sizes(kind, servo, j) for j in kind.joints],
    )
    count = [len(row.y) * row.square / row.noise**2 if row.square > 0.0 else 0.0 for row in unlimited]

    def cost(full_at: float) -> float:
        rows = kind.rows(replace(servo, full_at=full_at), clipped=True)
        return float(
            np.array(count) @ np.log([min(r.square / np.var(r.y), 1.0) if r.square > 0.0 else 1.0 for r in rows])
        )

    every = np.concatenate(sizes)
    best = _minimum(
        cost,
        np.quantile(every, SATURATING_ERROR_QUANTILES_TRIED),
        SATURATING_ERROR_TOLERANCE_SHARE * float(every.max()),
    )
    gained, limited = 0.0, kind.rows(replace(servo, full_at=best), clipped=True)
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


def _own_regression(X: np.ndarray, y: np.ndarray) -> tuple[float, float, tuple[float, float]]:
    """The last three attributes of `_Rows`, from a regression of one joint alone."""
    if len(y) <= X.shape[1] or not np.any(y):
        return 0.0, 0.0, (0.0, np.inf)
    A = X.T @ X
    solution = _bounded(A, X.T @ y, NONNEGATIVE_COLUMN_MASK)
    residual = y - X @ solution.x
    lags = min(MAX_RESIDUAL_CORRELATION_LAGS, len(y) // 4)
    correlated = correlation_time([residual - residual.mean()], lags, MIN_RESIDUAL_AUTOCORRELATION)
    noise = float(np.sqrt(np.mean(residual**2) * correlated))
    compliance = float(solution.x[0]), float(_variance(A, solution.on_bound == 0)[0]) * noise**2
    return float(np.mean(np.abs(residual)) ** 2), noise, compliance


def _bounded(A: np.ndarray, b: np.ndarray, positive: Sequence[bool]) -> BoundedSolution:
    """Least squares in which some unknowns are not negative; an unknown without information is 0."""
    size = np.diag(A)
    shown = size > RELATIVE_ROUNDING**2 * size.max()
    A = A + np.diag(np.where(shown, RELATIVE_ROUNDING * size, 1.0))
    return solve_bounded(A, b, np.where(positive, 0.0, -np.inf), np.inf)


def _variance(A: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Diagonal of the inverse of the `free` part of an information matrix; infinite elsewhere."""
    use = free & (np.diag(A) > 0.0)
    found = np.full(len(A), np.inf)
    found[use] = np.diag(inverse_positive(A[np.ix_(use, use)]))
    return found


def _compliances(
    rows: Sequence[_Rows], gains: Mapping[str, KnownQuantity | None]
) -> dict[str, tuple[float, float, float]]:
    """By kind of drive: 1/k from all joints together, its standard deviation, and that with an unknown load.

    A load is assumed where it predicts parts of the recordings that were not fitted. The differences of the values
    between the parts are errors as much as noise is, because no model is complete (jackknife, Efron 1979).
    """
    parts = np.unique(np.concatenate([row.part for row in rows])).tolist()
    fits = [[_JointFit(rows, gains, carried=carried, left_out=part) for part in parts] for carried in (False, True)]
    costs = [sum(fit.cost_of(part) for fit, part in zip(each, parts, strict=True)) for each in fits]
    carried = costs[0] > MIN_RESIDUAL_REDUCTION_BY_LOAD * costs[1]
    whole = _JointFit(rows, gains, carried=carried, left_out=None)
    jackknife = np.sqrt((len(parts) - 1) * np.var([fit.compliance for fit in fits[carried]], axis=0))
    stds = np.hypot([whole.std, whole.loaded_std], jackknife)
    return {k: (c, *both) for k, c, both in zip(gains, whole.compliance.tolist(), stds.T.tolist(), strict=True)}


class _JointFit:
    """Regression of all joints together, without the part `left_out` of the recordings.

    Unknowns are 1/k of each kind, the ten parameters of the load, and six of each joint.

    Attributes:
        compliance: (kinds,) 1/k.
        std: (kinds,) its standard deviations.
        loaded_std: (kinds,) those with a usual load, where none is `carried`.
    """

    def __init__(
        self, rows: Sequence[_Rows], gains: Mapping[str, KnownQuantity | None], *, carried: bool, left_out: int | None
    ) -> None:
        self._rows, self._kinds, self._gains = rows, list(gains), gains
        count = len(gains)
        self._first = first = count + INERTIAL_PARAMETERS_PER_BODY
        values = np.zeros(first + (JOINT_OWN_COLUMN_COUNT - 1) * len(rows))
        values[:count] = [_first_guess(rows, kind, gain) for kind, gain in gains.items()]
        positive = (
            [True] * count
            + list(NONNEGATIVE_COLUMN_MASK[LOAD_COLUMNS])
            + list(NONNEGATIVE_COLUMN_MASK[1:JOINT_OWN_COLUMN_COUNT]) * len(rows)
        )
        load = np.zeros(len(values), dtype=bool)
        load[count:first] = True
        for _ in range(GAUSS_NEWTON_STEPS):
            A, b = self._information(values, carried, left_out)
            A[load, load] += 0.0 if carried else 1.0
            solution = _bounded(A, b, positive)
            values = np.append(np.maximum(solution.x[:count], 0.1 * values[:count]), solution.x[count:])
        free = solution.on_bound == 0
        self._values, self._carried = values, carried
        self.compliance, self.std = values[:count], np.sqrt(_variance(A, free)[:count])
        self.loaded_std = self.std
        if not carried:
            A, _ = self._information(values, carried=True, left_out=left_out)
            A[load, load] += 1.0 / UNKNOWN_LOAD_PRIOR_STDS**2
            self.loaded_std = np.sqrt(_variance(A, free | load)[:count])

    def _information(self, values: np.ndarray, carried: bool, left_out: int | None) -> tuple[np.ndarray, np.ndarray]:
        """Information matrix and right-hand side, linearised at `values`, with stated gains as priors."""
        A, b = np.zeros((len(values), len(values))), np.zeros(len(values))
        for i, gain in enumerate(self._gains.values()):
            if gain is not None:
                A[i, i] = (gain.value**2 / (gain.std or 1e-6 * gain.value)) ** 2
                b[i] = A[i, i] / gain.value
        for k, row in enumerate(self._rows):
            X, y = self._linearised(k, values, carried)
            use = row.part != left_out
            A += X[use].T @ X[use]
            b += X[use].T @ y[use]
            friction = self._first + (JOINT_OWN_COLUMN_COUNT - 1) * k + LOAD_FRICTION_COLUMN - 1
            A[friction, friction] += 1.0 / (FRICTION_PER_LOAD_PRIOR_STD * values[self._kinds.index(row.drive)]) ** 2
        return A, b

    def _linearised(self, k: int, values: np.ndarray, carried: bool) -> tuple[np.ndarray, np.ndarray]:
        """(n, unknowns) derivatives and (n,) right-hand side of a joint, in units of its noise."""
        row, i = self._rows[k], self._kinds.index(self._rows[k].drive)
        own, first = JOINT_OWN_COLUMN_COUNT - 1, self._first
        m, P, X = values[len(self._kinds) : first], row.X[:, LOAD_COLUMNS], np.zeros((len(row.y), len(values)))
        X[:, i] = row.X[:, 0] + P @ m
        X[:, len(self._kinds) : first] = values[i] * P if carried else 0.0
        X[:, first + own * k : first + own * (k + 1)] = row.X[:, 1 : own + 1]
        noise = GAIN_STD_FACTOR_FOR_MODEL_ERROR * row.noise
        return X / noise, (row.y + values[i] * (P @ m)) / noise

    def cost_of(self, part: int) -> float:
        """Half of the sum of squared residuals in a part of the recordings, in units of the noise."""
        linear = [self._linearised(k, self._values, self._carried) for k in range(len(self._rows))]
        residuals = [(y - X @ self._values)[row.part == part] for (X, y), row in zip(linear, self._rows, strict=True)]
        return sum(0.5 * float(np.sum(residual**2)) for residual in residuals)


def _first_guess(rows: Sequence[_Rows], kind: str, gain: KnownQuantity | None) -> float:
    """1/k of a kind: as stated, or the weighted mean of its joints' own values."""
    if gain is not None:
        return 1.0 / gain.value
    alone = [row.compliance for row in rows if row.drive == kind and row.compliance[0] > 0.0]
    weights = [1.0 / max(variance, 1e-300) for _, variance in alone]
    return float(np.average([c for c, _ in alone], weights=weights)) if alone and sum(weights) > 0.0 else 1.0


def _rows_of(kind: _Kind, servo: Servo, joint: str, clipped: bool) -> _Rows:
    X, y, part = [], [], []
    for number, run in enumerate(kind.runs):
        if not is_read_from_commands(run, joint, servo):
            continue
        time, columns, known = _columns(run, kind.arm, joint)
        share, reading = _shared_error(servo, kind.arm, run, joint, time)
        most = share * servo.saturating
        within = (share > 0.0) & (clipped | (np.abs(reading) < MAX_USED_SHARE_OF_SATURATING_ERROR * most))
        used = np.flatnonzero(known & (_low_pass(within.astype(float)) > 0.95))[::LOW_PASSED_SAMPLES_PER_KEPT]
        X.append(columns[used])
        y.append(_low_pass(np.clip(reading, -most, most))[used])
        late = time[used] > 0.5 * (time[0] + time[-1])
        part.append(np.where(late, 2 * number + 1, 2 * number) if len(kind.runs) == 1 else np.full(len(late), number))
    every, read = np.vstack(X), np.concatenate(y)
    return _Rows(kind.name, every, read, np.concatenate(part), *_own_regression(every, read))


def _shared_error(servo: Servo, arm: Arm, run: Run, joint: str, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) share of a drive's torque at (n,) times, and (n,) that share of its error, relative to the usual gain."""
    share, scale = servo.torque_share(run, joint, time)
    return share, share * scale * drive_error(run, arm.joints, joint, servo, servo.delay or 0.0, time, smooth=True)


def _sizes(kind: _Kind, servo: Servo, joint: str) -> np.ndarray:
    """Absolute values of all errors of a joint."""
    runs = [run for run in kind.runs if is_read_from_commands(run, joint, servo)]
    times = (_columns(run, kind.arm, joint)[0] for run in runs)
    return np.concatenate(
        [np.abs(_shared_error(servo, kind.arm, run, joint, t)[1]) for run, t in zip(runs, times, strict=True)]
    )


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
