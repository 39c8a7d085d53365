"""The fit of one set of effects to some runs, by sums: a small linear solve with bounds, exact where links bend."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from armdyn.identify.candidate import Candidate
from armdyn.identify.sums import Sums
from armdyn.linear.solve import solve_bounded
from armdyn.model import Bend

BENT_STEPS = 25
"""Gauss-Newton steps on the sums, at most, for unknowns that predictions are not linear in: most links need 12."""
SETTLED = 0.5
"""Nats that do not matter."""


@dataclass(frozen=True, eq=False)
class Subset:
    """The columns that change with a set, those that are free, and where some enter predictions by other quantities."""

    columns: np.ndarray
    free: np.ndarray
    bent: tuple["_Bent", ...]


@dataclass(frozen=True, eq=False)
class _Bent:
    """Where the unknowns of an effect are among the columns, and those that they act through."""

    own: np.ndarray
    through: np.ndarray
    bend: Bend


class Solver:
    """Fits of sets of effects to units, by weighted sums.

    Args:
        sums: of training runs and of runs that are only predicted.
        always: (P,) bool, unknowns that are free in every set.
        candidates: all effects that a set may hold, each on one joint.

    Attributes:
        columns: by candidate, (k,) where its unknowns are.
        bends: by candidate whose unknowns act through others: where those are, and how.
        width: (P,) prior standard deviation of the unknowns.
        centre: (P,) prior mean of their changes.
        weight: (U,) of the squared errors.
    """

    def __init__(self, sums: Sums, always: np.ndarray, candidates: Sequence[Candidate]) -> None:
        p = sums.problem
        self.sums, self.always = sums, always
        self.columns = {c: np.flatnonzero(p.of(c.names)) for c in candidates}
        # Effects that the expansion's point holds return to null in sets without them.
        own = np.isin(np.arange(len(p.columns)), np.concatenate([*self.columns.values(), np.zeros(0, dtype=int)]))
        direct = sums.driver == np.arange(len(p.columns))
        self._away = own & ~always & direct & (sums.values != p.null)
        self._to_null = p.null - sums.values
        self.width, self.centre = sums.width, sums.centre
        self._lower, self._upper = p.lower - sums.values, p.upper - sums.values
        bends = {c: self._bend(c) for c in candidates}
        self.bends = {c: bend for c, bend in bends.items() if bend is not None}
        self.weight = np.ones(len(sums.count))
        self._normals: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def weigh(self, weight: np.ndarray) -> None:
        """Weigh the squared errors of units by (U,) `weight`."""
        self.weight = weight
        self._normals.clear()

    def subset(self, effects: Iterable[Candidate]) -> "Subset":
        """The columns that change with a set."""
        fitted, touched = self.always.copy(), self._away.copy()
        effects = tuple(effects)
        for c in effects:
            fitted[self.columns[c]] = True
            if c in self.bends:
                touched[self.bends[c][0]] = True
        columns = np.flatnonzero(fitted | touched)
        bent = tuple(
            _Bent(np.searchsorted(columns, self.columns[c]), np.searchsorted(columns, through), bend)
            for c in effects
            if c in self.bends
            for through, bend in [self.bends[c]]
        )
        return Subset(columns, fitted[columns], bent)

    def _bend(self, candidate: Candidate) -> tuple[np.ndarray, Bend] | None:
        """Columns through which a candidate's unknowns act, and how, around the expansion's point."""
        p = self.sums.problem
        theta = p.theta(0, self.sums.values)
        bend = p.model.bend(candidate.names, theta) if candidate.names else None
        return None if bend is None else (np.flatnonzero(p.of(bend.through)), bend)

    def normal(self, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, P) weighted sum of X'X and (P,) of X'r over units (u,)."""
        key = units.tobytes()
        if key not in self._normals:
            w = self.weight[units]
            self._normals[key] = np.tensordot(w, self.sums.gram[units], 1), w @ self.sums.slope[units]
        return self._normals[key]

    def minimum(
        self, one: "Subset", units: np.ndarray, near: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """(c,) change of a set's unknowns that fits units best, and (c,) the change that predictions are linear in.

        The two differ where a link is deformed: by Gauss-Newton steps from `near`, or from the linear answer, on the
        sums, which stay exact.
        """
        effective = self.linear(one.columns, one.free, units)
        if not one.bent or not self._curved(one, effective, units):
            return effective, effective
        G, slope = self.normal(units)
        C = one.columns
        G, slope = G[C[:, None], C], slope[C]
        weight = np.where(one.free, self.width[C] ** -2.0, 0.0)
        change = effective.copy() if near is None else near.copy()
        if near is None:
            for part in one.bent:
                # A deformation starts from none: the linear answer may be no body's.
                change[part.own] *= part.own[0] != part.through[0]
        y, Z = self._entering(one, change)
        cost = self._cost(G, slope, y, weight, change - self.centre[C])
        i = np.flatnonzero(one.free)
        damping = 0.0
        for _ in range(BENT_STEPS):
            gradient = Z.T @ (slope - G @ y) - weight * (change - self.centre[C])
            A = (Z.T @ G @ Z)[i[:, None], i]
            A.flat[:: len(i) + 1] += weight[i] + damping * A.flat[:: len(i) + 1]
            _, solution, _ = dposv(A, gradient[i], lower=1)
            trial = change.copy()
            trial[i] = np.clip(change[i] + solution, self._lower[C[i]], self._upper[C[i]])
            there, slopes = self._entering(one, trial)
            new = self._cost(G, slope, there, weight, trial - self.centre[C])
            if not new < cost:
                damping = max(10.0 * damping, 1e-2)
                continue
            settled = cost - new < SETTLED
            change, y, Z, cost, damping = trial, there, slopes, new, damping / 10.0
            if settled:
                break
        return change, y

    def cost(self, one: "Subset", change: np.ndarray, effective: np.ndarray, units: np.ndarray) -> float:
        """Weighted squared error of units (u,) and priors at what `minimum` returned."""
        C, s = one.columns, self.sums
        off = ((change - self.centre[C]) / self.width[C])[one.free]
        return float(self.weight[units] * s.count[units] @ s.errors(C, effective, units)) + float(off @ off)

    def _entering(self, one: "Subset", change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(c,) what enters predictions linearly after a change (c,) of the unknowns, and (c, c) its derivatives."""
        y, Z = change.copy(), np.eye(len(change))
        for part in one.bent:
            y[part.own], Z[part.own, part.own] = 0.0, 0.0
        for part in one.bent:
            moved, slopes = part.bend.function(change[part.own])
            y[part.through] += moved
            Z[part.through[:, None], part.own] += slopes
        return y, Z

    def _curved(self, one: "Subset", change: np.ndarray, units: np.ndarray) -> bool:
        """Whether what enters predictions is far from the unknowns themselves."""
        y, _ = self._entering(one, change)
        C, d = one.columns, y - change
        G, _ = self.normal(units)
        return not float(d @ G[C[:, None], C] @ d) < SETTLED

    @staticmethod
    def _cost(G: np.ndarray, slope: np.ndarray, y: np.ndarray, weight: np.ndarray, off: np.ndarray) -> float:
        return float(y @ (G @ y) - 2.0 * slope @ y + weight @ off**2)

    def linear(
        self, columns: np.ndarray, free: np.ndarray, units: np.ndarray, others: np.ndarray | None = None
    ) -> np.ndarray:
        """(c,) change of the unknowns that fits units best, within their bounds; those not `free` are at `others`."""
        G, slope = self.normal(units)
        change = np.where(free, 0.0, self._to_null[columns] if others is None else others)
        C, t = columns[free], self.width[columns][free]
        right = slope[C] - G[C[:, None], columns[~free]] @ change[~free]
        A = t[:, None] * G[C[:, None], C] * t
        A.flat[:: len(C) + 1] += 1.0
        found = solve_bounded(A, t * right + self.centre[C] / t, self._lower[C] / t, self._upper[C] / t)
        change[free] = t * found.x
        return change
