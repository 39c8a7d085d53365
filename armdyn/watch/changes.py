r"""Detect slow changes of a load or a joint, by regression of the residual over blocks of motion.

A change of size s adds X s to the residual of its joint; the columns of X are the derivatives x(q, v, a) of the torque.
Over the samples of a window, weighted by W = 1 / variance of the residual, S = X' W X and b = X' W r. The error of a
sound model resembles changes too, different ones in each posture: b has the mean S m and the covariance S P S + n S,
where P is the covariance of these apparent changes, and n the factor by which the correlation of neighbouring samples
raises the variance; fault-free recordings give both. With M = (S P + n)^-1 a change of kind k is estimated by

    u = M (b - S m),    J = M S,    s_k = u_k / J_kk,    score u_k / sqrt(J_kk) in standard deviations.

So an offset or gain that scatters with the posture is not taken for friction. A load has columns L in every joint; its
sums are L' V^-1 L and L' V^-1 r with V = n / W + X P X'. `RandomEffects` computes both.

A window with more information about a change than sound windows had gets no more weight than they. Only samples at
which a joint certainly moves count: at rest the same model error repeats and resembles an offset.
"""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from armdyn.arm.motion import MIN_CERTAIN_VELOCITY_SIGN
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.posterior import NormalPrior
from armdyn.estimation.random_effects import RandomEffects
from armdyn.recording.channels import FloatArray
from armdyn.watch.observer import ObserverOutput
from armdyn.watch.variances import ErrorBand
from armdyn.watch.watched import LOAD_PARAMETERS, WatchedChanges

USED_SAMPLE_INTERVAL_SECONDS, BLOCK_MOTION_SECONDS = 0.04, 1.0
"""Time between the samples that are used, s (the observer's low-pass F removes faster signals), and time of motion in a
block, s."""
WINDOW_SIZES_IN_BLOCKS = (3, 7, 14, 28)
"""Blocks per window; each size about doubles the one before, so that one window covers 70 % or more of a change."""
POOLED_MEAN_WEIGHT_IN_WINDOWS = 4.0
"""Weight of the mean over all joints beside a joint's own statistics, in independent windows."""
LOAD_PRIOR = NormalPrior(
    np.array([1.0, 0.2, 0.2, 0.2]), np.zeros(LOAD_PARAMETERS), np.full(LOAD_PARAMETERS, -np.inf),
    np.full(LOAD_PARAMETERS, np.inf),
)  # fmt: skip
"""Prior of a load's mass, kg, and mass times position, kg m: 1 kg at 0.2 m; it only matters where the motion does not
identify the load."""
MIN_INFORMATION = 1e-200
"""Least usual information about a change, such as of a joint that hardly moves in the sound recordings."""
LOAD = np.arange(LOAD_PARAMETERS)
"""Indices of a load's parameters among the columns."""


