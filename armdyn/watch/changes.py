r"""What changed slowly: sums over blocks of motion of what each change would add, and the change that explains most.

A change of size s adds s x(q, v, a) to the residual, x being its columns. Over the samples of a window, weighted by the
variance w of the residual,

    S = sum x' x / w,    b = sum x' r / w,    s = S^-1 b,    explained: b' S^-1 b.

Neighbouring samples of a model's error are alike, so that b varies by `spread` times S, which sound recordings say; a
window that shows more of a change than those did is believed no more than they. Only samples at which a joint surely
moves count: at rest one error of the model is seen again and again, and looks like an offset.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from armdyn.arm.motion import CERTAIN
from armdyn.codegen import Buffered
from armdyn.recording.channels import FloatArray
from armdyn.watch.observer import Step

SAMPLE, BLOCK = 0.04, 1.0
"""s from sample to sample, of which F leaves no more, and of motion in a block."""
WINDOWS = (3, 7, 14, 28)
"""Blocks that are looked at together; each about twice the one before, so that one fits a change by 70 % or more."""
OWN = ("joint_coulomb_friction", "joint_viscous_friction", "torque_offset", "torque_gain")
"""What may change of a joint, in the order of `column_function`."""
UNITS = ("N m", "N m s/rad", "N m", "1")
SLIDING_UNITS = ("N", "N s/m", "N", "1")
SHARED = 4.0
"""Windows for which what all joints say of a kind of change counts beside a joint's own."""
LOAD = np.array([1.0, 0.2, 0.2, 0.2])
"""kg and kg m: typical load, 1 kg at 0.2 m. Weak knowledge, which only matters where the motion says nothing."""


@dataclass(frozen=True, eq=False)
class Sums:
    """S and b of windows or blocks (...): of the load, and of everything of each of nj joints by itself.

    Attributes:
        load: (..., 4, 4).
        load_error: (..., 4).
        own: (..., nj, 4).
        own_error: (..., nj, 4).
    """

    load: FloatArray
    load_error: FloatArray
    own: FloatArray
    own_error: FloatArray

    @classmethod
    def none(cls, joints: int) -> "Sums":
        """Of no sample."""
        return cls(np.zeros((4, 4)), np.zeros(4), np.zeros((joints, 4)), np.zeros((joints, 4)))

    @classmethod
    def together(cls, parts: "Sequence[Sums]") -> "Sums":
        """Those of k blocks, (k, ...)."""
        return cls(*(np.array([getattr(part, each.name) for part in parts]) for each in fields(cls)))

    def windows(self, size: int) -> "Sums":
        """Of every `size` blocks that follow each other, out of k: (k - size + 1, ...)."""
        totals = (np.cumsum(getattr(self, each.name), axis=0) for each in fields(self))
        padded = (np.concatenate([np.zeros((1, *total.shape[1:])), total]) for total in totals)
        return Sums(*(total[size:] - total[:-size] for total in padded))

    def of(self, chosen: object) -> "Sums":
        """Some of them."""
        return Sums(*(getattr(self, each.name)[chosen] for each in fields(self)))

    @property
    def total(self) -> "Sums":
        """Of all blocks together."""
        return Sums(*(getattr(self, each.name).sum(axis=0) for each in fields(self)))


