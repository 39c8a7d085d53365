r"""Bayesian evidence of recorded values under a hypothesis on their meaning, for a model that may lack effects.

A hypothesis says, for example, that the values are in degrees.
With the prediction f of the model, the derivatives X by the sizes of effects and their typical sizes W,

    y = f + X theta + e,    theta_k ~ N(0, s_k^2 W^2),    e_j ~ N(0, sigma_j^2 I)  for every channel j,

the sizes theta of all effects are integrated out. How large effects of one kind k are, such as the gains of all torque
sensors, is common to them and unknown: s_k is estimated for each kind, so that a good description is trusted, and an
arm whose torque constants are off by a half is nothing special (empirical Bayes; MacKay, Neural Computation 4, 1992).
sigma_j is unknown too, and includes the model's own error, so that neighbouring samples are correlated: n samples count
as n over their correlation time. Effects that would be on their bound at zero, such as a friction, are left out; one on
another bound is the less probable, the more the readings pull it beyond.

Only the sums X'X, X'r and r'r of each channel matter, so that recordings with common effects are judged together by
joining their sums.

If the true values are k y, because y was recorded in a wrong unit, the probability of y is that of k y times k^n.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armdyn.estimation.correlation import correlation_time
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.solve import inverse_positive, log_det, solve_bounded

SIZE_RANGE_OF_MISSING_EFFECTS, LARGEST_SIZE_OF_BOUNDED_EFFECTS = (0.1, 3.0), 10.0
"""Range of the common size of the missing effects of one kind, in their typical sizes; and the largest one of effects
that are bounded on both sides, such as gains, whose bounds say what is possible."""
MIN_MODEL_ERROR_SHARE_OF_RMS = 0.1
"""Model error that every model may have, as a share of a channel's root mean square. A mistake makes a larger one; with
0.03 a real arm whose joints move one at a time (six at rest, whose torques contain no information) seems to have
exchanged joints."""
MIN_INDEPENDENT_SHARE_OF_SAMPLES = 0.1
"""Least number of independent samples per sample of a signal that changes."""
ESTIMATION_ROUNDS = 8
"""Number of iterations that estimate the noise and the sizes of missing effects; the evidence then changes by less than
a nat."""


@dataclass(frozen=True, eq=False)
class EffectSizes:
    """Prior knowledge on the sizes of p effects, in their typical sizes.

    Attributes:
        kind: (p,) index of each effect's kind; effects of one kind are of a common size.
        lower: (p,) least sizes, minus infinity for none.
        upper: (p,) largest sizes, infinity for none.
    """

    kind: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True, eq=False)
class ChannelReadings:
    """Readings of J channels at n moments, with the prediction of a model.

    Attributes:
        measured: (J, n) readings.
        described: (J, n) prediction of the model without further effects.
        columns: (J, n, p) derivatives by the effects' sizes, times their typical sizes.
        sizes: prior knowledge on the effects.
        weight: (J,) number of independent samples per sample.
        log_factor: (J,) logarithm of the factor by which a correction scaled the readings.
        min_rms: (J,) root mean square below which a channel is ignored.
        model_error_floor: error that every model of this kind may have, as a share of a channel's root mean square.
        log_odds: further log odds of the hypothesis, nats, such as a price of positions beyond the joints' limits.
    """

    measured: np.ndarray
    described: np.ndarray
    columns: np.ndarray
    sizes: EffectSizes
    weight: np.ndarray
    log_factor: np.ndarray
    min_rms: np.ndarray
    model_error_floor: float = MIN_MODEL_ERROR_SHARE_OF_RMS
    log_odds: float = 0.0

    @cached_property
    def sums(self) -> "ReadingSums":
        """What the evidence needs of these readings."""
        gap = self.measured - self.described
        each = [NormalEquations.of_samples(X, r) for X, r in zip(self.columns, gap, strict=True)]
        equations = NormalEquations.stacked(each)
        scale = np.maximum(np.sqrt(np.mean(self.measured**2, axis=1)), self.min_rms)
        floor = (self.model_error_floor * scale) ** 2
        return ReadingSums(equations, self.sizes, scale, floor, self.weight, self.log_factor, self.log_odds)

    def residual(self, sizes: np.ndarray) -> np.ndarray:
        """(J, n) residuals with effects of (p,) sizes."""
        return np.asarray(self.measured - self.described - self.columns @ sizes)


@dataclass(frozen=True, eq=False)
class ReadingSums:
    """Sums over the readings of U channels, of one recording or of several with the same effects.

    Attributes:
        equations: normal equations of the effects' sizes, with one unit for each channel.
        sizes: prior knowledge on the effects.
        scale: (U,) root mean square of each channel.
        floor: (U,) variance of the error that every model may have.
        weight: (U,) number of independent samples per sample.
        log_factor: (U,) logarithm of the factor by which a correction scaled the readings.
        log_odds: further log odds of the hypothesis, nats.
    """

    equations: NormalEquations
    sizes: EffectSizes
    scale: np.ndarray
    floor: np.ndarray
    weight: np.ndarray
    log_factor: np.ndarray
    log_odds: float

    @staticmethod
    def joined(parts: "Sequence[ReadingSums]") -> "ReadingSums":
        """Join recordings whose effects have the same sizes."""
        if len(parts) == 1:
            return parts[0]
        equations = NormalEquations.stacked([part.equations for part in parts])
        scale, floor, weight, log_factor = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("scale", "floor", "weight", "log_factor")
        )
        log_odds = sum(part.log_odds for part in parts)
        return ReadingSums(equations, parts[0].sizes, scale, floor, weight, log_factor, log_odds)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of readings for one hypothesis.

    Attributes:
        value: log evidence, nats.
        share: (U,) residual share of each channel's mean square.
        sizes: (p,) estimated sizes of the effects, in typical sizes.
    """

    value: float
    share: np.ndarray
    sizes: np.ndarray


