r"""Detect slow changes of a load or a joint, by regression of the residual over blocks of motion.

A change of size s adds X s to the residual of its joint; the columns of X are the derivatives x(q, v, a) of the torque.
Over the samples of a window, weighted by W = 1 / variance of the residual, S = X' W X and b = X' W r. The error of a
sound model resembles changes too, different ones in each posture: b has the mean S m and the covariance S P S + n S,
where P is the covariance of these apparent changes, and n the factor by which the correlation of neighbouring samples
raises the variance; fault-free recordings give both. With M = (S P + n)^-1 a change of kind k is estimated by

    u = M (b - S m),    J = M S,    s_k = u_k / J_kk,    score u_k / sqrt(J_kk) in standard deviations.

So an offset or gain that scatters with the posture is not taken for friction. A load has columns L in every joint; its
sums are L' V^-1 L and L' V^-1 r with V = n / W + X P X', and V^-1 = (W - W X P M X' W) / n.

A window with more information about a change than sound windows had gets no more weight than they. Only samples at
which a joint certainly moves count: at rest the same model error repeats and resembles an offset.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from armdyn.arm.motion import MIN_CERTAIN_VELOCITY_SIGN
from armdyn.codegen import PreallocatedFunction
from armdyn.estimation.solve import inverse_positive, solve_positive
from armdyn.recording.channels import FloatArray
from armdyn.watch.observer import ObserverOutput
from armdyn.watch.variances import MIN_TORQUE_VARIANCE

USED_SAMPLE_INTERVAL_SECONDS, BLOCK_MOTION_SECONDS = 0.04, 1.0
"""Time between the samples that are used, s (the observer's low-pass F removes faster signals), and time of motion in a
block, s."""
WINDOW_SIZES_IN_BLOCKS = (3, 7, 14, 28)
"""Blocks per window; each size about doubles the one before, so that one window covers 70 % or more of a change."""
JOINT_CHANGES = ("joint_coulomb_friction", "joint_viscous_friction", "torque_offset", "torque_gain")
"""Effects that may change in a joint, in the order of `column_function`."""
JOINT_CHANGE_UNITS = ("N m", "N m s/rad", "N m", "1")
SLIDING_JOINT_CHANGE_UNITS = ("N", "N s/m", "N", "1")
"""Units of `JOINT_CHANGES` for revolute and for prismatic joints."""
POOLED_MEAN_WEIGHT_IN_WINDOWS = 4.0
"""Weight of the mean over all joints beside a joint's own statistics, in independent windows."""
LOAD_PRIOR_STD = np.array([1.0, 0.2, 0.2, 0.2])
"""Prior standard deviations of a load's mass, kg, and mass times position, kg m: 1 kg at 0.2 m."""
LOAD_PRIOR_INFORMATION = np.diag(1.0 / LOAD_PRIOR_STD**2)
"""Inverse covariance of the prior of a load's mass and mass times position; it only matters where the motion does not
identify the load."""
EM_STEPS, SUMS_RIDGE = 10, 1e-6
"""Number of iterations that fit the covariance P of apparent changes and the noise factor n; and ridge that is added to
sums of mean 1, for joints that do not move."""


@dataclass(frozen=True, eq=False)
class RegressionBlockSums:
    """Sums of a regression over blocks of motion, for each joint.

    L are the columns of an added load, X those of changes of the joint, r the residuals and W the weights.

    Attributes:
        load: (..., nj, 4, 4) L' W L.
        load_residual_product: (..., nj, 4) L' W r.
        cross: (..., nj, 4, 4) L' W X.
        joints: (..., nj, 4, 4) X' W X.
        joints_residual_product: (..., nj, 4) X' W r.
    """

    load: FloatArray
    load_residual_product: FloatArray
    cross: FloatArray
    joints: FloatArray
    joints_residual_product: FloatArray

    @classmethod
    def zeros(cls, joints: int) -> "RegressionBlockSums":
        """Sums without any sample, for this number of joints."""
        square, line = (joints, 4, 4), (joints, 4)
        return cls(*(np.zeros(shape) for shape in (square, line, square, square, line)))

    @classmethod
    def stacked(cls, parts: "Sequence[RegressionBlockSums]") -> "RegressionBlockSums":
        """Stack the sums of k blocks along a new first axis."""
        return cls(*(np.array([getattr(part, each.name) for part in parts]) for each in fields(cls)))

    def windows(self, size: int) -> "RegressionBlockSums":
        """Sums over every window of `size` successive blocks out of k: (k - size + 1, ...)."""
        totals = (np.cumsum(getattr(self, each.name), axis=0) for each in fields(self))
        padded = (np.concatenate([np.zeros((1, *total.shape[1:])), total]) for total in totals)
        return RegressionBlockSums(*(total[size:] - total[:-size] for total in padded))

    def select(self, chosen: object) -> "RegressionBlockSums":
        """Sums of the blocks with these indices."""
        return RegressionBlockSums(*(getattr(self, each.name)[chosen] for each in fields(self)))

    @property
    def total(self) -> "RegressionBlockSums":
        """Sum over all blocks."""
        return RegressionBlockSums(*(getattr(self, each.name).sum(axis=0) for each in fields(self)))


@dataclass(frozen=True, eq=False)
class FaultFreeBaseline:
    """Statistics of the apparent changes of a fault-free robot, for windows of one size.

    Attributes:
        load: (4,) mean apparent load, kg and kg m.
        joints: (nj, 4) m, mean apparent change of each joint, in `JOINT_CHANGE_UNITS`.
        scatter: (nj, 4, 4) P.
        noise: (nj,) n.
        spread: mean square of the load's score over its expected value.
        joints_spread: (nj, 4) mean squares of the joints' scores over their expected values.
        information: mean information about the load's mass, 1/kg^2, and (nj, 4) mean J of the joints' changes.
    """

    load: FloatArray
    joints: FloatArray
    scatter: FloatArray
    noise: FloatArray
    spread: float
    joints_spread: FloatArray
    information: tuple[float, FloatArray]

    @classmethod
    def of(cls, windows: RegressionBlockSums, size: int) -> "FaultFreeBaseline":
        """Estimate the statistics from k overlapping windows of `size` blocks each."""
        # A few windows determine little for one joint alone: it shares in the mean over all joints.
        apart, tiny = len(windows.load) / size, np.finfo(float).tiny
        own, scatter, noise = _scatter(windows, apart)
        found = cls(np.zeros(4), own, scatter, noise, 1.0, np.ones(own.shape), (np.inf, np.full(own.shape, np.inf)))
        sums, errors, _, _ = found._whitened(windows)
        load = solve_positive(sums.sum(axis=0) + LOAD_PRIOR_INFORMATION, errors.sum(axis=0))
        found = replace(found, load=np.asarray(load))
        of_load, by_own = found.explained(windows)
        spread = (apart * by_own.mean(axis=0) + POOLED_MEAN_WEIGHT_IN_WINDOWS * by_own.mean(axis=(0, 1))) / (
            apart + POOLED_MEAN_WEIGHT_IN_WINDOWS
        )
        J = found._whitened(windows)[3]
        return replace(
            found, spread=max(float(of_load.mean()) / len(LOAD_PRIOR_STD), tiny),
            joints_spread=np.maximum(spread, tiny),
            information=(float(sums[:, 0, 0].mean()), J.mean(axis=0)),
        )  # fmt: skip

    def _whitened(self, sums: RegressionBlockSums) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Sums (..., 4, 4) and errors (..., 4) of the load, u (..., nj, 4), and diagonal of J (..., nj, 4)."""
        M = np.linalg.inv(sums.joints @ self.scatter + self.noise[:, None, None] * np.eye(4))
        error = sums.joints_residual_product - _times(sums.joints, self.joints)
        of_load = sums.load_residual_product - _times(sums.cross, self.joints)
        G = sums.cross @ self.scatter @ M
        A = ((sums.load - G @ np.swapaxes(sums.cross, -1, -2)) / self.noise[:, None, None]).sum(axis=-3)
        errors = ((of_load - _times(G, error)) / self.noise[:, None]).sum(axis=-2) - A @ self.load
        J = np.einsum("...ik,...ki->...i", M, sums.joints)
        return A, errors, _times(M, error), np.maximum(J, np.finfo(float).tiny)

    def explained(self, sums: RegressionBlockSums) -> tuple[FloatArray, FloatArray]:
        """Decrease of chi2 by a change of the load, (...), and by each change of each joint, (..., nj, 4)."""
        A, errors, u, J = self._whitened(sums)
        return np.einsum("...i,...i->...", errors, solve_positive(A + LOAD_PRIOR_INFORMATION, errors)), u**2 / J

    def scores(self, sums: RegressionBlockSums) -> tuple[FloatArray, FloatArray]:
        """Scores, in standard deviations, of a change of the load (...) and of changes of the joints (..., nj, 4)."""
        of_load, own = self.explained(sums)
        A, _, _, J = self._whitened(sums)
        mass = np.minimum(1.0, self.information[0] / np.maximum(A[..., 0, 0], np.finfo(float).tiny))
        return np.sqrt(mass * of_load / self.spread), np.sqrt(
            np.minimum(1.0, self.information[1] / J) * own / self.joints_spread
        )

    def load_change(self, sums: RegressionBlockSums) -> tuple[FloatArray, FloatArray]:
        """Estimated change of the load (4,), kg and kg m, and its standard deviations (4,)."""
        A, errors, _, _ = self._whitened(sums)
        inverse = inverse_positive(A + LOAD_PRIOR_INFORMATION)
        wider = max(1.0, float(A[0, 0]) / self.information[0])
        return inverse @ errors, np.sqrt(wider * self.spread * np.diag(inverse))

    def joint_change(self, sums: RegressionBlockSums, joint: int, kind: int) -> tuple[float, float]:
        """Estimated change of a joint, the `kind`-th of `JOINT_CHANGES`, and its standard deviation, in its unit."""
        _, _, u, J = (each[..., joint, kind] if k > 1 else each for k, each in enumerate(self._whitened(sums)))
        return float(u / J), float(np.sqrt(self.joints_spread[joint, kind] / min(J, self.information[1][joint, kind])))


def _times(matrix: np.ndarray, vector: np.ndarray) -> FloatArray:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _scatter(windows: RegressionBlockSums, apart: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit of m (nj, 4), P (nj, 4, 4) and n (nj,) to k windows of which `apart` share no block.

    Expectation maximisation for random effects (Laird & Ware, Biometrics 38, 1982).
    """
    unit = 1.0 / np.sqrt(np.maximum(np.einsum("...ii->...i", windows.joints).mean(axis=0), MIN_TORQUE_VARIANCE))
    S = windows.joints * unit[:, :, None] * unit[:, None, :] + SUMS_RIDGE * np.eye(4)
    b = windows.joints_residual_product * unit
    mean = solve_positive(S.sum(axis=0), b.sum(axis=0))
    error = b - _times(S, mean)
    P, n = np.tile(np.eye(4), (len(unit), 1, 1)), np.ones(len(unit))
    for _ in range(EM_STEPS):
        M = np.linalg.inv(S @ P + n[:, None, None] * np.eye(4))
        u = _times(M, error)
        own, covariance = _times(P, u), P - P @ M @ S @ P
        left = n[:, None] * u
        squares = (left * solve_positive(S, left)).sum(axis=-1)
        n = np.maximum((squares + np.einsum("...ij,...ji->...", S, covariance)).mean(axis=0) / 4, SUMS_RIDGE)
        each = (own[..., None] * own[..., None, :] + covariance).mean(axis=0)
        P = (apart * each + POOLED_MEAN_WEIGHT_IN_WINDOWS * each.mean(axis=0)) / (apart + POOLED_MEAN_WEIGHT_IN_WINDOWS)
    return mean * unit, P * unit[:, :, None] * unit[:, None, :], n


class MotionBlocks:
    """Collects the regression sums of the latest blocks of motion.

    Args:
        columns: compiled `column_function`.
        level: (nj, 4) factors of the residual's variance, see `ObserverOutput.sources`.
        kept: number of blocks to keep; None keeps all.

    Attributes:
        start_times: start of each kept block, s.
        sums: sums of each kept block.
        load: (nj, 4) columns L of the load at the last sample.
        own: (nj, 4) columns X of the joints at the last sample.
    """

    def __init__(
        self, columns: PreallocatedFunction, level: FloatArray, kept: int | None = WINDOW_SIZES_IN_BLOCKS[-1]
    ) -> None:
        self._columns, self._level = columns, level
        self.start_times: deque[float] = deque(maxlen=kept)
        self.sums: deque[RegressionBlockSums] = deque(maxlen=kept)
        self.load, self.own = np.zeros((len(level), 4)), np.zeros((len(level), 4))
        self._last = -np.inf
        self.clear()

    def clear(self) -> None:
        """Forget all blocks."""
        self.start_times.clear()
        self.sums.clear()
        self.drop_partial()

    def drop_partial(self) -> None:
        """Forget the incomplete block."""
        self._sum, self._count, self._start = RegressionBlockSums.zeros(len(self._level)), 0, 0.0

    def is_due(self, time: float) -> bool:
        """Whether the next sample is due at `time`, s."""
        return not 0.0 <= time - self._last < USED_SAMPLE_INTERVAL_SECONDS

    def update_columns(self, step: ObserverOutput, bandwidth: float) -> None:
        """Update the columns of load and joints without adding the sample to the sums."""
        self._last = step.time
        self.load, self.own, self._way = (each.copy() for each in self._columns(*step.motion, bandwidth))

    def add_sample(self, step: ObserverOutput, bandwidth: float) -> bool:
        """Add a sample to the sums; returns whether it completes a block.

        Args:
            step: the observer's output.
            bandwidth: K of the observer, 1/s.
        """
        self.update_columns(step, bandwidth)
        load, own = self.load, self.own
        if not (np.abs(self._way) >= MIN_CERTAIN_VELOCITY_SIGN).any():
            return False
        weight = 1.0 / (self._level * step.sources).sum(axis=1)
        if self._count == 0:
            self._start = step.time
        of_load, of_own = (each[:, None, :] * weight[:, None, None] for each in (load, own))
        total = self._sum
        total.load[...] += load[:, :, None] * of_load
        total.load_residual_product[...] += of_load[:, 0] * step.residual[:, None]
        total.cross[...] += load[:, :, None] * of_own
        total.joints[...] += own[:, :, None] * of_own
        total.joints_residual_product[...] += of_own[:, 0] * step.residual[:, None]
        self._count += 1
        if self._count < round(BLOCK_MOTION_SECONDS / USED_SAMPLE_INTERVAL_SECONDS):
            return False
        self.start_times.append(self._start)
        self.sums.append(total)
        self.drop_partial()
        return True
