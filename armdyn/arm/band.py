"""Up to which frequency measured and predicted torques of a recording can be compared.

Torques are compared up to `STIFF` at least, and up to the end of the torque's own band where that is higher. The band
is narrower only where the positions are too noisy: their noise, differentiated twice and multiplied by the inertias,
grows like f^2, and above some frequency it causes more of the predicted torque than there is measured torque.
"""

import numpy as np
import pinocchio as pin

from armdyn.arm.motion import MeasuredMotion
from armdyn.smoothing import HIGHEST, WHITE, Choice

STIFF = 10.0
"""Hz, where the links of arms begin to bend (Swevers, Verdonck & De Schutter, IEEE CSM 27, 2007)."""
MARGIN = 0.7
"""Of the frequency where a torque sinks into its noise; the power of the signal is then 16 times that of the noise."""
HIGHEST_RATE = 125.0
"""Hz at which samples are kept at most: no arm's rigid-body motion is faster."""
FEWEST = 20
"""Samples of a torque that are left at least, where there were so many."""
POSTURES = 20
"""Of a run, over which inertias are averaged."""
FREQUENCIES = np.linspace(0.0, HIGHEST_RATE / (2.0 * WHITE), 701)
"""Hz at which the noise of positions is worked out."""


def cutoff_of(stamps: np.ndarray, torque: np.ndarray, choice: Choice, brought_in: np.ndarray) -> float:
    """The cut-off, Hz, under which as much as possible of a torque is compared with as little as possible of noise.

    It is the f up to `STIFF`, or the torque's own band, that maximises int_0^f S(f') - P(f') df', S the spectrum of the
    measured torque, P that of the torque that the positions' noise causes: the last frequency at which there is more to
    see than is brought in. A torque that was smoothed before it was stored ends where its smoothing ended.

    Args:
        stamps: (n,) s.
        torque: (n,) N m or N.
        choice: how the torque is best smoothed: where it sinks into its noise.
        brought_in: (nf,) P at `FREQUENCIES`, see `position_noise`.
    """
    interval = float((stamps[-1] - stamps[0]) / (len(stamps) - 1))
    as_recorded, per_second = 1.0 / interval, min(FEWEST, len(stamps) // 3) / float(stamps[-1] - stamps[0])
    # A torque that shows no noise up to the highest cut-off that was tried shows no end of its band either.
    own_band = MARGIN * choice.cutoff if choice.cutoff < 0.99 * HIGHEST / interval else 0.0
    widest = min(max(STIFF, own_band), float(FREQUENCIES[-1]))
    frequencies, measured = _spectrum(stamps, torque, interval)
    frequencies, measured = frequencies[frequencies <= widest], measured[frequencies <= widest]
    last = int(np.argmax(np.cumsum(measured - np.interp(frequencies, FREQUENCIES, brought_in))))
    useful = widest if last == len(frequencies) - 1 else float(frequencies[last])
    return min(max(2.0 * WHITE * useful, per_second), as_recorded) / (2.0 * WHITE)


def position_noise(model: pin.Model, motion: MeasuredMotion) -> np.ndarray:
    """(nj, nf) spectrum, (N m)^2/Hz, of the torque that the noise of all smoothed positions causes, at `FREQUENCIES`.

    A small error e of the positions changes the torque by M(q) e'' + dg/dq e; squared factors are averaged over the
    run's postures.
    """
    data = model.createData()
    squares = np.zeros((model.nv, model.nv, len(FREQUENCIES)))
    for q in motion.at(np.linspace(motion.start, motion.end, POSTURES)).q:
        mass = np.triu(pin.crba(model, data, q).reshape(model.nv, model.nv))
        stiffness = pin.computeGeneralizedGravityDerivatives(model, data, q).reshape(model.nv, model.nv)
        inertial = np.multiply.outer(mass + np.triu(mass, 1).T, (2.0 * np.pi * FREQUENCIES) ** 2)
        squares += (stiffness[:, :, None] - inertial) ** 2 / POSTURES
    choices = [j.choice for j in motion.joints]
    passed = [1.0 / (1.0 + (FREQUENCIES / c.cutoff) ** (2 * c.order)) ** 2 for c in choices]
    spectra = np.array([j.choice.noise**2 * j.interval for j in motion.joints])[:, None] * np.array(passed)
    return np.asarray(np.einsum("jif,if->jf", squares, spectra))


def _spectrum(stamps: np.ndarray, values: np.ndarray, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and the two-sided power density there of a signal less its mean, under a Hann window."""
    even = stamps[0] + interval * np.arange(len(stamps))
    window = np.hanning(len(stamps) + 2)[1:-1]
    signal = np.interp(even, stamps, values)
    power = np.abs(np.fft.rfft(window * (signal - np.average(signal, weights=window)))) ** 2
    return np.fft.rfftfreq(len(stamps), interval), interval * power / float(window @ window)
