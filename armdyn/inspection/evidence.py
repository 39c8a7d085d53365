r"""How probable readings are under a model whose every effect may be there, in sizes that effects have.

With the described prediction f, columns X of what effects change and their typical sizes W,

    y = f + X theta + e,    theta ~ N(0, s^2 W^2),    e_j ~ N(0, sigma_j^2 I)  for every channel j,

theta leaves by integration. The size s of everything that a description lacks is common to all effects and unknown: a
good description is believed to be good (empirical Bayes; MacKay, Neural Computation 4, 1992). sigma_j is unknown too,
and the model's own error is part of it, so that neighbouring samples say the same: n samples count as n over their
correlation time. Sizes that cannot be negative, frictions and masses, are left out where they would be.

Readings y' = k y are as probable as y times k^n, which is the only difference between hypotheses in other units.
"""

from dataclasses import dataclass

import numpy as np

from armdyn.identify.noise import correlation_time
from armdyn.linear.solve import log_det, solve_bounded

SIZES = (0.1, 0.3, 1.0, 3.0)
"""s: how much a description lacks, in what effects typically are."""
FLOOR = 0.1
"""Of a channel's root mean square: error that any model may have. A mistake makes more; with 0.03 a real arm of which
one joint moves at a time (six standing ones, whose torques say nothing) seems to have exchanged joints."""
SLOWEST = 0.1
"""Independent samples per sample of a reading that changes, at least."""
ROUNDS = 3
"""In which sigma settles; the evidence then changes by less than a nat."""


@dataclass(frozen=True, eq=False)
class Channels:
    """Readings of J channels at n moments against what a model says.

    Attributes:
        measured: (J, n).
        described: (J, n) prediction of the model as it is.
        columns: (J, n, p) derivatives by the effects' sizes, over their typical sizes.
        positive: (p,) bool, sizes that cannot be negative.
        weight: (J,) independent samples per sample.
        volume: (J,) logarithm of how much the readings were scaled.
        least: (J,) root mean square below which a channel is not worth telling.
        floor: of a channel's root mean square: error that any model of this kind may have.
    """

    measured: np.ndarray
    described: np.ndarray
    columns: np.ndarray
    positive: np.ndarray
    weight: np.ndarray
    volume: np.ndarray
    least: np.ndarray
    floor: float = FLOOR


@dataclass(frozen=True, eq=False)
class Evidence:
    """What readings say of one hypothesis.

    Attributes:
        value: nats.
        left: (J, n) measured minus the best prediction.
        share: (J,) of each channel's mean square that is left.
        sizes: (p,) of the effects, over their typical sizes.
    """

    value: float
    left: np.ndarray
    share: np.ndarray
    sizes: np.ndarray


def evidence(given: Channels) -> Evidence:
    """The best over `SIZES`, all of which are worked out at once."""
    gap = given.measured - given.described
    scale = np.maximum(np.sqrt(np.mean(given.measured**2, axis=1)), given.least)
    grams = np.swapaxes(given.columns, 1, 2) @ given.columns
    slopes = np.einsum("jnp,jn->jp", given.columns, gap)
    size = np.array(SIZES)[:, None]
    lower = np.where(given.positive, 0.0, -np.inf)
    variance = np.tile(np.maximum((0.1 * scale) ** 2, 0.01 * np.mean(gap**2, axis=1)), (len(SIZES), 1))
    left, free = np.tile(gap, (len(SIZES), 1, 1)), np.ones((len(SIZES), given.columns.shape[2]), dtype=bool)

    def spread() -> np.ndarray:
        """(s, p, p) what the readings say of the sizes beside what is believed of them."""
        G = np.tensordot(given.weight / variance, grams, axes=1)
        return np.asarray(np.eye(G.shape[1]) + size[:, :, None] ** 2 * G)

    for _ in range(ROUNDS):
        found = solve_bounded(spread(), size**2 * ((given.weight / variance) @ slopes), lower, np.inf)
        theta, free = found.x, found.held == 0
        left = gap - np.moveaxis(given.columns @ theta.T, 2, 0)
        variance = np.mean(left**2, axis=2) + (given.floor * scale) ** 2
    half = 0.5 * log_det(np.where(free[:, :, None] & free[:, None, :], spread(), np.eye(free.shape[1])))
    share = given.weight / variance
    value = -0.5 * (np.sum(share * np.sum(left**2, axis=2), axis=1) + np.sum((theta / size) ** 2, axis=1)) - half
    value += gap.shape[1] * np.sum(given.weight * (given.volume - 0.5 * np.log(variance)), axis=1)
    best = int(np.argmax(value))
    return Evidence(float(value[best]), left[best], np.mean(left[best] ** 2, axis=1) / scale**2, theta[best])


def independent(
    measured: np.ndarray, left: np.ndarray, least: np.ndarray, after: np.ndarray | None = None
) -> np.ndarray:
    """(J,) independent samples per sample of (J, n) readings as recorded.

    What a model lacks changes as slowly as what it leaves, (J, n), and where a reading stays as it is, many samples of
    it say no more than one; `least` as in `Channels`. Whether it changes show the readings shortly `after`, (J, n), by
    what they have in common; those of the next moments where they are not given.
    """
    alone = np.array([1.0 / correlation_time([row]) for row in left])
    centred = measured - measured.mean(axis=1, keepdims=True)
    before, then = (
        (centred[:, :-1], centred[:, 1:]) if after is None else (centred, after - after.mean(axis=1, keepdims=True))
    )
    moves = np.maximum(np.mean(before * then, axis=1), 0.0)
    floor = FLOOR**2 * np.maximum(np.mean(measured**2, axis=1), least**2)
    return np.asarray(1.0 / measured.shape[1] + np.maximum(alone, SLOWEST) * (moves / (moves + floor)) ** 2)
