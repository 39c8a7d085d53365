r"""A drive's low-pass: up to which frequency a recorded torque is the joint's, and how noisy it is below that.

Many drives smooth a torque before they store it. Its neighbouring samples then show next to no noise, while below the
cut-off all of it is there. What no rigid body and no friction of any size explains, the residual of a linear
regression, has the spectrum

    S(f) = S_0 H(f) + S_1 + S_q(f),      H(f) = (1 + (f/f_c)^4)^-2,

S_0 of the noise that a Butterworth filter of second order smoothed forwards and backwards, S_1 of what came after it,
S_q of the torque that the positions' noise causes. It is read from differences of fourth order of samples h apart: each
is a band-pass around 1/(2h), and their median passes over the moments at which friction changes its sign.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import nnls

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.motion import CERTAIN, MeasuredMotion, Motion
from armdyn.recording.differences import NORMAL_MEDIAN

DENSEST = 125.0
"""Samples per second that are looked at; drives smooth well below half of it."""
MOST, FEWEST = 2500, 200
"""Samples of all recordings together that are looked at, and how many there must be."""
ALIKE = 0.01
"""Share by which the sampling rates of recordings that are looked at together differ at most."""
APART = np.array([1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20])
"""Distances, in samples, of those that a difference is taken of."""
LONGEST = 0.11
"""s; the largest of these distances: what is left below 5 Hz is the model's error as much as noise."""
BESIDE = 0.1
"""s left out before and after a moment at which the direction of motion is not known: smoothed friction is no step."""
FADING = (0.03, 0.06, 0.1, 0.15)
"""rad/s; a friction that fades with the speed is a mixture of those that fade over these."""
RIDGE = 1e-10
"""Of a column's square; what the motion does not show stays zero."""
ROUNDING = 1e-10
"""Of the largest column's size; what is below, as gravity on a joint whose axis is vertical, is rounding."""
SMOOTHED = 6.0
"""Density of a torque's noise below the cut-off over that of what came after the low-pass, amplitudes, the median over
joints, from which on drives are said to smooth. Generated robots: up to 4 where they do not, 10 where they do."""
AGREEING = 3
"""Joints that must tell: what is left of one is its model's error as often as a low-pass."""
SLOWEST, FASTEST = 3.0, 0.2
"""Range of cut-offs, in Hz and per sampling rate: what ends below is motion, and above there is too little to see."""
TRIED = 40
"""Cut-offs in that range."""
WEIGHTS = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / np.sqrt(70.0)
"""Of a difference of fourth order, which leaves white noise its variance."""
SHAPE = np.linspace(0.005, 6.0, 1200)
"""f/f_c at which H is added up; beyond, 1e-5 of it is left."""


class Drive(NamedTuple):
    """How a drive smoothed the torque that it stored.

    Attributes:
        cutoff: Hz; infinite where it smoothed nothing.
        noise: standard deviation of white noise, at the recorded rate, as strong as the torque's below the cut-off.
    """

    cutoff: float
    noise: float


class Torque(NamedTuple):
    """A torque as it was recorded.

    Attributes:
        joint: its place in the arm.
        stamps: (n,) s.
        values: (n,) N m or N.
        spectrum: (f,) S_q at frequencies.
        physics: (n, k) what any physics may make of it; (0, 0) of a measured torque.
    """

    joint: int
    stamps: np.ndarray
    values: np.ndarray
    spectrum: np.ndarray
    physics: np.ndarray


class Recorded(NamedTuple):
    """What one recording holds of an arm: its torques by channel, and the motion of all joints."""

    torques: Mapping[str, Torque]
    motion: MeasuredMotion


def smoothing_drives(recordings: Sequence[Recorded], model: pin.Model, frequencies: np.ndarray) -> dict[str, Drive]:
    """What the drives of an arm did, by channel; where they smoothed nothing, without those that tell too little.

    Drives of one arm are alike, and the same in all its recordings, of which one alone may be too short to tell: where
    most torques show a low-pass, all have it, also that of a joint which turns round too often to tell.

    Args:
        recordings: of the arm.
        model: the arm as described.
        frequencies: (f,) Hz of the torques' spectra.
    """
    found, alone, most = dict[str, _Seen](), dict[str, float](), MOST // len(recordings)

    @lru_cache(maxsize=2 * len(recordings))
    def moved(recording: int, stamps: bytes) -> MotionSamples:
        """What rigid bodies make of the motion at some stamps, which torques often share."""
        time = np.frombuffer(stamps)
        return MotionSamples(model, recordings[recording].motion.at(time), time)

    for name in dict.fromkeys(name for recorded in recordings for name in recorded.torques):
        torques = [(i, recorded.torques[name]) for i, recorded in enumerate(recordings) if name in recorded.torques]
        seen = _seen(torques, moved, frequencies, most)
        if isinstance(seen, _Seen):
            found[name] = seen
        else:
            alone[name] = seen
    if len(found) < AGREEING or np.median([one.ratio for one in found.values()]) < SMOOTHED:
        return {name: Drive(np.inf, one.noise) for name, one in found.items()}
    cutoff = float(np.median([one.smoothed.cutoff for one in found.values()]))
    below = float(np.median([one.smoothed.noise / one.noise for one in found.values()]))
    drives = {name: one.smoothed._replace(cutoff=cutoff) for name, one in found.items()}
    return drives | {name: Drive(cutoff, below * noise) for name, noise in alone.items() if noise > 0.0}


