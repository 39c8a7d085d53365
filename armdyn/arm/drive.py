r"""Find the low-pass filter with which drives smoothed the torques that they recorded.

Many drives smooth a torque before it is recorded. Neighbouring samples then have nearly the same noise, although below
the cut-off all of it is there. The residual of a linear regression on rigid bodies and frictions has the spectrum

    S(f) = S_0 H(f) + S_1 + S_q(f),      H(f) = (1 + (f/f_c)^4)^-2,

with S_0 of the noise before a Butterworth filter of second order, forwards and backwards, S_1 of the noise after it,
and S_q of the torque that the positions' noise causes. It is measured by differences of fourth order between samples h
apart: each is a band-pass around 1/(2h), and the median of their sizes excludes reversals of friction.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.motion import MIN_CERTAIN_VELOCITY_SIGN, MeasuredMotion, Motion
from armdyn.estimation.solve import solve_positive
from armdyn.recording.noise import ABS_NORMAL_MEDIAN_OVER_STD

LOW_PASS_SEARCH_MAX_RATE_HZ = 125.0
"""Largest sampling rate that the search for low-passes uses, Hz; the cut-offs of drives are well below half of it."""
LOW_PASS_SEARCH_MAX_SAMPLES, LOW_PASS_SEARCH_MIN_SAMPLES = 2500, 200
"""Largest and smallest number of samples, of all recordings together, in the search for low-passes."""
MAX_RATE_DIFFERENCE = 0.01
"""Largest relative difference of the sampling rates of recordings that are evaluated together."""
DIFFERENCE_SPACINGS_IN_SAMPLES, MAX_DIFFERENCE_SPACING_SECONDS = np.array([1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20]), 0.11
"""Distances between the samples of a difference, in samples, and the largest of them, s: below 5 Hz the residual is the
model's error as much as noise."""
SECONDS_BESIDE_UNCERTAIN_DIRECTION = 0.1
"""Time, s, left out before and after a moment with an uncertain direction: smoothed friction is not a step."""
NOISE_FRICTION_FADING_SPEEDS = (0.03, 0.06, 0.1, 0.15)
"""Speeds of fading frictions, rad/s; see `Motion.own_columns`."""
RIDGE_SHARE_OF_SQUARED_COLUMN = 1e-10
"""Ridge as a share of a column's square; a coefficient without information stays zero."""
MIN_COLUMN_SIZE_SHARE = 1e-10
"""Size of a column, as a share of the largest, below which it is rounding: gravity on a joint with a vertical axis."""
MIN_NOISE_DENSITY_RATIO_AT_CUTOFF = 6.0
"""Amplitude density of the noise below the cut-off over that after the low-pass, median over joints, from which drives
have a low-pass. Of generated robots it is up to 4 without one, and 10 with one."""
MIN_JOINTS_FOR_COMMON_FILTER = 3
"""Least number of joints whose noise must show a low-pass before the drives are said to have one: the residual of one
joint alone is its model's error as often as a low-pass."""
MIN_DRIVE_CUTOFF_HZ, MAX_DRIVE_CUTOFF_SHARE_OF_RATE = 3.0, 0.2
"""Lowest cut-off, Hz, and highest as a share of the sampling rate: below is motion, above too little of the band."""
DRIVE_CUTOFFS_TRIED = 40
"""Number of cut-offs of a drive's low-pass that are tried between the lowest and the highest one."""
DIFFERENCE_WEIGHTS = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / np.sqrt(70.0)
"""Weights of a difference of fourth order, which keeps the variance of white noise."""
FREQUENCIES_OVER_CUTOFF = np.linspace(0.005, 6.0, 1200)
"""f/f_c at which H is integrated; 1e-5 of it is beyond."""


class DriveLowPass(NamedTuple):
    """Low-pass filter of a drive on its recorded torque.

    Attributes:
        cutoff: cut-off, Hz; infinite without a low-pass.
        noise: standard deviation of white noise, at the recorded rate, with the density of the torque's noise below
            the cut-off.
    """

    cutoff: float
    noise: float