@dataclass(frozen=True, eq=False)
class FaultFreeBaseline:
    """Statistics of the apparent changes of a fault-free robot, for windows of one size.

    A window has one unit of equations for each joint, of the unknowns of `WatchedChanges`; k windows follow each other.

    Attributes:
        load: (4,) mean apparent load, kg and kg m.
        apparent: the apparent changes of each joint.
        spread: mean square of the load's score over its expected value.
        joints_spread: (nj, C) mean squares of the joints' scores over their expected values.
        information: mean information about the load's mass, 1/kg^2, and (nj, C) mean J of the joints' changes.
    """

    load: FloatArray
    apparent: RandomEffects
    spread: float
    joints_spread: FloatArray
    information: tuple[float, FloatArray]

    @classmethod
    def of(cls, windows: NormalEquations, joints: int, size: int) -> "FaultFreeBaseline":
        """Estimate the statistics from k overlapping windows of `size` blocks, of so many joints each."""
        # A few windows determine little for one joint alone: it shares in the mean over all joints.
        apart, tiny = len(windows.square) / joints / size, np.finfo(float).tiny
        own = np.arange(LOAD_PARAMETERS, windows.slope.shape[1])
        of_joints = windows.after_change(own[:0], np.zeros(0), own)
        apparent = RandomEffects.fitted(of_joints, joints, apart, POOLED_MEAN_WEIGHT_IN_WINDOWS)
        found = cls.of_model_error(apparent)
        cleared = found._cleared(windows)
        whole = cleared.load.grouped(np.zeros(len(cleared.load.square), dtype=int), 1)
        load, _ = LOAD_PRIOR.unbounded_change(whole.gram[0], whole.slope[0])
        found = replace(found, load=load)
        of_load, by_own = found.explained(windows)
        spread = (apart * by_own.mean(axis=0) + POOLED_MEAN_WEIGHT_IN_WINDOWS * by_own.mean(axis=(0, 1))) / (
            apart + POOLED_MEAN_WEIGHT_IN_WINDOWS
        )
        return replace(
            found, spread=max(float(of_load.mean()) / LOAD_PARAMETERS, tiny), joints_spread=np.maximum(spread, tiny),
            information=(float(cleared.load.gram[:, 0, 0].mean()), cleared.J.mean(axis=0)),
        )  # fmt: skip

    @classmethod
    def of_model_error(cls, apparent: RandomEffects) -> "FaultFreeBaseline":
        """Statistics that no recording has corrected, of joints with these apparent changes."""
        shape = apparent.mean.shape
        return cls(np.zeros(LOAD_PARAMETERS), apparent, 1.0, np.ones(shape), (np.inf, np.full(shape, np.inf)))

    def _cleared(self, windows: NormalEquations) -> "_Cleared":
        joints, changes = self.apparent.mean.shape
        own, count = LOAD_PARAMETERS + np.arange(changes), len(windows.square) // joints
        whole = self.apparent.integrated_out(windows, own)
        load = whole.grouped(np.repeat(np.arange(count), joints), count).after_change(LOAD, self.load, LOAD)
        u, J = whole.slope[:, own], np.einsum("uii->ui", whole.gram)[:, own]
        shape = (count, joints, changes)
        return _Cleared(load, u.reshape(shape), np.maximum(J.reshape(shape), np.finfo(float).tiny))

    def explained(self, windows: NormalEquations) -> tuple[FloatArray, FloatArray]:
        """Decrease of chi2 by a change of the load, (k,), and by each change of each joint, (k, nj, C)."""
        return self._cleared(windows).explained

    def scores(self, windows: NormalEquations) -> tuple[FloatArray, FloatArray]:
        """Scores, in standard deviations, of a change of the load (k,) and of changes of the joints (k, nj, C)."""
        cleared, (information, own_information) = self._cleared(windows), self.information
        of_load, own = cleared.explained
        mass, each = _no_more(cleared.load.gram[:, 0, 0], information), _no_more(cleared.J, own_information)
        return np.sqrt(mass * of_load / self.spread), np.sqrt(each * own / self.joints_spread)

    def load_change(self, window: NormalEquations) -> tuple[FloatArray, FloatArray]:
        """Estimated change of the load (4,), kg and kg m, in one window, and its standard deviations (4,)."""
        load = self._cleared(window).load
        found = LOAD_PRIOR.posterior(load.gram[0], load.slope[0])
        wider = max(1.0, float(load.gram[0, 0, 0]) / self.information[0])
        return found.change, np.sqrt(wider * self.spread * np.diag(found.covariance))

    def joint_change(self, window: NormalEquations, joint: int, kind: int) -> tuple[float, float]:
        """Estimated change of a joint in one window, the `kind`-th, and its standard deviation, in its unit."""
        cleared = self._cleared(window)
        u, J = cleared.u[0, joint, kind], cleared.J[0, joint, kind]
        return float(u / J), float(np.sqrt(self.joints_spread[joint, kind] / min(J, self.information[1][joint, kind])))