class _Seen(NamedTuple):
    """What one torque shows.

    Attributes:
        noise: standard deviation, if it was not smoothed.
        smoothed: what its drive did, if it was.
        ratio: density of the noise below the cut-off over that above, amplitudes.
    """

    noise: float
    smoothed: Drive
    ratio: float


def _seen(
    torques: Sequence[tuple[int, Torque]],
    moved: Callable[[int, bytes], MotionSamples],
    frequencies: np.ndarray,
    most: int,
) -> _Seen | float:
    """What the torque of one joint shows; where there is too little of it, the noise of neighbouring samples alone.

    Args:
        torques: each with the place of its recording.
        moved: motion and regressor of a recording at some stamps.
        frequencies: (f,) Hz.
        most: samples of a recording that are looked at.
    """
    intervals = [float((t.stamps[-1] - t.stamps[0]) / (len(t.stamps) - 1)) for _, t in torques]
    interval = intervals[int(np.argmax([len(t.stamps) for _, t in torques]))]
    every = max(1, int(np.ceil(1.0 / (DENSEST * interval) - 1e-6)))
    step = every * interval
    parts, values, spectra = [], [], []
    for (recording, torque), own in zip(torques, intervals, strict=True):
        if abs(own / interval - 1.0) < ALIKE:
            begin = max(0, (len(torque.stamps) - every * most) // 2)
            time, value = (part[begin::every][:most] for part in (torque.stamps, torque.values))
            parts.append(moved(recording, time.tobytes()))
            values.append(value)
            spectra.append(torque.spectrum)
    joint = torques[0][1].joint
    motion = _one_after_the_other([part.motion for part in parts], step)
    uncertain = np.abs(motion.direction[:, joint]) < CERTAIN
    uncertain[np.cumsum([len(value) for value in values]) - 1] = True  # no difference reaches into another recording
    used = np.convolve(uncertain, np.ones(2 * round(BESIDE / step) + 1), "same")[: len(uncertain)] < 0.5
    apart = APART[APART * step <= LONGEST]
    alone = _level(np.concatenate(values), np.ones(len(used), dtype=bool), 1)
    if np.count_nonzero(used) < FEWEST or len(apart) < 3:
        return alone
    of_links = np.concatenate([part.regressor[:, joint, joint:] for part in parts]).reshape(len(used), -1)
    residual = _unexplained(motion, of_links, joint, np.concatenate(values), used)
    levels = np.array([_level(residual, used, h) for h in apart])
    spectrum = np.average(spectra, axis=0, weights=[len(value) for value in values])
    brought_in = np.array([_passed(frequencies, spectrum, h * step) for h in apart])
    variance = levels**2
    if not np.all(variance > brought_in):
        return alone
    own_noise, smoothed, cutoff = _fitted(apart * step, variance, brought_in)
    below = smoothed / float(np.sqrt(2.0 * cutoff * interval * BANDWIDTH))
    noise = float(np.sqrt(variance[0] - brought_in[0]))
    ratio = below / max(own_noise, np.finfo(float).tiny)
    return _Seen(noise, Drive(cutoff, float(np.hypot(own_noise, below))), ratio)


def _one_after_the_other(motions: Sequence[Motion], step: float) -> Motion:
    """Motions as if each began where the one before ended."""
    q, v, a, way = (np.concatenate([getattr(m, part) for m in motions]) for part in ("q", "v", "a", "direction"))
    begins = np.cumsum([0.0, *(float(m.time[-1] - m.time[0]) + step for m in motions)])
    time = np.concatenate([m.time - m.time[0] + begin for m, begin in zip(motions, begins[:-1], strict=True)])
    return Motion(time, q, v, a, way)


def _unexplained(motion: Motion, regressor: np.ndarray, joint: int, torque: np.ndarray, used: np.ndarray) -> np.ndarray:
    """(n,) what is left of (n,) torques after a regression over the `used` samples.

    Args:
        motion: at the samples.
        regressor: (n, k) torques per inertial parameter of the links that the joint moves.
        joint: its place in the arm.
        torque: (n,).
        used: (n,) bool.
    """
    q, v, a, way = (part[:, joint] for part in (motion.q, motion.v, motion.a, motion.direction))
    fading = [way * np.exp(-((v / speed) ** 2)) for speed in FADING]
    own = [np.ones(len(q)), q, np.sin(q), np.cos(q), v, v * v * way, a, np.gradient(a, motion.time), way, *fading]
    load, left = np.zeros_like(torque), torque
    for _ in range(2):  # frictions that grow with the load follow the load that was found without them
        late = np.gradient(load, motion.time)
        of_load = [way * np.abs(load), late, np.gradient(late, motion.time)]
        columns = np.column_stack([regressor, *own, *of_load])
        sizes = np.linalg.norm(columns[used], axis=0)
        columns /= np.maximum(sizes, ROUNDING * sizes.max())
        normal = columns[used].T @ columns[used] + RIDGE * np.eye(columns.shape[1])
        found = cho_solve(cho_factor(normal), columns[used].T @ torque[used])
        load, left = columns[:, : regressor.shape[1]] @ found[: regressor.shape[1]], torque - columns @ found
    return left


def _level(residual: np.ndarray, used: np.ndarray, apart: int) -> float:
    """Standard deviation that differences of samples `apart` show of noise; 0 where there are too few."""
    count = len(residual) - (len(WEIGHTS) - 1) * apart
    if count < FEWEST // 4:
        return 0.0
    differences = sum(w * residual[k * apart :][:count] for k, w in enumerate(WEIGHTS))
    passed = np.concatenate([[0], np.cumsum(~used)])
    whole = passed[len(residual) + 1 - count :] == passed[:count]
    if np.count_nonzero(whole) < FEWEST // 4:
        return 0.0
    return float(np.median(np.abs(differences[whole])) / NORMAL_MEDIAN)


def _passed(frequencies: np.ndarray, spectrum: np.ndarray, apart: float) -> float:
    """Variance that a two-sided spectrum has in differences of samples `apart` s."""
    gain = (2.0 * np.sin(np.pi * frequencies * apart)) ** 8 / 70.0
    return 2.0 * float(np.trapezoid(spectrum * gain, frequencies))


def _fitted(apart: np.ndarray, variance: np.ndarray, brought_in: np.ndarray) -> tuple[float, float, float]:
    """Standard deviations of what came after the low-pass and of what passed it, and the cut-off, Hz.

    What is best explained by the lowest cut-off that is tried is motion and passed no low-pass, nor did what more of
    the positions' noise explains.

    Args:
        apart: (h,) s.
        variance: (h,) of the differences.
        brought_in: (h,) of it, what the positions' noise causes.
    """
    cutoffs = np.geomspace(SLOWEST, max(FASTEST / apart[0], SLOWEST), TRIED)
    wanted = (variance - brought_in) / variance
    fits = [nnls(np.column_stack([1.0 / variance, _shared(cutoff * apart) / variance]), wanted) for cutoff in cutoffs]
    best = int(np.argmin([left for _, left in fits]))
    own, smoothed = np.sqrt(fits[best][0]).tolist()
    # A payload that nobody knew of makes more torque of the positions' noise.
    _, beside = nnls(np.column_stack([1.0 / variance, brought_in / variance]), wanted)
    return own, smoothed if best > 0 and fits[best][1] < beside else 0.0, float(cutoffs[best])


def _shared(apart: np.ndarray) -> np.ndarray:
    """(h,) variance of differences of smoothed noise, over its own, `apart` (h,) times 1/f_c."""
    lags = np.multiply.outer(np.arange(len(WEIGHTS)), apart)
    correlation = np.interp(lags, LAGS, CORRELATION)
    products = np.array([(1.0 + (k > 0)) * WEIGHTS[k:] @ WEIGHTS[: len(WEIGHTS) - k] for k in range(len(WEIGHTS))])
    return np.asarray(products @ correlation)


_H = (1.0 + SHAPE**4) ** -2.0
BANDWIDTH = np.trapezoid(_H, SHAPE)
"""Of H, over f_c."""
LAGS = np.linspace(0.0, 20.0, 801)
CORRELATION = np.trapezoid(_H * np.cos(2.0 * np.pi * np.multiply.outer(LAGS, SHAPE)), SHAPE, axis=1) / BANDWIDTH
"""Of smoothed noise, at `LAGS` over f_c."""
