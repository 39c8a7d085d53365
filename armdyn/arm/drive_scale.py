r"""What recordings say of drives themselves: gains, from the weight that they hold, delays, and where they saturate.

A servo's error e stands on the left and the physics on the right, both low-passed:

    e(t - d) = c [T(q, v, a) + P(q, v, a) m] + D v + I a + (F + mu |T| + S exp(-(v/v_s)^2)) sign(v) + b,      c = 1/k,

with the ten inertial parameters m of what the last link may carry, that every joint feels through its regressor P;
linear but for the product c m, and by Gauss-Newton in it. Frictions and inertias are not negative. The delay d of a
kind of drives is the one that leaves least of all its joints together, whatever each alone says of c and m. A drive
that is asked for more than it has gives the torque of the error s where it saturates: of the error as clipped at s, the
physics leaves the least share unexplained, and beyond s it says nothing of c. The error is what is noisy: on the right
its noise would shrink the gain towards zero. Only gravity, of masses that are known, says how large c is: where the
motion of a joint does not show it, joints with the same drive say it. What an arm carries and nobody wrote down passes
for a gain where few joints feel it: the deviation that is told counts a usual load in, as far as the recordings leave
room for one.
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfiltfilt

from armdyn.arm.arm import Arm
from armdyn.arm.drives import UNITS, Servo
from armdyn.arm.motion import measured_motion
from armdyn.arm.readings import error, reads
from armdyn.arm.rigid import SIZE, inverse_dynamics, torque_regressor
from armdyn.effects.joint import payload
from armdyn.errors import InputError
from armdyn.kept import cached_with_first_argument
from armdyn.linear.solve import BoundedSolution, scaled, solve_bounded
from armdyn.recording.units import Known
from armdyn.run import Run

BAND = 6.0
"""Hz below which both sides are compared: arms that are told where to go hardly move faster."""
STEP = 0.01
"""s between the instants that are low-passed."""
THINNED = 4
"""Of these, of which one is kept: at this rate the low-pass leaves independent samples."""
CERTAIN = 0.9
"""Expected sign of a velocity from which its friction is known; below, samples are left out."""
DELAYS, SHARP = np.arange(0.0, 0.0651, 0.0025), 5e-5
"""s that are tried, and how closely the best of them is looked at: a millisecond of delay
looks like as much inertia of a rotor, times the gain, where a drive is told a velocity, and as much friction where it
is told a position."""
CEILINGS, SHARPLY = np.linspace(0.3, 1.0, 15), 1e-3
"""Quantiles of errors that are tried as the one where drives saturate, and of the largest, how closely it is looked at:
of one that is at its limit most of the time nothing else can be told."""
SPREAD = np.pi**2 * np.e
"""(2 pi e) (pi / 2): of a normal density, the square of exp(entropy) over that of its mean size."""
DETERMINED = 0.1
"""Relative standard deviation of 1/k below which recordings say it. On recordings of an SO-101 joints that gravity
loads have 1 to 4 %, those that it does not 30 % and more."""
SATURATED = 0.95
"""Of the limit; beyond it a reading says nothing of the gain."""
WORSE = 3.0
"""Factor by which frictions that no column holds make deviations worse than what is left says: thighs of a Go2 were
28 % off at a stated 2 to 3 %, and with it the gain that is stated of an SO-101 hardly moves."""
LOAD, OWN = 4, 7
CARRIED = slice(OWN, OWN + SIZE)
"""Columns of the friction that grows with the load, how many are the joint's own, and those of what the last link
carries."""
MASS, PLACE = payload.quantities["mass"].typical, payload.quantities["x"].spread or 0.0
USUAL = MASS * PLACE ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
"""Standard deviations of what an arm carries unknown to its description: mass, first and second moments, of the frame's
origin."""
USUAL_LOSS = 0.1
"""Friction that grows with the load, usually: without it, a joint that lifts as much as it lowers would take any gain
for any friction."""
FADING = 0.1
"""rad/s or m/s; over which the friction near standstill fades."""
WORTH = 1.5
"""Factor by which a carried mass must lower what is left of parts of the recordings that were not fitted: with it, the
gain is less certain. Of 40 generated arms those that carry something had 6.3 and more, those that do not up to 1.05."""
ROUNDS = 6
"""In which the products settle."""
ROUNDING = 1e-12
"""Of a column's square; of the largest column, below which one is none, as that of gravity on an upright axis."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """What one joint's motion says of its drive.

    Attributes:
        drive: name of its kind.
        X: (n, 17) columns of the physics: load, v, a, sign, load friction, offset, friction near standstill, carried.
        y: (n,) errors.
        part: (n,) int, the stretch of the recordings that each sample is of.
        left: square of the mean size that its own values leave, gain and carried mass among them; 0 where it says
            nothing.
        noise: standard deviation of what they leave, larger by its correlation, so that samples count as independent.
        alone: 1/k and its variance by the joint alone, whatever is carried.
    """

    drive: str
    X: np.ndarray
    y: np.ndarray
    part: np.ndarray
    left: float
    noise: float
    alone: tuple[float, float]


def settled(drives: Mapping[str, Servo], arm: Arm, runs: Sequence[Run]) -> dict[str, Servo]:
    """The drives with their gains and their delays, those that were not known from recordings.

    Raises:
        InputError: nothing says how large a gain is.
    """
    found, rows = {name: _supplied(servo, runs) for name, servo in drives.items()}, list[_Rows]()
    for name, servo in list(found.items()):
        joints = [joint for joint in servo.joints if any(reads(run, joint, servo) for run in runs)]
        known = servo.gain is not None and servo.gain.std is None and servo.delay is not None
        if joints and not (known and np.isfinite(servo.saturating)):
            told = _identified(name, servo, arm, runs, joints)
            found[name] = replace(told, full_at=servo.full_at if np.isfinite(servo.limit) else told.full_at)
            rows += [row for row in _rows(name, told, arm, runs, joints) if row.noise > 0.0]
    if not rows:
        return found
    asked = {name: found[name].gain for name in dict.fromkeys(row.drive for row in rows)}
    for name, (compliance, std, loaded) in _weighed(rows, asked).items():
        servo = found[name]
        if servo.gain is not None and servo.gain.std is None:
            continue
        unit = UNITS[servo.law][arm.slides[arm.joints.index(servo.joints[0])]]
        if not 0.0 < std < compliance:
            raise InputError(
                f"[drives.{name}]: without its gain every value would be a ratio to it, and no joint of "
                f"{', '.join(servo.joints)} moves a known weight against gravity far enough to tell: write gain = "
                f'"... {unit}", or {telling(arm, servo.joints)}'
            )
        stated = servo.gain is not None and (servo.gain.std or 0.0) <= DETERMINED * servo.gain.value
        gain, relative = 1.0 / compliance, std / compliance
        found[name] = replace(
            servo,
            gain=Known(gain, loaded / compliance * gain, unit),
            unloaded=relative * gain,
            determined=stated or relative < DETERMINED,
        )
    return found


def _supplied(servo: Servo, runs: Sequence[Run]) -> Servo:
    """Drives with the usual voltage of their recordings, where nothing says at which their gain holds."""
    volts = [run.channels[n].value for run in runs for j in servo.joints if (n := f"voltage.{j}") in run.channels]
    if not volts or servo.supply is not None or servo.reference is not None:
        return servo
    return replace(servo, reference=float(np.mean(np.abs(np.concatenate(volts)))))


def telling(arm: Arm, joints: Sequence[str]) -> str:
    """What would tell the gain of these joints' drives, to be recorded."""
    heavy = " or ".join(joints)
    described = shlex.join(["--robot", arm.robot.name] if arm.file is None else ["--urdf", str(arm.file)])
    return (
        f"record a known load on the last link, written into the description, or {heavy} lifting the arm's own weight "
        f"through its range: armdyn excite {described} --for torque_gain:{','.join(joints)} --output lift.csv"
    )


