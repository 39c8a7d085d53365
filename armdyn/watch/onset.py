r"""Estimate a torque that began a moment ago, by a weighted sum of the observer's filter stages.

A unit step of torque `ONSET_STEP_AGE_SECONDS` ago adds s to the stages x of a joint; a torque that the model predicts,
and that is 1, t or t^2 around the present, leaves the columns of M in them. The filters alone determine both. On a
sound robot x has the second moments C, each sample weighted by the inverse of its variance. Of all sums w'x with w's =
1 and w'M = 0, which estimate the torque that began and do not see a motion that is smooth for some 0.1 s, whether or
not the sound recordings have one as fast, the smallest variance has

    w = C^-1 A (A' C^-1 A)^-1 e_1,    A = [s M]

(matched filter in coloured noise: Capon, Proc. IEEE 57, 1969; with constraints: Frost, Proc. IEEE 60, 1972). Torque and
prediction enter separately, not only as their difference: if the torque of a drive is smooth, a step is visible in it
before positions, differentiated twice, show it. Noise is averaged as far as this reduces the variance. A friction
of unknown value, up to f, leaves up to f times the integral of |h| in w'x, where h is the response of w'x to an impulse
of torque.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc
from scipy.stats import gamma

from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.solve import solve_positive
from armdyn.recording.channels import FloatArray
from armdyn.watch.observer import (
    FILTER_ORDER,
    LOW_PASS_STAGE_BANDWIDTH,
    PREDICTION_LOW_PASS_STAGES,
    TORQUE_LOW_PASS_STAGES,
)
from armdyn.watch.variances import ErrorBand

ONSET_STEP_AGE_SECONDS = 0.03
"""Time since the start of the torque step to which the weighted sum of the filter stages is tuned, s; the remaining 20
of 50 ms are for the filter of a drive."""
ONSET_FIT_PASSES = 3
"""Number of times that the weights w of the filter stages and the variance of their sum w'x are fitted in turn; w
changes little after two."""
RESPONSE_SECONDS, RESPONSE_STEP_SECONDS = 0.3, 5e-4
"""Time after which all stages have forgotten an impulse of torque, s; and step of the integral over it, s."""
ONSET_RIDGE_SHARE = 1e-9
"""Share of the mean variance that is added to each stage; the stages are nearly equal in slow motion."""


@dataclass(frozen=True, eq=False)
class OnsetTorqueEstimator:
    """Estimates the torque that began a moment ago on each joint.

    Attributes:
        weights: (nj, 14) w.
        band: variance of w'x.
    """

    weights: FloatArray
    band: ErrorBand

    @classmethod
    def of(
        cls, bandwidth: float, stages: np.ndarray, sources: np.ndarray, sticking: np.ndarray, reversal: FloatArray
    ) -> "OnsetTorqueEstimator":
        """Fit the estimator to n samples of a robot without faults, from an observer with a bandwidth K, 1/s.

        `stages` (n, nj, 14) are the outputs of the filters of each joint, `sources` (n, nj, 4) the terms whose weighted
        sum is the variance of the residual, `sticking` (n, nj) the frictions of unknown value, N m or N; for `reversal`
        (nj,) see `ErrorBand`.
        """
        x, size = stages.swapaxes(0, 1), stages.shape[2]
        known = np.column_stack([step_response(), smooth_responses(bandwidth)]).T
        near = (sticking > reversal).T
        spread = np.where(near, np.inf, 1.0)
        for _ in range(ONSET_FIT_PASSES):
            C = NormalEquations.of_units(x, np.zeros(spread.shape), np.sqrt(spread)).gram
            ridge = ONSET_RIDGE_SHARE * np.trace(C, axis1=1, axis2=2) / size + np.finfo(float).tiny
            v = solve_positive((C + ridge[:, None, None] * np.eye(size))[:, None], known)
            shares = solve_positive(v @ known.T, np.eye(len(known))[0])
            weights = (shares[:, None] @ v)[:, 0]
            errors, gain = (x @ weights[..., None])[..., 0].T, absolute_response(weights)
            band = ErrorBand.of(errors, sources, sticking, reversal, gain)
            spread = np.where(near, np.inf, band.at(sources, sticking).variance.T)
        return cls(weights, band)

    def estimate(self, stages: FloatArray) -> FloatArray:
        """(nj,) estimated torques that began a moment ago, N m or N, from (nj, 14) filter stages of the observer."""
        return np.asarray((self.weights * stages).sum(axis=1))


def absolute_response(weights: FloatArray) -> FloatArray:
    """(nj,) integral of the absolute response of w'x to an impulse of torque, for weights w (nj, 14)."""
    stage = np.arange(1, TORQUE_LOW_PASS_STAGES + 1)
    age = np.arange(RESPONSE_STEP_SECONDS / 2.0, RESPONSE_SECONDS, RESPONSE_STEP_SECONDS)
    density = gamma.pdf(age[:, None], stage, scale=1.0 / LOW_PASS_STAGE_BANDWIDTH)
    return np.asarray(np.abs(density @ weights[:, :TORQUE_LOW_PASS_STAGES].T).sum(axis=0) * RESPONSE_STEP_SECONDS)


def smooth_responses(bandwidth: float) -> FloatArray:
    """(14, 3) filter stages of the observer for a predicted torque of 1, t and t^2, now, with t in 1 / (100 1/s).

    A stage holds the mean of the torque over the ages of an Erlang variable, and of those of F with the bandwidth K,
    1/s, for a prediction.
    """
    torque, predicted = np.arange(1.0, TORQUE_LOW_PASS_STAGES + 1), np.arange(PREDICTION_LOW_PASS_STAGES + 1.0)
    slower = LOW_PASS_STAGE_BANDWIDTH / bandwidth
    mean = np.concatenate([torque, FILTER_ORDER * slower + predicted])
    variance = np.concatenate([torque, FILTER_ORDER * slower**2 + predicted])
    return np.column_stack([np.ones(len(mean)), -mean, mean**2 + variance])


def step_response() -> FloatArray:
    """(14,) filter stages of the observer after a unit step of torque `ONSET_STEP_AGE_SECONDS` ago."""
    torque = gammainc(np.arange(1, TORQUE_LOW_PASS_STAGES + 1), LOW_PASS_STAGE_BANDWIDTH * ONSET_STEP_AGE_SECONDS)
    return np.append(torque, np.zeros(1 + PREDICTION_LOW_PASS_STAGES))
