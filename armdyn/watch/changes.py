r"""What changed slowly: sums over blocks of motion of what each change would add, and the change that explains most.

A change of size s of a joint's own adds X s to its residual, X being its columns x(q, v, a). Over a window's samples,
weighted by W = 1 / variance of the residual, S = X' W X and b = X' W r. A sound model's error looks like changes as
well, other ones in every posture: b has the mean S m and the covariance S P S + n S, where P says how far they scatter
and n how alike neighbouring samples are; sound recordings say both. With M = (S P + n)^-1 the change of one kind is

    u = M (b - S m),    J = M S,    s_k = u_k / J_kk,    u_k / sqrt(J_kk) standard deviations:

a joint's offset or gain that scatters with the posture is no friction. Of a load, whose columns are L in every joint,
the sums are L' V^-1 L and L' V^-1 r with V = n / W + X P X', and V^-1 = (W - W X P M X' W) / n.

A window that shows more of a change than sound ones did is believed no more than they. Only samples at which a joint
surely moves count: at rest one error of the model is seen again and again, and looks like an offset.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from armdyn.arm.motion import CERTAIN
from armdyn.codegen import Buffered
from armdyn.recording.channels import FloatArray
from armdyn.watch.observer import Step
from armdyn.watch.variances import TINY

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
WEAK = np.diag(1.0 / LOAD**2)
STEPS, RIDGE = 10, 1e-6
"""Of the fit of P and n, and what is added to sums whose mean is 1, for joints that do not move."""


@dataclass(frozen=True, eq=False)
class Sums:
    """Of windows or blocks (...), by joint: of the load's columns L and of the joint's own X.

    Attributes:
        load: (..., nj, 4, 4) L' W L.
        load_error: (..., nj, 4) L' W r.
        cross: (..., nj, 4, 4) L' W X.
        own: (..., nj, 4, 4) X' W X.
        own_error: (..., nj, 4) X' W r.
    """

    load: FloatArray
    load_error: FloatArray
    cross: FloatArray
    own: FloatArray
    own_error: FloatArray

    @classmethod
    def none(cls, joints: int) -> "Sums":
        """Of no sample."""
        square, line = (joints, 4, 4), (joints, 4)
        return cls(*(np.zeros(shape) for shape in (square, line, square, square, line)))

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
class Baseline:
    """What changes seem to be on a sound robot, over windows of one size.

    Attributes:
        load: (4,) kg and kg m.
        own: (nj, 4) m.
        scatter: (nj, 4, 4) P.
        noise: (nj,) n.
        spread: squares of the load's score over what they should be.
        own_spread: (nj, 4) likewise of the others.
        shown: mean sum of the load's mass, and (nj, 4) J of the others, in a sound window.
    """

    load: FloatArray
    own: FloatArray
    scatter: FloatArray
    noise: FloatArray
    spread: float
    own_spread: FloatArray
    shown: tuple[float, FloatArray]

    @classmethod
    def of(cls, windows: Sums, size: int) -> "Baseline":
        """From windows (k, ...) of `size` blocks, each a block later than the one before."""
        # A few windows say little of one joint alone: each has a share in what all joints say.
        apart, tiny = len(windows.load) / size, np.finfo(float).tiny
        own, scatter, noise = _scatter(windows, apart)
        found = cls(np.zeros(4), own, scatter, noise, 1.0, np.ones(own.shape), (np.inf, np.full(own.shape, np.inf)))
        sums, errors, _, _ = found._whitened(windows)
        load = np.linalg.solve(sums.sum(axis=0) + WEAK, errors.sum(axis=0))
        found = replace(found, load=np.asarray(load))
        of_load, by_own = found.explained(windows)
        spread = (apart * by_own.mean(axis=0) + SHARED * by_own.mean(axis=(0, 1))) / (apart + SHARED)
        J = found._whitened(windows)[3]
        return replace(
            found, spread=max(float(of_load.mean()) / len(LOAD), tiny), own_spread=np.maximum(spread, tiny),
            shown=(float(sums[:, 0, 0].mean()), J.mean(axis=0)),
        )  # fmt: skip

    def _whitened(self, sums: Sums) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Sums (..., 4, 4) and errors (..., 4) of the load, u (..., nj, 4) and J's diagonal."""
        M = np.linalg.inv(sums.own @ self.scatter + self.noise[:, None, None] * np.eye(4))
        error = sums.own_error - _times(sums.own, self.own)
        of_load = sums.load_error - _times(sums.cross, self.own)
        G = sums.cross @ self.scatter @ M
        A = ((sums.load - G @ np.swapaxes(sums.cross, -1, -2)) / self.noise[:, None, None]).sum(axis=-3)
        errors = ((of_load - _times(G, error)) / self.noise[:, None]).sum(axis=-2) - A @ self.load
        J = np.einsum("...ik,...ki->...i", M, sums.own)
        return A, errors, _times(M, error), np.maximum(J, np.finfo(float).tiny)

    def explained(self, sums: Sums) -> tuple[FloatArray, FloatArray]:
        """What a change explains of the squares over their variance: (...) of the load, (..., nj, 4) of each other."""
        A, errors, u, J = self._whitened(sums)
        return np.einsum("...i,...i->...", errors, np.linalg.solve(A + WEAK, errors[..., None])[..., 0]), u**2 / J

    def scores(self, sums: Sums) -> tuple[FloatArray, FloatArray]:
        """The same in standard deviations: (...) of the load, the root of a sum of four squares, and (..., nj, 4)."""
        of_load, own = self.explained(sums)
        A, _, _, J = self._whitened(sums)
        mass = np.minimum(1.0, self.shown[0] / np.maximum(A[..., 0, 0], np.finfo(float).tiny))
        return np.sqrt(mass * of_load / self.spread), np.sqrt(
            np.minimum(1.0, self.shown[1] / J) * own / self.own_spread
        )

    def load_change(self, sums: Sums) -> tuple[FloatArray, FloatArray]:
        """(4,) of the load, kg and kg m, and (4,) their standard deviations."""
        A, errors, _, _ = self._whitened(sums)
        inverse = np.linalg.inv(A + WEAK)
        wider = max(1.0, float(A[0, 0]) / self.shown[0])
        return inverse @ errors, np.sqrt(wider * self.spread * np.diag(inverse))

    def own_change(self, sums: Sums, joint: int, kind: int) -> tuple[float, float]:
        """Of a joint, and its standard deviation."""
        _, _, u, J = (each[..., joint, kind] if k > 1 else each for k, each in enumerate(self._whitened(sums)))
        return float(u / J), float(np.sqrt(self.own_spread[joint, kind] / min(J, self.shown[1][joint, kind])))