def _identified(name: str, servo: Servo, arm: Arm, runs: Sequence[Run], joints: Sequence[str]) -> Servo:
    """Drives with the delay and the saturation that are not known of them, as the readings of their joints tell."""
    timed = _timed(name, servo, arm, runs, joints)
    if np.isfinite(servo.saturating):
        return timed
    full_at = _saturation(name, timed, arm, runs, joints)
    if full_at == np.inf:
        return timed
    return _timed(name, replace(servo, full_at=full_at), arm, runs, joints)


def _timed(name: str, servo: Servo, arm: Arm, runs: Sequence[Run], joints: Sequence[str]) -> Servo:
    """Drives with the delay that leaves the least of all their joints' errors."""
    if servo.delay is not None:
        return servo

    def worth(delay: float) -> float:
        rows = _rows(name, replace(servo, delay=delay), arm, runs, joints)
        return float(sum(np.log(row.left) for row in rows if row.left > 0.0))

    # Frictions and inertias that may not be negative give it a kink: no parabola.
    return replace(servo, delay=_least_at(worth, DELAYS, SHARP))


def _saturation(name: str, servo: Servo, arm: Arm, runs: Sequence[Run], joints: Sequence[str]) -> float:
    """The error from which drives give no more; infinite where that makes the errors no likelier.

    It is where the least share of the clipped errors is left: an error clipped at nothing leaves nothing, and says
    nothing. Below it errors are as likely as what is left then says; beyond it they may be anything up to the largest.
    """

    def rows(full_at: float) -> list[_Rows]:
        return _rows(name, replace(servo, full_at=full_at), arm, runs, joints, clipped=True)

    unlimited, sizes = rows(np.inf), [_sizes(servo, arm, runs, joint) for joint in joints]
    count = [len(row.y) * row.left / row.noise**2 if row.left > 0.0 else 0.0 for row in unlimited]

    def share(full_at: float) -> float:
        left = [min(row.left / np.var(row.y), 1.0) if row.left > 0.0 else 1.0 for row in rows(full_at)]
        return float(np.array(count) @ np.log(left))

    every = np.concatenate(sizes)
    best, gained = _least_at(share, np.quantile(every, CEILINGS), SHARPLY * float(every.max())), 0.0
    for without, row, size in zip(unlimited, rows(best), sizes, strict=True):
        if row.left > 0.0 and without.left > 0.0:
            beyond = float(np.mean(size > best))
            per_sample = 0.5 * np.log(SPREAD * without.left) - 0.5 * (1.0 - beyond) * np.log(SPREAD * row.left)
            per_sample -= beyond * np.log(max(float(size.max()) - best, np.finfo(float).tiny)) if beyond else 0.0
            gained += len(row.y) * row.left / row.noise**2 * per_sample
    return best if gained > 0.5 * np.log(max(sum(count), 1.0)) else np.inf


