r"""Detect slow changes of a load or a joint, by regression of the residual over blocks of motion.

A change of size s adds X s to the residual of its joint; the columns of X are the derivatives x(q, v, a) of the torque.
Over the samples of a window, weighted by W = 1 / variance of the residual, S = X' W X and b = X' W r. The error of a
sound model resembles changes too, different ones in each posture: b has the mean S m and the covariance S P S + n S,
where P is the covariance of these apparent changes, and n the factor by which the correlation of neighbouring samples
raises the variance; fault-free recordings give both. With M = (S P + n)^-1 a change of kind k is estimated by

    u = M (b - S m),    J = M S,    s_k = u_k / J_kk,    score u_k / sqrt(J_kk) in standard deviations.

So an offset or gain that scatters with the posture is not taken for friction. A load has columns L in every channel, as
the offsets of a force/torque sensor have in those of the sensor; the sums of such a shared change are L' V^-1 L and
L' V^-1 r with V = n / W + X P X'. `RandomEffects` computes both.

A window with more information about a change than sound windows had gets no more weight than they. Only samples at
which a joint certainly moves count: at rest the same model error repeats and resembles an offset.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.arm.motion import MIN_CERTAIN_VELOCITY_SIGN
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.random_effects import RandomEffects, pooled
from armdyn.recording.channels import FloatArray
from armdyn.watch.observer import ObserverOutput
from armdyn.watch.variances import ErrorBand
from armdyn.watch.watched import SharedChange, WatchedChanges

USED_SAMPLE_INTERVAL_SECONDS, BLOCK_MOTION_SECONDS = 0.04, 1.0
"""Time between the samples that are used, s (the observer's low-pass F removes faster signals), and time of motion in a
block, s."""
WINDOW_SIZES_IN_BLOCKS = (3, 7, 14, 28)
"""Blocks per window; each size about doubles the one before, so that one window covers 70 % or more of a change."""
POOLED_MEAN_WEIGHT_IN_WINDOWS = 4.0
"""Weight of the mean over all joints beside a joint's own statistics, in independent windows."""
MIN_INFORMATION = 1e-200
"""Least usual information about a change, such as of a joint that hardly moves in the sound recordings."""


@dataclass(frozen=True, eq=False)
class FaultFreeBaseline:
    """Statistics of the apparent changes of a fault-free robot, for windows of one size.

    A window has one unit of equations for each channel, of the unknowns of `WatchedChanges`; k windows follow each
    other.

    Attributes:
        shared: the m shared changes.
        mean: means of their apparent changes.
        apparent: the apparent changes of each channel.
        spread: (m,) mean squares of their scores over their expected values.
        own_spread: (nc, C) mean squares of the scores of the channels' changes over their expected values.
        information: (m,) mean information about the first parameter of each, and (nc, C) mean J.
    """

    shared: tuple[SharedChange, ...]
    mean: tuple[FloatArray, ...]
    apparent: RandomEffects
    spread: FloatArray
    own_spread: FloatArray
    information: tuple[FloatArray, FloatArray]

    @classmethod
    def of(
        cls, windows: NormalEquations, shared: tuple[SharedChange, ...], kinds: np.ndarray, size: int
    ) -> "FaultFreeBaseline":
        """Estimate the statistics from k overlapping windows of `size` blocks, of channels of (nc,) kinds each."""
        # A few windows determine little for one channel alone: it shares in the mean over all of its kind.
        apart, tiny = len(windows.square) / len(kinds) / size, np.finfo(float).tiny
        own = np.arange(_parameters(shared), windows.slope.shape[1])
        of_channels = windows.after_change(own[:0], np.zeros(0), own)
        apparent = RandomEffects.fitted(of_channels, kinds, apart, POOLED_MEAN_WEIGHT_IN_WINDOWS)
        found = cls.of_model_error(shared, apparent)
        cleared = found._cleared(windows)
        means = []
        for change, sums in zip(shared, cleared.shared, strict=True):
            whole = sums.grouped(np.zeros(len(sums.square), dtype=int), 1)
            means.append(change.prior.unbounded_change(whole.gram[0], whole.slope[0])[0])
        found = replace(found, mean=tuple(means))
        of_shared, by_own = found.explained(windows)
        sizes = [len(change.columns) for change in shared]
        own_spread = pooled(by_own.mean(axis=0), kinds, apart, POOLED_MEAN_WEIGHT_IN_WINDOWS)
        return replace(
            found, spread=np.maximum(of_shared.mean(axis=0) / sizes, tiny), own_spread=np.maximum(own_spread, tiny),
            information=(np.array([each.gram[:, 0, 0].mean() for each in cleared.shared]), cleared.J.mean(axis=0)),
        )  # fmt: skip

    @classmethod
    def of_model_error(cls, shared: tuple[SharedChange, ...], apparent: RandomEffects) -> "FaultFreeBaseline":
        """Statistics that no recording has corrected, of channels with these apparent changes."""
        shape, none = apparent.mean.shape, tuple(np.zeros(len(change.columns)) for change in shared)
        unknown = np.full(len(shared), np.inf), np.full(shape, np.inf)
        return cls(shared, none, apparent, np.ones(len(shared)), np.ones(shape), unknown)

    def _cleared(self, windows: NormalEquations) -> "_Cleared":
        channels, changes = self.apparent.mean.shape
        own, count = _parameters(self.shared) + np.arange(changes), len(windows.square) // channels
        whole = self.apparent.integrated_out(windows, own)
        together = whole.grouped(np.repeat(np.arange(count), channels), count)
        shared = tuple(
            together.after_change(change.columns, mean, change.columns)
            for change, mean in zip(self.shared, self.mean, strict=True)
        )
        u, J = whole.slope[:, own], np.einsum("uii->ui", whole.gram)[:, own]
        shape = (count, channels, changes)
        tiny = np.finfo(float).tiny
        return _Cleared(self.shared, shared, u.reshape(shape), np.maximum(J.reshape(shape), tiny))

    def explained(self, windows: NormalEquations) -> tuple[FloatArray, FloatArray]:
        """Decrease of chi2 by each shared change, (k, m), and by each change of each channel, (k, nc, C)."""
        return self._cleared(windows).explained

    def scores(self, windows: NormalEquations) -> tuple[FloatArray, FloatArray]:
        """Scores, in standard deviations, of shared changes (k, m) and of changes of the channels (k, nc, C)."""
        cleared, (information, own_information) = self._cleared(windows), self.information
        of_shared, own = cleared.explained
        first = np.stack([each.gram[:, 0, 0] for each in cleared.shared], axis=1)
        less, each = _no_more(first, information), _no_more(cleared.J, own_information)
        return np.sqrt(less * of_shared / self.spread), np.sqrt(each * own / self.own_spread)

    def shared_change(self, window: NormalEquations, which: int) -> tuple[FloatArray, FloatArray]:
        """Estimate (p,) of the shared change number `which` in one window, and its standard deviations (p,)."""
        sums = self._cleared(window).shared[which]
        found = self.shared[which].prior.posterior(sums.gram[0], sums.slope[0])
        wider = max(1.0, float(sums.gram[0, 0, 0]) / self.information[0][which])
        return found.change, np.sqrt(wider * self.spread[which] * np.diag(found.covariance))

    def joint_change(self, window: NormalEquations, joint: int, kind: int) -> tuple[float, float]:
        """Estimated change of a joint in one window, the `kind`-th, and its standard deviation, in its unit."""
        cleared = self._cleared(window)
        u, J = cleared.u[0, joint, kind], cleared.J[0, joint, kind]
        return float(u / J), float(np.sqrt(self.own_spread[joint, kind] / min(J, self.information[1][joint, kind])))


def _parameters(shared: Sequence[SharedChange]) -> int:
    return sum(len(change.columns) for change in shared)


def _no_more(information: FloatArray, usual: FloatArray | float) -> FloatArray:
    """The factor that reduces information to the usual one, where it is more."""
    return np.asarray(1.0 / np.maximum(1.0, information / np.maximum(usual, MIN_INFORMATION)))


@dataclass(frozen=True, eq=False)
class _Cleared:
    """Equations of k windows without apparent changes: units of m shared ones, (k, nc, C) u and J of the channels."""

    changes: tuple[SharedChange, ...]
    shared: tuple[NormalEquations, ...]
    u: FloatArray
    J: FloatArray

    @property
    def explained(self) -> tuple[FloatArray, FloatArray]:
        """See `FaultFreeBaseline.explained`."""
        falls = [
            -change.prior.unbounded_change(sums.gram, sums.slope)[1]
            for change, sums in zip(self.changes, self.shared, strict=True)
        ]
        return np.stack(falls, axis=1), self.u**2 / self.J


class MotionBlocks:
    """Collects the equations of the latest blocks of motion.

    Args:
        changes: the watched changes.
        band: variance of the residual. Where a joint may stick, its friction has any value for as long as it rests, so
            that its torque tells nothing.
        kept: number of blocks to keep; None keeps all.

    Attributes:
        start_times: start of each kept block, s.
        equations: equations of each kept block, with a unit for each channel.
        columns: (nc, S + C) derivatives of the readings with respect to the unknowns at the last sample.
    """

    def __init__(self, changes: WatchedChanges, band: ErrorBand, kept: int | None = WINDOW_SIZES_IN_BLOCKS[-1]) -> None:
        self._function, self._band, self._channels = changes.function, band, len(band.reversal)
        self.start_times: deque[float] = deque(maxlen=kept)
        self.equations: deque[NormalEquations] = deque(maxlen=kept)
        self.columns = np.zeros((self._channels, changes.shared_parameters + len(changes.names)))
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
        channels, end = self._channels, len(self.equations) - later
        chosen = list(self.equations)[end - size : end]
        return NormalEquations.stacked(chosen).grouped(np.tile(np.arange(channels), size), channels)

    def is_due(self, time: float) -> bool:
        """Whether the next sample is due at `time`, s."""
        return not 0.0 <= time - self._last < USED_SAMPLE_INTERVAL_SECONDS

    def update_columns(self, step: ObserverOutput, bandwidth: float) -> None:
        """Update the columns without using the sample."""
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
