"""A run of an arm made ready for comparison: torques low-passed where noise takes over, and thinned until white again.

Measured and predicted torques pass the same filter, as in the parallel filtering of Gautier (ICRA 1997), so that
filtering biases nothing. The cut-off of a joint lies where its measured torque sinks into noise, and at `STIFF` where
above that there is nothing but the sensor's noise: quiet tells as well, of friction's steps and of a ripple that is not
there. It lies lower where noise of the positions, differentiated twice and multiplied by the inertias, would add more
than `TOLERATED`; what it adds is counted as noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from armdyn.arm.motion import MeasuredMotion, measured_motion
from armdyn.channels import MIN_SAMPLES, Channel
from armdyn.errors import InputError
from armdyn.run import Run
from armdyn.smoothing import UNDISTORTED, WHITE, Choice, Curve, LowPass, Samples, best_smoothing

TOLERATED = 0.25
"""Power of the noise from positions over that of the torque sensor, below the cut-off."""
STIFF = 10.0
"""Hz, where the links of arms begin to bend (Swevers, Verdonck & De Schutter, IEEE CSM 27, 2007); up to there quiet is
worth having."""
QUIET = 1.5
"""Of the sensor's noise; what is above the signal's band and larger than this is a ripple that no rigid body makes."""
MARGIN = 0.7
"""Of the frequency where noise takes over; the signal's power is then 16 times the noise's."""
HIGHEST_RATE = 125.0
"""Hz at which samples are kept at most: no arm's rigid-body motion is faster."""
NORMAL_MEDIAN = 0.6745
"""Of the absolute value of normal noise, over its standard deviation."""
EDGE = 0.5
"""Periods of the cut-off that are left out at either end, where smoothing has neighbours on one side only."""
POSTURES = 20
"""Of a run, over which inertias are averaged."""
FEWEST = 20
"""Samples of a torque that are left at least, where there were so many."""
CERTAIN = 0.99
"""Expected sign of a velocity from which its sign is known."""
BRIEF = 0.25
"""Periods of the cut-off; a gap that is shorter leaves the low-passed torque as it was."""


@dataclass(frozen=True, eq=False)
class PreparedRun(Run):
    """A run whose torques were low-passed; `ArmModel.predict` filters its prediction for it in the same way.

    Its `noise` is that of the thinned torques, estimated where the recording states none.

    Attributes:
        original: the recording.
        cutoffs: Hz by torque channel.
    """

    original: Run | None = None
    cutoffs: Mapping[str, float] = field(default_factory=dict)

    def __reduce__(self) -> tuple[type[Run], tuple[Any, ...]]:
        mappings = (dict(self.channels), dict(self.known), dict(self.noise))
        rest = (self.description, self.source, self.warnings, self.original, dict(self.cutoffs))
        return PreparedRun, (self.name, *mappings, *rest)


@dataclass(frozen=True, eq=False)
class _Torque:
    """One measured torque: (n,) stamps and values without the ends, how it is best smoothed, and its noise."""

    stamps: np.ndarray
    values: np.ndarray
    choice: Choice
    noise: float

    @property
    def interval(self) -> float:
        """Between samples, s."""
        return float((self.stamps[-1] - self.stamps[0]) / (len(self.stamps) - 1))

    @property
    def quiet(self) -> bool:
        """Whether above the signal's own band there is but the noise; a few steps of friction do not count."""
        smooth = LowPass(Samples(self.stamps, UNDISTORTED / self.choice.cutoff), self.choice.cutoff).curve(self.values)
        rest = self.values - smooth(self.stamps)[:, 0]
        return float(np.median(np.abs(rest))) / NORMAL_MEDIAN < QUIET * self.noise


def _torque(run: Run, name: str, motion: MeasuredMotion) -> _Torque:
    raw = run.require_informative(name)
    keep = interior(raw, motion)
    stamps, values = raw.time[keep], raw.value[keep]
    choice = best_smoothing(stamps, values)
    return _Torque(stamps, values, choice, run.noise.get(name) or choice.noise)


def prepare(run: Run, model: pin.Model, joints: tuple[str, ...], measured: tuple[str, ...]) -> PreparedRun:
    """The run with its torques low-passed and thinned, and its motion smoothed.

    Args:
        run: a recording.
        model: the arm as described.
        joints: all joints of the arm, in its order.
        measured: torque channels to prepare.

    Raises:
        InputError: a torque is constant or too short.
    """
    motion = measured_motion(run, joints)
    frequencies = np.linspace(0.0, HIGHEST_RATE / (2.0 * WHITE), 500)
    brought_in = _position_noise(model, motion, frequencies)
    channels = dict(run.channels)
    noise, cutoffs = dict(run.noise), {}
    torques = {name: _torque(run, name, motion) for name in measured}
    # A servo's ripple reaches every joint, and joints with another band each would not be weighed alike.
    band = STIFF if all(torque.quiet for torque in torques.values()) else 0.0
    for name, torque in torques.items():
        j = joints.index(name.removeprefix("tau."))
        # The noise that residuals are held against is the one that noise from positions must stay below.
        sensor = torque.noise**2 * torque.interval
        below = np.cumsum(brought_in[j]) <= TOLERATED * sensor * np.arange(len(frequencies))
        useful = max(MARGIN * torque.choice.cutoff, band)
        cutoff = _enough(min(float(frequencies[below].max()), useful), torque.stamps)
        time = _thinned(torque.stamps, cutoff)
        known = settled(motion, j, torque.stamps, cutoff)
        low = LowPass(Samples(torque.stamps[known], UNDISTORTED / cutoff), cutoff).curve(torque.values[known])
        channels[name] = Channel(time, low(time)[:, 0], run.channels[name].unit)
        cutoffs[name] = cutoff
        # Thinned samples vary too much to show their noise; the recording at its own rate does.
        kept = min(torque.interval / float(np.median(np.diff(time))), 1.0)
        from_positions = 2.0 * float(np.sum(brought_in[j, frequencies <= cutoff]) * frequencies[1])
        noise[name] = float(np.sqrt(kept * torque.noise**2 + from_positions))
    for i, joint in enumerate(joints):
        channels |= _smooth_channels(run.channels[f"q.{joint}"], joint, motion.joints[i].curve)
    return PreparedRun(run.name, channels, run.known, noise, run.description, run.source, run.warnings, run, cutoffs)