def _no_more(information: FloatArray, usual: FloatArray | float) -> FloatArray:
    """The factor that reduces information to the usual one, where it is more."""
    return np.asarray(1.0 / np.maximum(1.0, information / np.maximum(usual, MIN_INFORMATION)))


@dataclass(frozen=True, eq=False)
class _Cleared:
    """Equations of k windows without apparent changes: units of the load, and (k, nj, C) u and J of the joints."""

    load: NormalEquations
    u: FloatArray
    J: FloatArray

    @property
    def explained(self) -> tuple[FloatArray, FloatArray]:
        """See `FaultFreeBaseline.explained`."""
        return -LOAD_PRIOR.unbounded_change(self.load.gram, self.load.slope)[1], self.u**2 / self.J


class MotionBlocks:
    """Collects the equations of the latest blocks of motion.

    Args:
        changes: the watched changes.
        band: variance of the residual. Where a joint may stick, its friction has any value for as long as it rests, so
            that its torque tells nothing.
        kept: number of blocks to keep; None keeps all.

    Attributes:
        start_times: start of each kept block, s.
        equations: equations of each kept block, with a unit for each joint.
        columns: (nj, 4 + C) derivatives of the torques with respect to the unknowns at the last sample.
    """

    def __init__(self, changes: WatchedChanges, band: ErrorBand, kept: int | None = WINDOW_SIZES_IN_BLOCKS[-1]) -> None:
        self._function, self._band, self._joints = changes.function, band, len(band.reversal)
        self.start_times: deque[float] = deque(maxlen=kept)
        self.equations: deque[NormalEquations] = deque(maxlen=kept)
        self.columns = np.zeros((self._joints, LOAD_PARAMETERS + len(changes.names)))
        self._last = -np.inf
        self.clear()

    def clear(self) -> None:
        """Forget all blocks."""
        self.start_times.clear()
        self.equations.clear()
        self.drop_partial()

    def drop_partial(self) -> None:
        """Forget the incomplete block."""
        self._samples: list[tuple[FloatArray, FloatArray, FloatArray]] = []

    def window(self, size: int, later: int = 0) -> NormalEquations:
        """Equations of `size` blocks together: the latest ones, or those before `later` other ones."""
        joints, end = self._joints, len(self.equations) - later
        chosen = list(self.equations)[end - size : end]
        return NormalEquations.stacked(chosen).grouped(np.tile(np.arange(joints), size), joints)

    def is_due(self, time: float) -> bool:
        """Whether the next sample is due at `time`, s."""
        return not 0.0 <= time - self._last < USED_SAMPLE_INTERVAL_SECONDS

    def update_columns(self, step: ObserverOutput, bandwidth: float) -> None:
        """Update the columns of load and joints without using the sample."""
        self._last = step.time
        self.columns, self._way = (each.copy() for each in self._function(*step.motion, bandwidth))

    def add_sample(self, step: ObserverOutput, bandwidth: float) -> bool:
        """Add a sample; returns whether it completes a block.

        Args:
            step: the observer's output.
            bandwidth: K of the observer, 1/s.
        """
        self.update_columns(step, bandwidth)
        if not (np.abs(self._way) >= MIN_CERTAIN_VELOCITY_SIGN).any():
            return False
        if not self._samples:
            self._start = step.time
        at = self._band.at(step.sources, step.sticking)
        std = np.where(at.near, np.inf, np.sqrt(at.variance))
        self._samples.append((self.columns, step.residual, std))
        if len(self._samples) < round(BLOCK_MOTION_SECONDS / USED_SAMPLE_INTERVAL_SECONDS):
            return False
        X, r, std = (np.stack(part, axis=1) for part in zip(*self._samples, strict=True))
        self.start_times.append(self._start)
        self.equations.append(NormalEquations.of_units(X, r, std))
        self.drop_partial()
        return True