def evidence(given: ReadingSums, absent: np.ndarray | None = None) -> Evidence:
    """Evidence of readings, for the most probable size of the effects of each kind.

    Args:
        given: the readings.
        absent: (p,) bool, effects that are not considered; None for none of them.
    """
    sums, kind, p = given.equations, given.sizes.kind, len(given.sizes.kind)
    here = np.ones(p, dtype=bool) if absent is None else ~absent
    counts = np.maximum(np.bincount(kind[here], minlength=kind.max(initial=0) + 1), 1)
    least, usual = SIZE_RANGE_OF_MISSING_EFFECTS
    unbounded = np.bincount(kind, ~np.isfinite(given.sizes.upper - given.sizes.lower), len(counts))
    most = np.where(unbounded > 0, usual, LARGEST_SIZE_OF_BOUNDED_EFFECTS)
    square = np.ones(len(counts))
    variance = np.maximum(0.01 * given.scale**2, 0.01 * sums.square / sums.count)
    for _ in range(ESTIMATION_ROUNDS):
        width = np.sqrt(square)[kind] * here
        share = given.weight / variance
        A, b = sums.weighted(share, np.arange(len(share)))
        A = np.eye(p) + width[:, None] * width * A
        with np.errstate(divide="ignore", invalid="ignore"):
            lower, upper = (np.where(here, bound / width, bound) for bound in (given.sizes.lower, given.sizes.upper))
        found = solve_bounded(A, width * b, lower, upper)
        free = found.on_bound == 0
        inner, A = A, np.where(free[:, None] & free, A, np.eye(p))
        theta = width * found.x
        left = sums.squared_errors(theta[:, None])[:, 0]
        held = ~free & (found.x != 0.0)
        # The integral of exp(-g x - A x^2 / 2) beside a bound that the readings pull beyond.
        beside = np.abs(found.gradient[held]) + np.sqrt(2.0 / np.pi * np.diag(inner)[held])
        value = -0.5 * float(share @ left + found.x @ found.x + log_det(A))
        value -= float(np.sum(np.log(beside * np.sqrt(0.5 * np.pi))))
        value += float(np.sum(sums.count * given.weight * (given.log_factor - 0.5 * np.log(variance))))
        spread = free * np.diag(inverse_positive(A)) * width**2
        square = np.clip(np.bincount(kind, here * (theta**2 + spread), len(counts)) / counts, least**2, most**2)
        variance = left / sums.count + given.floor
    return Evidence(value + given.log_odds, left / sums.count / given.scale**2, theta)


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