def interior(channel: Channel, motion: MeasuredMotion) -> np.ndarray:
    """(n,) bool: samples that were taken while the motion was recorded, but not at its ends.

    At an end a smoothed acceleration leans on one side only and is several times less certain.

    Raises:
        InputError: hardly any.
    """
    edge = EDGE * max(1.0 / j.choice.cutoff for j in motion.joints)
    edge = min(edge, 0.1 * (motion.end - motion.start))
    keep = (channel.time >= motion.start + edge) & (channel.time <= motion.end - edge)
    if np.count_nonzero(keep) < MIN_SAMPLES:
        raise InputError(
            f"torques from {channel.time[0]:g} to {channel.time[-1]:g} s and positions from {motion.start:g} to "
            f"{motion.end:g} s were not recorded together: record them in one run"
        )
    return keep


def settled(motion: MeasuredMotion, joint: int, stamps: np.ndarray, cutoff: float) -> np.ndarray:
    """(n,) bool: samples at which it is known which way the joint moves, and those where it stands for long.

    Where a joint turns round, its dry friction changes sign at a moment that is less certain than the stamps: one
    sample of a friction that is 25 times the noise, on the wrong side, is an error of 3 standard deviations after the
    low-pass. Those few samples are left out of the measured and of the predicted torque.
    """
    uncertain = np.abs(motion.direction(joint, stamps)) < CERTAIN
    edges = np.flatnonzero(np.diff(np.concatenate([[False], uncertain, [False]]).astype(int)))
    for begin, end in edges.reshape(-1, 2):
        if stamps[end - 1] - stamps[begin] > BRIEF / cutoff:
            uncertain[begin:end] = False
    return ~uncertain


def _position_noise(model: pin.Model, motion: MeasuredMotion, frequencies: np.ndarray) -> np.ndarray:
    """(nj, nf) spectrum, (N m)^2/Hz, of the torque that the noise of all smoothed positions causes, at (nf,) Hz.

    A small error e of the positions changes the torque by M(q) e'' + dg/dq e; squared factors are averaged over the
    run's postures.
    """
    data = model.createData()
    squares = np.zeros((model.nv, model.nv, len(frequencies)))
    for q in motion.at(np.linspace(motion.start, motion.end, POSTURES)).q:
        mass = np.triu(pin.crba(model, data, q))
        stiffness = pin.computeGeneralizedGravityDerivatives(model, data, q)
        inertial = np.multiply.outer(mass + np.triu(mass, 1).T, (2.0 * np.pi * frequencies) ** 2)
        squares += (stiffness[:, :, None] - inertial) ** 2 / POSTURES
    choices = [j.choice for j in motion.joints]
    passed = [1.0 / (1.0 + (frequencies / c.cutoff) ** (2 * c.order)) ** 2 for c in choices]
    spectra = np.array([j.choice.noise**2 * j.interval for j in motion.joints])[:, None] * np.array(passed)
    return np.asarray(np.einsum("jif,if->jf", squares, spectra))


def _enough(cutoff: float, stamps: np.ndarray) -> float:
    """The cut-off within what leaves enough samples and not too many, Hz."""
    per_second = min(FEWEST, len(stamps) // 3) / float(stamps[-1] - stamps[0])
    return min(max(cutoff, per_second / (2.0 * WHITE)), HIGHEST_RATE / (2.0 * WHITE))


def _thinned(stamps: np.ndarray, cutoff: float) -> np.ndarray:
    """Even times at which a signal with this cut-off is sampled, without those in gaps of the stamps."""
    step = 1.0 / (2.0 * WHITE * cutoff)
    edge = min(EDGE / cutoff, 0.1 * (stamps[-1] - stamps[0]))
    first, last = stamps[0] + edge, stamps[-1] - edge
    count = int((last - first) / step)
    time = first + (last - first - count * step) / 2.0 + step * np.arange(count + 1)
    after = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
    nearest = np.minimum(np.abs(time - stamps[after - 1]), np.abs(stamps[after] - time))
    return time[nearest <= step / 2.0]


def _smooth_channels(q: Channel, joint: str, curve: Curve) -> dict[str, Channel]:
    units = (q.unit, f"{q.unit}/s", f"{q.unit}/s^2")
    return {
        f"{kind}.{joint}": Channel(q.time, curve(q.time, k)[:, 0], unit)
        for k, (kind, unit) in enumerate(zip("qva", units, strict=True))
    }