class RecordedTorque(NamedTuple):
    """A recorded torque with what is needed to find its low-pass.

    Attributes:
        joint: index of the joint; None for an axis of a force/torque sensor, which no drive smooths.
        stamps: (n,) time stamps, s.
        values: (n,) values, N m or N.
        spectrum: (f,) S_q at frequencies.
        physics: (n, k) regression columns of any physics of a drive's reading; (0, 0) for a measured torque.
    """

    joint: int | None
    stamps: np.ndarray
    values: np.ndarray
    spectrum: np.ndarray
    physics: np.ndarray


class TorqueRecording(NamedTuple):
    """Recorded torques of one recording by channel, and the motion of all joints."""

    torques: Mapping[str, RecordedTorque]
    motion: MeasuredMotion


def drive_low_passes(
    recordings: Sequence[TorqueRecording], model: pin.Model, frequencies: np.ndarray
) -> dict[str, DriveLowPass]:
    """Find the low-passes of an arm's drives, by torque channel.

    The drives of one arm are alike in all its recordings, of which one alone may be too short: where most torques show
    a low-pass, all have it, also that of a joint that reverses too often to show it.

    Args:
        recordings: recordings of the arm.
        model: the described arm.
        frequencies: (f,) frequencies of the torques' spectra, Hz.
    """
    most = LOW_PASS_SEARCH_MAX_SAMPLES // len(recordings)

    @lru_cache(maxsize=2 * len(recordings))
    def moved(recording: int, stamps: bytes) -> MotionSamples:
        """The motion of a recording at some stamps, which torques often share."""
        time = np.frombuffer(stamps)
        return MotionSamples(model, recordings[recording].motion.at(time), time)

    noises: dict[str, _Noise] = {}
    for name in dict.fromkeys(name for recorded in recordings for name in recorded.torques):
        torques = [(i, recorded.torques[name]) for i, recorded in enumerate(recordings) if name in recorded.torques]
        noises[name] = _noise(torques, moved, frequencies, most)
    shown = {name: (one.std, one.filtered) for name, one in noises.items() if one.filtered is not None}
    if (
        len(shown) < MIN_JOINTS_FOR_COMMON_FILTER
        or np.median([noises[name].ratio for name in shown]) < MIN_NOISE_DENSITY_RATIO_AT_CUTOFF
    ):
        return {name: DriveLowPass(np.inf, std) for name, (std, _) in shown.items()}
    cutoff = float(np.median([drive.cutoff for _, drive in shown.values()]))
    below = float(np.median([drive.noise / std for std, drive in shown.values()]))
    drives = {name: DriveLowPass(cutoff, drive.noise) for name, (_, drive) in shown.items()}
    others = {name: one.std for name, one in noises.items() if one.filtered is None and one.std > 0.0}
    return drives | {name: DriveLowPass(cutoff, below * std) for name, std in others.items()}


class _Noise(NamedTuple):
    """Noise of a torque: without a low-pass its standard deviation; else the low-pass, and the densities' ratio."""

    std: float
    filtered: DriveLowPass | None = None
    ratio: float = 0.0