@dataclass(frozen=True, eq=False)
class Usual:
    """What changes seem to be on a sound robot, over windows of one size.

    Attributes:
        load: (4,) kg and kg m.
        own: (nj, 4).
        spread: variance of b over S, of the load.
        own_spread: (nj, 4) likewise of the others.
        shown: of the same, S of a usual window: mass, then (nj, 4).
    """

    load: FloatArray
    own: FloatArray
    spread: float
    own_spread: FloatArray
    shown: tuple[float, FloatArray]

    @classmethod
    def of(cls, windows: Sums, size: int) -> "Usual":
        """From windows (k, ...) of `size` blocks, each a block later than the one before."""
        total = windows.total
        load = np.asarray(np.linalg.solve(total.load + np.diag(1.0 / LOAD**2), total.load_error), dtype=float)
        own = total.own_error / np.maximum(total.own, np.finfo(float).tiny)
        found = cls(load, own, 1.0, np.ones(own.shape), (np.inf, np.full(own.shape, np.inf)))
        explained, by_own = found.explained(windows)
        # A few windows say little of one joint alone: each has a share in what all joints say of the kind.
        apart, kind = len(windows.load) / size, by_own.mean(axis=(0, 1))
        spread = (apart * by_own.mean(axis=0) + SHARED * kind) / (apart + SHARED)
        shown = float(windows.load[:, 0, 0].mean()), windows.own.mean(axis=0)
        tiny = np.finfo(float).tiny
        return cls(load, own, max(float(explained.mean()) / len(LOAD), tiny), np.maximum(spread, tiny), shown)

    def explained(self, sums: Sums) -> tuple[FloatArray, FloatArray]:
        """What a change explains of the weighted squares: (...) of the load, (..., nj, 4) of each other one."""
        error = sums.load_error - sums.load @ self.load
        ridge = sums.load + self.spread * np.diag(1.0 / LOAD**2)
        of_load = np.einsum("...i,...i->...", error, np.linalg.solve(ridge, error[..., None])[..., 0])
        own = sums.own_error - sums.own * self.own
        return of_load, own**2 / np.maximum(sums.own, np.finfo(float).tiny)

    def scores(self, sums: Sums) -> tuple[FloatArray, FloatArray]:
        """The same in standard deviations: (...) of the load, the root of a sum of four squares, and (..., nj, 4)."""
        of_load, own = self.explained(sums)
        tiny = np.finfo(float).tiny
        mass = np.minimum(1.0, self.shown[0] / np.maximum(sums.load[..., 0, 0], tiny))
        each = np.minimum(1.0, self.shown[1] / np.maximum(sums.own, tiny))
        return np.sqrt(mass * of_load / self.spread), np.sqrt(each * own / self.own_spread)

    def load_change(self, sums: Sums) -> tuple[FloatArray, FloatArray]:
        """(4,) of the load, kg and kg m, and (4,) their standard deviations."""
        ridge = sums.load + self.spread * np.diag(1.0 / LOAD**2)
        inverse = np.linalg.inv(ridge)
        wider = max(1.0, float(sums.load[0, 0]) / self.shown[0])
        return inverse @ (sums.load_error - sums.load @ self.load), np.sqrt(wider * self.spread * np.diag(inverse))

    def own_change(self, sums: Sums, joint: int, kind: int) -> tuple[float, float]:
        """Of a joint, and its standard deviation."""
        S = float(sums.own[joint, kind])
        size = float(sums.own_error[joint, kind]) / S - float(self.own[joint, kind])
        return size, float(np.sqrt(self.own_spread[joint, kind] / min(S, self.shown[1][joint, kind])))


class Blocks:
    """The last blocks of motion.

    Args:
        columns: see `column_function`.
        level: (nj, 4) variance of a sound residual by its sources.
        kept: how many blocks.

    Attributes:
        begins: of every block that is kept, when it began, s.
        sums: of every block that is kept.
        load: (nj, 4) columns of the load at the last sample.
        own: (nj, 4) columns of the joints at the last sample.
    """

    def __init__(self, columns: Buffered, level: FloatArray, kept: int | None = WINDOWS[-1]) -> None:
        self._columns, self._level = columns, level
        self.begins: deque[float] = deque(maxlen=kept)
        self.sums: deque[Sums] = deque(maxlen=kept)
        self.load, self.own = np.zeros((len(level), 4)), np.zeros((len(level), 4))
        self._last = -np.inf
        self.clear()

    def clear(self) -> None:
        """Forget all of it."""
        self.begins.clear()
        self.sums.clear()
        self._begin()

    def _begin(self) -> None:
        self._sum, self._count, self._start = Sums.none(len(self._level)), 0, 0.0

    def due(self, time: float) -> bool:
        """Whether another sample is wanted."""
        return not 0.0 <= time - self._last < SAMPLE

    def look(self, step: Step, bandwidth: float) -> None:
        """Take the columns at a sample that does not count; arguments as of `take`."""
        self._last = step.time
        self.load, self.own, self._way = (each.copy() for each in self._columns(*step.motion, bandwidth))

    def take(self, step: Step, bandwidth: float) -> bool:
        """Add a sample; whether a block is complete with it.

        Args:
            step: what the observer says of it.
            bandwidth: of the observer, 1/s.
        """
        self.look(step, bandwidth)
        load, own = self.load, self.own
        if not (np.abs(self._way) >= CERTAIN).any():
            return False
        weight = 1.0 / (self._level * step.sources).sum(axis=1)
        if self._count == 0:
            self._start = step.time
        weighted = load * weight[:, None]
        total = self._sum
        total.load[...] += weighted.T @ load
        total.load_error[...] += weighted.T @ step.residual
        total.own[...] += own**2 * weight[:, None]
        total.own_error[...] += own * (weight * step.residual)[:, None]
        self._count += 1
        if self._count < round(BLOCK / SAMPLE):
            return False
        self.begins.append(self._start)
        self.sums.append(total)
        self._begin()
        return True
