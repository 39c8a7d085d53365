r"""How a load may have swung when a recording began: the phase plane, from hanging at rest to going round.

A free swing of amplitude A passes the angle phi at the rate phi' = ± sqrt(2 g/l (cos phi - cos A)). Which orbit it was
and where on it the recording began is what a load cell does not say and a fit cannot guess: at angle and rate 0 every
derivative with respect to the start vanishes by symmetry.
"""

import numpy as np

from armdyn.pendulum.physics import STANDARD_GRAVITY

AMPLITUDES = (0.06, 0.2, 0.45, 0.8, 1.2, 1.7, 2.3, 2.8, 3.05)
"""rad; neighbours are so far apart as a few Gauss-Newton steps over one period bridge."""
PHASES = 8
"""Places on each orbit."""
WHIRLS = (1.2,)
"""Rates at the lowest point, over that which just reaches the upright."""


def phase_plane(length: float) -> np.ndarray:
    """(C, 2) angles (rad) and rates (rad/s) of a swing, hanging at rest first, then orbits of growing energy.

    Args:
        length: pivot to the load's centre, m.
    """
    pace = np.sqrt(STANDARD_GRAVITY / length)
    starts = [(0.0, 0.0)]
    for amplitude in AMPLITUDES:
        for phase in 2 * np.pi * np.arange(PHASES) / PHASES:
            # Even steps along the orbit of a pendulum in sin(phi/2) = k sin(psi).
            k = np.sin(amplitude / 2)
            starts.append((2 * np.arcsin(k * np.cos(phase)), -2 * pace * k * np.sin(phase)))
    for whirl in WHIRLS:
        for angle in 2 * np.pi * (np.arange(PHASES // 2) / (PHASES // 2) - 0.5):
            rate = 2 * pace * np.sqrt(whirl**2 - np.sin(angle / 2) ** 2)
            starts += [(angle, rate), (angle, -rate)]
    return np.array(starts)


def rates_near(length: float) -> np.ndarray:
    """(7,) rad/s by which a rate from a noisy angle may be off, 0 first; `length` m."""
    return np.sqrt(STANDARD_GRAVITY / length) * np.array([0.0, -0.03, 0.03, -0.1, 0.1, -0.3, 0.3])