def _noise(
    torques: Sequence[tuple[int, RecordedTorque]],
    moved: Callable[[int, bytes], MotionSamples],
    frequencies: np.ndarray,
    most: int,
) -> _Noise:
    """Noise of one joint's torques; of too few samples only the noise that neighbouring ones show.

    Args:
        torques: torques of the joint, each with the index of its recording.
        moved: the motion of a recording at some stamps.
        frequencies: (f,) frequencies, Hz.
        most: largest number of samples of a recording.
    """
    intervals = [float((t.stamps[-1] - t.stamps[0]) / (len(t.stamps) - 1)) for _, t in torques]
    interval = intervals[int(np.argmax([len(t.stamps) for _, t in torques]))]
    every = max(1, int(np.ceil(1.0 / (LOW_PASS_SEARCH_MAX_RATE_HZ * interval) - 1e-6)))
    step = every * interval
    parts, values, spectra = [], [], []
    for (recording, torque), own in zip(torques, intervals, strict=True):
        if abs(own / interval - 1.0) < MAX_RATE_DIFFERENCE:
            begin = max(0, (len(torque.stamps) - every * most) // 2)
            time, value = (part[begin::every][:most] for part in (torque.stamps, torque.values))
            parts.append(moved(recording, time.tobytes()))
            values.append(value)
            spectra.append(torque.spectrum)
    joint = torques[0][1].joint
    assert joint is not None, "no drive smooths a wrench"
    motion = _one_after_the_other([part.motion for part in parts], step)
    uncertain = np.abs(motion.direction[:, joint]) < MIN_CERTAIN_VELOCITY_SIGN
    uncertain[np.cumsum([len(value) for value in values]) - 1] = True  # no difference reaches into another recording
    used = (
        np.convolve(uncertain, np.ones(2 * round(SECONDS_BESIDE_UNCERTAIN_DIRECTION / step) + 1), "same")[
            : len(uncertain)
        ]
        < 0.5
    )
    apart = DIFFERENCE_SPACINGS_IN_SAMPLES[DIFFERENCE_SPACINGS_IN_SAMPLES * step <= MAX_DIFFERENCE_SPACING_SECONDS]
    alone = _Noise(_level(np.concatenate(values), np.ones(len(used), dtype=bool), 1))
    if np.count_nonzero(used) < LOW_PASS_SEARCH_MIN_SAMPLES or len(apart) < 3:
        return alone
    of_links = np.concatenate([part.by_inertia[joint] for part in parts]).reshape(len(used), -1)
    residual = _residual(motion, of_links, joint, np.concatenate(values), used)
    levels = np.array([_level(residual, used, h) for h in apart])
    spectrum = np.average(spectra, axis=0, weights=[len(value) for value in values])
    brought_in = np.array([_passed(frequencies, spectrum, h * step) for h in apart])
    variance = levels**2
    if not np.all(variance > brought_in):
        return alone
    own_noise, smoothed, cutoff = _fitted(apart * step, variance, brought_in)
    below = smoothed / float(np.sqrt(2.0 * cutoff * interval * NOISE_BANDWIDTH_OVER_CUTOFF))
    ratio = below / max(own_noise, np.finfo(float).tiny)
    std = float(np.sqrt(variance[0] - brought_in[0]))
    return _Noise(std, DriveLowPass(cutoff, float(np.hypot(own_noise, below))), ratio)


def _one_after_the_other(motions: Sequence[Motion], step: float) -> Motion:
    """Join motions: each begins where the one before ends."""
    q, v, a, way = (np.concatenate([getattr(m, part) for m in motions]) for part in ("q", "v", "a", "direction"))
    begins = np.cumsum([0.0, *(float(m.time[-1] - m.time[0]) + step for m in motions)])
    time = np.concatenate([m.time - m.time[0] + begin for m, begin in zip(motions, begins[:-1], strict=True)])
    return Motion(time, q, v, a, way)


def _residual(motion: Motion, regressor: np.ndarray, joint: int, torque: np.ndarray, used: np.ndarray) -> np.ndarray:
    """(n,) residuals of (n,) torques after a regression over the `used` samples.

    Args:
        motion: the motion at the samples.
        regressor: (n, k) torques per inertial parameter of the links that the joint moves.
        joint: index of the joint.
        torque: (n,) torques.
        used: (n,) bool.
    """
    v, a, way = (part[:, joint] for part in (motion.v, motion.a, motion.direction))
    own = [*motion.own_columns(joint, NOISE_FRICTION_FADING_SPEEDS), v * v * way, np.gradient(a, motion.time)]
    load, residual = np.zeros_like(torque), torque
    for _ in range(2):  # frictions in proportion to the load follow the load of the first regression
        late = np.gradient(load, motion.time)
        columns = np.column_stack([regressor, *own, way * np.abs(load), late, np.gradient(late, motion.time)])
        sizes = np.linalg.norm(columns[used], axis=0)
        columns /= np.maximum(sizes, MIN_COLUMN_SIZE_SHARE * sizes.max())
        normal = columns[used].T @ columns[used] + RIDGE_SHARE_OF_SQUARED_COLUMN * np.eye(columns.shape[1])
        found = solve_positive(normal, columns[used].T @ torque[used])
        load, residual = columns[:, : regressor.shape[1]] @ found[: regressor.shape[1]], torque - columns @ found
    return residual


def _level(residual: np.ndarray, used: np.ndarray, apart: int) -> float:
    """Standard deviation of the noise in differences of samples `apart`; 0 where there are too few."""
    count = len(residual) - (len(DIFFERENCE_WEIGHTS) - 1) * apart
    if count < LOW_PASS_SEARCH_MIN_SAMPLES // 4:
        return 0.0
    differences = sum(w * residual[k * apart :][:count] for k, w in enumerate(DIFFERENCE_WEIGHTS))
    passed = np.concatenate([[0], np.cumsum(~used)])
    whole = passed[len(residual) + 1 - count :] == passed[:count]
    if np.count_nonzero(whole) < LOW_PASS_SEARCH_MIN_SAMPLES // 4:
        return 0.0
    return float(np.median(np.abs(differences[whole])) / ABS_NORMAL_MEDIAN_OVER_STD)


def _passed(frequencies: np.ndarray, spectrum: np.ndarray, apart: float) -> float:
    """Variance of differences of samples `apart` s, from a two-sided spectrum."""
    gain = (2.0 * np.sin(np.pi * frequencies * apart)) ** 8 / 70.0
    return 2.0 * float(np.trapezoid(spectrum * gain, frequencies))


def _fitted(apart: np.ndarray, variance: np.ndarray, brought_in: np.ndarray) -> tuple[float, float, float]:
    """Standard deviations of the noise after the low-pass and before it, and the cut-off, Hz.

    A residual with the lowest cut-off is motion and no filtered noise, and so is one that is better explained by more
    noise of the positions.

    Args:
        apart: (h,) distances, s.
        variance: (h,) variances of the differences.
        brought_in: (h,) the part of them that the positions' noise causes.
    """
    cutoffs = np.geomspace(
        MIN_DRIVE_CUTOFF_HZ, max(MAX_DRIVE_CUTOFF_SHARE_OF_RATE / apart[0], MIN_DRIVE_CUTOFF_HZ), DRIVE_CUTOFFS_TRIED
    )
    wanted = (variance - brought_in) / variance
    fits = [nnls(np.column_stack([1.0 / variance, _shared(cutoff * apart) / variance]), wanted) for cutoff in cutoffs]
    best = int(np.argmin([left for _, left in fits]))
    own, smoothed = np.sqrt(fits[best][0]).tolist()
    # With an unknown payload the positions' noise causes more torque.
    _, beside = nnls(np.column_stack([1.0 / variance, brought_in / variance]), wanted)
    return own, smoothed if best > 0 and fits[best][1] < beside else 0.0, float(cutoffs[best])


def _shared(apart: np.ndarray) -> np.ndarray:
    """(h,) relative variance of differences of filtered noise, between samples (h,) `apart` in units of 1/f_c."""
    lags = np.multiply.outer(np.arange(len(DIFFERENCE_WEIGHTS)), apart)
    correlation = np.interp(lags, LAGS_TIMES_CUTOFF, FILTERED_NOISE_CORRELATION)
    products = np.array(
        [
            (1.0 + (k > 0)) * DIFFERENCE_WEIGHTS[k:] @ DIFFERENCE_WEIGHTS[: len(DIFFERENCE_WEIGHTS) - k]
            for k in range(len(DIFFERENCE_WEIGHTS))
        ]
    )
    return np.asarray(products @ correlation)


_H = (1.0 + FREQUENCIES_OVER_CUTOFF**4) ** -2.0
NOISE_BANDWIDTH_OVER_CUTOFF = np.trapezoid(_H, FREQUENCIES_OVER_CUTOFF)
"""Integral of H over f/f_c."""
LAGS_TIMES_CUTOFF = np.linspace(0.0, 20.0, 801)
FILTERED_NOISE_CORRELATION = (
    np.trapezoid(
        _H * np.cos(2.0 * np.pi * np.multiply.outer(LAGS_TIMES_CUTOFF, FREQUENCIES_OVER_CUTOFF)),
        FREQUENCIES_OVER_CUTOFF,
        axis=1,
    )
    / NOISE_BANDWIDTH_OVER_CUTOFF
)
"""Autocorrelation of filtered noise at `LAGS_TIMES_CUTOFF`, in units of 1/f_c."""
