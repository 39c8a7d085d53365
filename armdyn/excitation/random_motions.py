"""Random Fourier series as large as the limits allow: what a motion is compared with, and where a search starts."""

import numpy as np

from armdyn.excitation.design import Design
from armdyn.excitation.series import FEWEST_HARMONICS

CENTRAL = 0.7
"""Of the range of positions from which the centre of a random motion is drawn."""
HALVINGS = 6
"""Of the interval in which a motion's largest size is looked for."""
TRIES = 200
"""Centres that are drawn before there is taken to be none at which the arm can stand."""


def random_motion(design: Design, rng: np.random.Generator) -> np.ndarray | None:
    """(nj, size) coefficients of a random motion, None where no posture was found about which the arm could move.

    The number of harmonics is random as well. Every joint moves as far and as fast as its own limits allow; then the
    whole motion is made smaller until torques suffice and no posture of the grid is forbidden.
    """
    series, room = design.series, design.room
    centre = _centre(design, rng)
    if centre is None:
        return None
    x = rng.standard_normal((len(centre), series.size)) @ series.low(
        int(rng.integers(FEWEST_HARMONICS, series.harmonics + 1))
    )
    x[:, 0] = 0.0
    q, v, a = (np.abs(B @ x.T).max(axis=0) for B in design.finer)
    apart = np.minimum(room.upper - centre, centre - room.lower)
    x *= np.min([apart / q, room.velocity / v, room.acceleration / a], axis=0)[:, None]
    x[:, 0] = centre
    low, high = 0.0, 1.0
    if _allowed(design, x):
        return x
    for _ in range(HALVINGS):
        size = (low + high) / 2.0
        low, high = (size, high) if _allowed(design, scaled(x, size)) else (low, size)
    return scaled(x, low) if low > 0.0 else None


def scaled(x: np.ndarray, size: float) -> np.ndarray:
    """The motion made smaller about its centre."""
    smaller = size * x
    smaller[:, 0] = x[:, 0]
    return smaller


def _centre(design: Design, rng: np.random.Generator) -> np.ndarray | None:
    room = design.room
    still = np.zeros((len(room.half), design.series.size))
    for _ in range(TRIES):
        centre = room.middle + CENTRAL * room.half * rng.uniform(-1.0, 1.0, len(room.half))
        still[:, 0] = centre
        if design.postures.free(centre) and design.excess(still) <= 0.0:
            return centre
    return None


def _allowed(design: Design, x: np.ndarray) -> bool:
    if design.excess(x) > 0.0:
        return False
    q = design.motion(x).q
    # Postures far apart first: a motion that is too large mostly shows it at once.
    order = np.argsort(np.arange(len(q)) * 0.6180339887 % 1.0)
    return all(design.postures.free(posture) for posture in q[order])