def _times(matrix: np.ndarray, vector: np.ndarray) -> FloatArray:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _scatter(windows: Sums, apart: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What `Baseline` has of m (nj, 4), P (nj, 4, 4) and n (nj,), of k windows of which `apart` share no block.

    Expectation maximisation for random effects (Laird & Ware, Biometrics 38, 1982).
    """
    unit = 1.0 / np.sqrt(np.maximum(np.einsum("...ii->...i", windows.own).mean(axis=0), TINY))
    S = windows.own * unit[:, :, None] * unit[:, None, :] + RIDGE * np.eye(4)
    b = windows.own_error * unit
    mean = _times(np.linalg.inv(S.sum(axis=0)), b.sum(axis=0))
    error = b - _times(S, mean)
    P, n = np.tile(np.eye(4), (len(unit), 1, 1)), np.ones(len(unit))
    for _ in range(STEPS):
        M = np.linalg.inv(S @ P + n[:, None, None] * np.eye(4))
        u = _times(M, error)
        own, covariance = _times(P, u), P - P @ M @ S @ P
        left = n[:, None] * u
        squares = (left * np.linalg.solve(S, left[..., None])[..., 0]).sum(axis=-1)
        n = np.maximum((squares + np.einsum("...ij,...ji->...", S, covariance)).mean(axis=0) / 4, RIDGE)
        each = (own[..., None] * own[..., None, :] + covariance).mean(axis=0)
        P = (apart * each + SHARED * each.mean(axis=0)) / (apart + SHARED)
    return mean * unit, P * unit[:, :, None] * unit[:, None, :], n


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
        self.drop()

    def drop(self) -> None:
        """Forget the block that is not complete."""
        self._sum, self._count, self._start = Sums.none(len(self._level)), 0, 0.0

    def due(self, time: float) -> bool:
        """Whether another sample is wanted."""
        return not 0.0 <= time - self._last < SAMPLE

    def observe(self, step: Step, bandwidth: float) -> None:
        """Take the columns at a sample that does not count; arguments as of `take`."""
        self._last = step.time
        self.load, self.own, self._way = (each.copy() for each in self._columns(*step.motion, bandwidth))

    def take(self, step: Step, bandwidth: float) -> bool:
        """Add a sample; whether a block is complete with it.

        Args:
            step: what the observer says of it.
            bandwidth: of the observer, 1/s.
        """
        self.observe(step, bandwidth)
        load, own = self.load, self.own
        if not (np.abs(self._way) >= CERTAIN).any():
            return False
        weight = 1.0 / (self._level * step.sources).sum(axis=1)
        if self._count == 0:
            self._start = step.time
        of_load, of_own = (each[:, None, :] * weight[:, None, None] for each in (load, own))
        total = self._sum
        total.load[...] += load[:, :, None] * of_load
        total.load_error[...] += of_load[:, 0] * step.residual[:, None]
        total.cross[...] += load[:, :, None] * of_own
        total.own[...] += own[:, :, None] * of_own
        total.own_error[...] += of_own[:, 0] * step.residual[:, None]
        self._count += 1
        if self._count < round(BLOCK / SAMPLE):
            return False
        self.begins.append(self._start)
        self.sums.append(total)
        self.drop()
        return True