def _least_at(cost: Callable[[float], float], tried: np.ndarray, closely: float) -> float:
    """Where a cost is least, from (n,) rising values that are tried, to within `closely`."""
    i = int(np.argmin([cost(float(value)) for value in tried]))
    bounds = float(tried[max(i - 1, 0)]), float(tried[min(i + 1, len(tried) - 1)])
    return float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": closely}).x)


NOT_NEGATIVE = (True, True, True, True, True, False, True, True) + (SIZE - 1) * (False,)
"""Columns whose factors are not."""


def _alone(X: np.ndarray, y: np.ndarray) -> tuple[float, float, tuple[float, float]]:
    """What a joint's own values leave, its noise, and its 1/k with the variance; see `_Rows`."""
    if len(y) <= X.shape[1] or not np.any(y):
        return 0.0, 0.0, (0.0, np.inf)
    A = X.T @ X
    solution = _least(A, X.T @ y, NOT_NEGATIVE)
    left = y - X @ solution.x
    square = float(np.mean(np.abs(left)) ** 2)
    noise = float(np.sqrt(np.mean(left**2) * _correlated(left)))
    return square, noise, (float(solution.x[0]), float(_variance(A, solution.held == 0)[0]) * noise**2)


def _least(A: np.ndarray, b: np.ndarray, positive: Sequence[bool]) -> BoundedSolution:
    size = np.diag(A)
    shown = size > ROUNDING**2 * size.max()
    A = A + np.diag(np.where(shown, ROUNDING * size, 1.0))
    return solve_bounded(A, b, np.where(positive, 0.0, -np.inf), np.inf)


