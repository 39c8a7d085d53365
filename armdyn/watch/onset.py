r"""What began a moment ago: the sum of an observer's stages that shows a step of torque best.

With x the stages of a joint, of torque and prediction, a step of torque of `ONSET` s ago adds s to them, known from the
filters alone. A sound robot's x varies by C, each sample weighted by what it is believed, the inverse of the variance
by its sources. Of all sums w'x with w's = 1, which say the torque that began, the smallest variance has

    w = C^-1 s / (s' C^-1 s)

(the matched filter in coloured noise: Capon, Proc. IEEE 57, 1969). Torque and prediction come in by themselves and not
only as their difference: where a drive's torque is smooth by itself, a step shows before positions, differentiated
twice, tell anything. What is smooth, motion or error of the model, cancels; noise is averaged as long as it pays.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc

from armdyn.recording.channels import FloatArray
from armdyn.watch.observer import EARLY, PREDICTIONS, SOURCES, TORQUES
from armdyn.watch.variances import variances

ONSET = 0.03
"""s: of the 50 in which a contact must be told, so many for it to stand in the stages, behind a drive's own filter."""
REWEIGHTED = 3
"""Fits of w and of its variance by turns; it changes little after two."""
RIDGE = 1e-9
"""Of the mean variance of the stages, added to each: they are nearly alike in slow motion."""


@dataclass(frozen=True, eq=False)
class Onset:
    """Of each joint.

    Attributes:
        weights: (nj, 14) w.
        variance: (nj, 4) of w'x by its sources, see `Step`, (N m)^2 but the last three.
    """

    weights: FloatArray
    variance: FloatArray

    @classmethod
    def of(cls, stages: np.ndarray, sources: np.ndarray) -> "Onset":
        """From a sound robot's (n, nj, 14) stages and the (n, nj, 4) sources of their errors."""
        count, joints, size = stages.shape
        step, weights, variance = stepped(), np.zeros((joints, size)), np.zeros((joints, SOURCES))
        for j in range(joints):
            spread = np.ones(count)
            for _ in range(REWEIGHTED):
                scaled = stages[:, j] / np.sqrt(spread)[:, None]
                C = scaled.T @ scaled
                w = np.linalg.solve(C + (RIDGE * np.trace(C) / size + np.finfo(float).tiny) * np.eye(size), step)
                weights[j] = w / (step @ w)
                variance[j] = variances((stages[:, j] @ weights[j])[:, None], sources[:, j : j + 1])[0]
                spread = sources[:, j] @ variance[j]
        return cls(weights, variance)

    def began(self, stages: FloatArray) -> FloatArray:
        """(nj,) torques that seem to have begun, of (nj, 14) stages."""
        return np.asarray((self.weights * stages).sum(axis=1))


def stepped() -> FloatArray:
    """(14,) what a step of torque of 1, `ONSET` s ago, adds to the stages."""
    return np.append(gammainc(np.arange(1, TORQUES + 1), EARLY * ONSET), np.zeros(1 + PREDICTIONS))
