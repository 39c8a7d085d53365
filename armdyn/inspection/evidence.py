r"""Bayesian evidence of recorded values under a hypothesis on their meaning, for a model that may lack effects.

A hypothesis says, for example, that the values are in degrees.
With the prediction f of the model, the derivatives X by the sizes of effects and their typical sizes W,

    y = f + X theta + e,    theta ~ N(0, s^2 W^2),    e_j ~ N(0, sigma_j^2 I)  for every channel j,

the effects theta are integrated out. The size s of everything that a description lacks is common to all effects and is
unknown: it is estimated, so that a good description is trusted (empirical Bayes; MacKay, Neural Computation 4, 1992).
sigma_j is unknown too, and includes the model's own error, so that neighbouring samples are correlated: n samples count
as n over their correlation time. Sizes that cannot be negative, such as frictions and masses, are left out where they
would be.

If the true values are k y, because y was recorded in a wrong unit, the probability of y is that of k y times k^n.
"""

from dataclasses import dataclass

import numpy as np

from armdyn.linear.correlation import correlation_time
from armdyn.linear.solve import log_det, solve_bounded

MISSING_EFFECT_TYPICAL_SIZES_TRIED = (0.1, 0.3, 1.0, 3.0)
"""Sizes of missing effects that are tried, in their typical sizes."""
MIN_MODEL_ERROR_SHARE_OF_RMS = 0.1
"""Model error that every model may have, as a share of a channel's root mean square. A mistake makes a larger one; with
0.03 a real arm whose joints move one at a time (six at rest, whose torques contain no information) seems to have
exchanged joints."""
MIN_INDEPENDENT_SHARE_OF_SAMPLES = 0.1
"""Least number of independent samples per sample of a signal that changes."""
NOISE_ESTIMATION_ROUNDS = 3
"""Number of iterations that estimate the noise; the evidence then changes by less than a nat."""


@dataclass(frozen=True, eq=False)
class ChannelReadings:
    """Readings of J channels at n moments, with the prediction of a model.

    Attributes:
        measured: (J, n) readings.
        described: (J, n) prediction of the model without further effects.
        columns: (J, n, p) derivatives by the effects' sizes, times their typical sizes.
        positive: (p,) bool, True for sizes that cannot be negative.
        weight: (J,) number of independent samples per sample.
        log_factor: (J,) logarithm of the factor by which a correction scaled the readings.
        min_rms: (J,) root mean square below which a channel is ignored.
        model_error_floor: error that every model of this kind may have, as a share of a channel's root mean square.
    """

    measured: np.ndarray
    described: np.ndarray
    columns: np.ndarray
    positive: np.ndarray
    weight: np.ndarray
    log_factor: np.ndarray
    min_rms: np.ndarray
    model_error_floor: float = MIN_MODEL_ERROR_SHARE_OF_RMS


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of readings for one hypothesis.

    Attributes:
        value: log evidence, nats.
        residual: (J, n) residual of the best prediction.
        share: (J,) residual share of each channel's mean square.
        sizes: (p,) estimated sizes of the effects, in typical sizes.
    """

    value: float
    residual: np.ndarray
    share: np.ndarray
    sizes: np.ndarray


def best_evidence(given: ChannelReadings) -> Evidence:
    """Evidence of readings, for the most probable of `MISSING_EFFECT_TYPICAL_SIZES_TRIED`."""
    gap = given.measured - given.described
    scale = np.maximum(np.sqrt(np.mean(given.measured**2, axis=1)), given.min_rms)
    grams = np.swapaxes(given.columns, 1, 2) @ given.columns
    slopes = np.einsum("jnp,jn->jp", given.columns, gap)
    size = np.array(MISSING_EFFECT_TYPICAL_SIZES_TRIED)[:, None]
    lower = np.where(given.positive, 0.0, -np.inf)
    variance = np.tile(
        np.maximum((0.1 * scale) ** 2, 0.01 * np.mean(gap**2, axis=1)), (len(MISSING_EFFECT_TYPICAL_SIZES_TRIED), 1)
    )

    def spread() -> np.ndarray:
        """(s, p, p) information of the readings on the sizes, with their prior."""
        G = np.tensordot(given.weight / variance, grams, axes=1)
        return np.asarray(np.eye(G.shape[1]) + size[:, :, None] ** 2 * G)

    for _ in range(NOISE_ESTIMATION_ROUNDS):
        found = solve_bounded(spread(), size**2 * ((given.weight / variance) @ slopes), lower, np.inf)
        theta, free = found.x, found.on_bound == 0
        residual = gap - np.moveaxis(given.columns @ theta.T, 2, 0)
        variance = np.mean(residual**2, axis=2) + (given.model_error_floor * scale) ** 2
    half = 0.5 * log_det(np.where(free[:, :, None] & free[:, None, :], spread(), np.eye(free.shape[1])))
    share = given.weight / variance
    value = -0.5 * (np.sum(share * np.sum(residual**2, axis=2), axis=1) + np.sum((theta / size) ** 2, axis=1)) - half
    value += gap.shape[1] * np.sum(given.weight * (given.log_factor - 0.5 * np.log(variance)), axis=1)
    best = int(np.argmax(value))
    return Evidence(float(value[best]), residual[best], np.mean(residual[best] ** 2, axis=1) / scale**2, theta[best])


def independent_sample_share(
    measured: np.ndarray, residual: np.ndarray, min_rms: np.ndarray, after: np.ndarray | None = None
) -> np.ndarray:
    """(J,) number of independent samples per sample of (J, n) readings.

    The model's error is correlated as the residual is, and many samples of a constant reading count as one.

    Args:
        measured: (J, n) readings.
        residual: (J, n) residuals of a model.
        min_rms: (J,) root mean square below which a reading is ignored.
        after: (J, n) readings a short time later, whose correlation shows whether a reading changes; by default the
            next samples.
    """
    alone = np.array([1.0 / correlation_time([row]) for row in residual])
    centred = measured - measured.mean(axis=1, keepdims=True)
    before, then = (
        (centred[:, :-1], centred[:, 1:]) if after is None else (centred, after - after.mean(axis=1, keepdims=True))
    )
    moves = np.maximum(np.mean(before * then, axis=1), 0.0)
    floor = MIN_MODEL_ERROR_SHARE_OF_RMS**2 * np.maximum(np.mean(measured**2, axis=1), min_rms**2)
    return np.asarray(
        1.0 / measured.shape[1] + np.maximum(alone, MIN_INDEPENDENT_SHARE_OF_SAMPLES) * (moves / (moves + floor)) ** 2
    )