def _variance(A: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Diagonal of the inverse of the `free` part of an information; infinite elsewhere, and where it holds nothing."""
    use = free & (np.diag(A) > 0.0)
    scale, unit = scaled(A[np.ix_(use, use)])
    found = np.full(len(A), np.inf)
    found[use] = np.diag(np.linalg.inv(unit)) / scale**2
    return found


def _weighed(rows: Sequence[_Rows], asked: Mapping[str, Known | None]) -> dict[str, tuple[float, float, float]]:
    """By kind of drive, of all joints together, 1/k, its standard deviation, and the same if a load may be unknown.

    A mass is carried where it predicts what it was not fitted to. What values differ by without a part of the
    recordings is their error as much as noise is: models are never whole (jackknife, Efron 1979).
    """
    parts = np.unique(np.concatenate([row.part for row in rows])).tolist()
    told = []
    for carried in (False, True):
        without = [_Weighing(rows, asked, carried=carried, left_out=part) for part in parts]
        told.append((sum(one.left_of(part) for one, part in zip(without, parts, strict=True)), without))
    carried = told[0][0] > WORTH * told[1][0]
    whole, values = _Weighing(rows, asked, carried=carried, left_out=None), np.array([w.c for w in told[carried][1]])
    differ = np.sqrt((len(parts) - 1) * np.var(values, axis=0))
    stds = np.hypot([whole.std, whole.loaded], differ)
    return {k: (c, *both) for k, c, both in zip(asked, whole.c.tolist(), stds.T.tolist(), strict=True)}


class _Weighing:
    """All joints together, but for a part of the recordings.

    Attributes:
        c: (kinds,) 1/k.
        std: (kinds,) their standard deviations.
        loaded: (kinds,) the same where a usual load may be carried that was not found.
    """

    def __init__(
        self, rows: Sequence[_Rows], asked: Mapping[str, Known | None], *, carried: bool, left_out: int | None
    ) -> None:
        self._rows, self._kinds, self._asked = rows, list(asked), asked
        count = len(asked)
        self._first = first = count + SIZE
        values = np.zeros(first + (OWN - 1) * len(rows))
        values[:count] = [_first_guess(rows, kind, gain) for kind, gain in asked.items()]
        positive = [True] * count + list(NOT_NEGATIVE[CARRIED]) + list(NOT_NEGATIVE[1:OWN]) * len(rows)
        load = np.zeros(len(values), dtype=bool)
        load[count:first] = True
        for _ in range(ROUNDS):
            A, b = self._sums(values, carried, left_out)
            A[load, load] += 0.0 if carried else 1.0
            solution = _least(A, b, positive)
            values = np.append(np.maximum(solution.x[:count], 0.1 * values[:count]), solution.x[count:])
        free = solution.held == 0
        self.c, self.std = values[:count], np.sqrt(_variance(A, free)[:count])
        self._values, self._carried, self.loaded = values, carried, self.std
        if not carried:
            A, _ = self._sums(values, carried=True, left_out=left_out)
            A[load, load] += 1.0 / USUAL**2
            self.loaded = np.sqrt(_variance(A, free | load)[:count])

    def _sums(self, values: np.ndarray, carried: bool, left_out: int | None) -> tuple[np.ndarray, np.ndarray]:
        """Information about all unknowns and its product with them, around values, what is known of them counted in."""
        A, b = np.zeros((len(values), len(values))), np.zeros(len(values))
        for i, gain in enumerate(self._asked.values()):
            if gain is not None:
                A[i, i] = (gain.value**2 / (gain.std or 1e-6 * gain.value)) ** 2
                b[i] = A[i, i] / gain.value
        for k, row in enumerate(self._rows):
            X, y = self._linear(k, values, carried)
            use = row.part != left_out
            A += X[use].T @ X[use]
            b += X[use].T @ y[use]
            load = self._first + (OWN - 1) * k + LOAD - 1
            A[load, load] += 1.0 / (USUAL_LOSS * values[self._kinds.index(row.drive)]) ** 2
        return A, b

    def _linear(self, k: int, values: np.ndarray, carried: bool) -> tuple[np.ndarray, np.ndarray]:
        """(n, unknowns) and (n,) of a joint, over its noise, linear around values in the product of 1/k and mass."""
        row, i = self._rows[k], self._kinds.index(self._rows[k].drive)
        own, first = OWN - 1, self._first
        m, P, X = values[len(self._kinds) : first], row.X[:, CARRIED], np.zeros((len(row.y), len(values)))
        X[:, i] = row.X[:, 0] + P @ m
        X[:, len(self._kinds) : first] = values[i] * P if carried else 0.0
        X[:, first + own * k : first + own * (k + 1)] = row.X[:, 1 : own + 1]
        noise = WORSE * row.noise
        return X / noise, (row.y + values[i] * (P @ m)) / noise

    def left_of(self, part: int) -> float:
        """Half of the weighed squares that it leaves of a part of the recordings."""
        total = 0.0
        for k, row in enumerate(self._rows):
            X, y = self._linear(k, self._values, self._carried)
            total += 0.5 * float(np.sum((y - X @ self._values)[row.part == part] ** 2))
        return total


def _first_guess(rows: Sequence[_Rows], kind: str, gain: Known | None) -> float:
    """1/k of a kind: as stated, or what its joints say each alone."""
    if gain is not None:
        return 1.0 / gain.value
    alone = [row.alone for row in rows if row.drive == kind and row.alone[0] > 0.0]
    weights = [1.0 / max(variance, 1e-300) for _, variance in alone]
    return float(np.average([c for c, _ in alone], weights=weights)) if alone and sum(weights) > 0.0 else 1.0


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


def _rows(
    name: str, servo: Servo, arm: Arm, runs: Sequence[Run], joints: Sequence[str], *, clipped: bool = False
) -> list[_Rows]:
    """What joints read in all runs: without what is beyond saturation, or `clipped` there."""
    return [_read(name, servo, arm, runs, joint, clipped) for joint in joints]


def _read(name: str, servo: Servo, arm: Arm, runs: Sequence[Run], joint: str, clipped: bool) -> _Rows:
    X, y, part = [], [], []
    for number, run in enumerate(runs):
        if not reads(run, joint, servo):
            continue
        time, columns, known = _columns(run, arm, joint)
        share, reading = _reading(servo, arm, run, joint, time)
        most = share * servo.saturating
        within = (share > 0.0) & (clipped | (np.abs(reading) < SATURATED * most))
        used = known & (_low(within.astype(float)) > 0.95)
        X.append(columns[used][::THINNED])
        y.append(_low(np.clip(reading, -most, most))[used][::THINNED])
        late = time[used][::THINNED] > 0.5 * (time[0] + time[-1])
        part.append(np.where(late, 2 * number + 1, 2 * number) if len(runs) == 1 else np.full(len(late), number))
    every, read = np.vstack(X), np.concatenate(y)
    return _Rows(name, every, read, np.concatenate(part), *_alone(every, read))


def _reading(servo: Servo, arm: Arm, run: Run, joint: str, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) share of a drive's torque at (n,) times, and (n,) that share of its error, by its usual gain."""
    share, scale = servo.gate(run, joint, time)
    return share, share * scale * error(run, arm.joints, joint, servo, servo.delay or 0.0, time, smooth=True)


def _sizes(servo: Servo, arm: Arm, runs: Sequence[Run], joint: str) -> np.ndarray:
    """Sizes of all errors of a joint."""
    read = [run for run in runs if reads(run, joint, servo)]
    found = [np.abs(_reading(servo, arm, run, joint, _columns(run, arm, joint)[0])[1]) for run in read]
    return np.concatenate(found)


@cached_with_first_argument
def _columns(run: Run, arm: Arm, joint: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) times, (n, 17) columns of the physics, low-passed, and (n,) where the friction's sign is known."""
    motion, j = measured_motion(run, arm.joints), arm.joints.index(joint)
    time, torque, carried = _bodies(run, arm)
    at = motion.at(time)
    way, load, v = at.direction[:, j], torque[:, j], at.v[:, j]
    fading = way * np.exp(-((v / FADING) ** 2))
    own = [load, v, at.a[:, j], way, way * np.abs(load), np.ones(len(time)), fading]
    inner = (time > time[0] + 2.0 / BAND) & (time < time[-1] - 2.0 / BAND)
    return time, _low(np.column_stack([*own, carried[:, j]])), inner & (_low(np.abs(way)) > CERTAIN)


@cached_with_first_argument
def _bodies(run: Run, arm: Arm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) times, (n, nj) torques of the arm as described, (n, nj, 10) per inertial parameter of the last link."""
    motion = measured_motion(run, arm.joints)
    time = np.arange(motion.start, motion.end, STEP)
    at = motion.at(time)
    return time, inverse_dynamics(arm.model, at.q, at.v, at.a), torque_regressor(arm.model, at)[:, :, -1]


def _low(signal: np.ndarray) -> np.ndarray:
    sos = butter(2, BAND, fs=1.0 / STEP, output="sos")
    return np.asarray(sosfiltfilt(sos, signal, axis=0, padlen=min(len(signal) - 1, round(1.0 / STEP))))
