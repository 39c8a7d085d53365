"""A run of an arm made ready for comparison: torques low-passed where noise takes over, and thinned until white again.

Measured and predicted torques pass the same filter, as in the parallel filtering of Gautier (ICRA 1997), so that
filtering biases nothing. The cut-off of a joint lies below three frequencies: where its measured torque has as much
noise as signal, where the noise of the positions, differentiated twice and multiplied by the inertias, reaches that of
the torque sensor (both with a margin of 0.7), and where the measured position has as much noise as signal.
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
from armdyn.smoothing import UNDISTORTED, WHITE, Curve, LowPass, Samples, best_smoothing

MARGIN = 0.7
"""Of the frequency where noise takes over; the signal's power is then 16 times the noise's, or noise from positions
adds a twentieth to that of the torque sensor."""
HIGHEST_RATE = 125.0
"""Hz at which samples are kept at most: no arm's rigid-body motion is faster."""
EDGE = 0.5
"""Periods of the cut-off that are left out at either end, where smoothing has neighbours on one side only."""
POSTURES = 20
"""Of a run, over which inertias are averaged."""
FEWEST = 20
"""Samples of a torque that are left at least, where there were so many."""


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
    position_noise = _position_noise(model, motion)
    channels = dict(run.channels)
    noise, cutoffs = dict(run.noise), {}
    for name in measured:
        raw = run.require_informative(name)
        keep = interior(raw, motion)
        stamps = raw.time[keep]
        choice = best_smoothing(stamps, raw.value[keep])
        interval = float((stamps[-1] - stamps[0]) / (len(stamps) - 1))
        j = joints.index(name.removeprefix("tau."))
        # Spectra, in (N m)^2/Hz: of the torque sensor, and of what positions bring in per (2 pi f)^4.
        sensor, brought_in = choice.noise**2 * interval, position_noise[j]
        crossing = (sensor / brought_in) ** 0.25 / (2.0 * np.pi) if brought_in > 0 and sensor > 0 else np.inf
        lowest = min(MARGIN * choice.cutoff, MARGIN * crossing, motion.joints[j].choice.cutoff)
        cutoff = _enough(float(lowest), stamps)
        time = _thinned(stamps, cutoff)
        low = LowPass(Samples(stamps, UNDISTORTED / cutoff), cutoff).curve(raw.value[keep])
        channels[name] = Channel(time, low(time)[:, 0], raw.unit)
        cutoffs[name] = cutoff
        # Thinned samples vary too much to show their noise; the recording at its own rate does.
        kept = min(interval / float(np.median(np.diff(time))), 1.0)
        noise[name] = noise.get(name, choice.noise) * float(np.sqrt(kept))
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


def _position_noise(model: pin.Model, motion: MeasuredMotion) -> np.ndarray:
    """(nj,) spectrum of the torque that the noise of all positions causes, over (2 pi f)^4: (N m)^2/Hz s^4."""
    data = model.createData()
    postures = motion.at(np.linspace(motion.start, motion.end, POSTURES)).q
    squares = np.zeros((model.nv, model.nv))
    for q in postures:
        mass = np.triu(pin.crba(model, data, q))
        squares += (mass + np.triu(mass, 1).T) ** 2 / POSTURES
    return squares @ np.array([j.choice.noise**2 * j.interval for j in motion.joints])


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
