"""Appraisal by sums around one fit: for models that are linear in most of their unknowns, as an arm is."""

from collections.abc import Sequence

import numpy as np

from armdyn.identify.appraisal import Appraisal, Change, SampleAppraiser
from armdyn.identify.candidate import Candidate
from armdyn.identify.leftover import level_of
from armdyn.identify.subset import Solver, Subset, inverse_of_at_least_one
from armdyn.identify.sums import Sums

HELD = 1e-6
"""Share of an effect's square that is left beside another one which can do all that it does."""
LEVELS = 4
"""Rounds in which the richest model's fit and the error that it leaves, which weighs it, settle."""


class Summed(SampleAppraiser):
    """Appraises sets by one expansion.

    Args:
        sums: see `Appraiser`, as the next two.
        always: unknowns that are free in every set.
        candidates: effects.
        loose: times their prior widths that effects may have where a gain is foretold of them.

    Attributes:
        left: residual of every training unit in the model with all effects.
    """

    def __init__(self, sums: Sums, always: np.ndarray, candidates: Sequence[Candidate], *, loose: float = 1.0) -> None:
        super().__init__(sums, always, candidates)
        self._loose = loose
        self._solver = Solver(sums, always, candidates)
        self.left = self._richest()
        self.measure(self.left)
        self._solver.weigh(self.independent / (sums.count * self.level))

    def _solved(self, effects: tuple[Candidate, ...]) -> tuple[Solver, Subset]:
        return self._solver, self._solver.subset(effects)

    def values(self, one: Appraisal) -> np.ndarray:
        """See `Appraiser.values`; foretold."""
        return self._values(one.columns, one.change)

    def minimum(self, effects: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What a set is fitted to, without what it is worth: much faster than `of`.

        Returns:
            (c,) the unknowns that change, (c,) the change that predictions are linear in, (P,) values of all unknowns.
        """
        one = self._solver.subset(effects)
        change, effective = self._solver.minimum(one, self._training)
        return one.columns, effective, self._values(one.columns, change)

    def _values(self, columns: np.ndarray, change: np.ndarray) -> np.ndarray:
        exact = np.zeros(len(self.sums.values), dtype=bool)
        for c in self._solver.bends:
            exact[self._solver.columns[c]] = True
        return self.sums.changed(columns, change, exact)

    def promising(self, now: Appraisal, changes: Sequence[Change], most: int) -> list[Appraisal]:
        """See `Appraiser.promising`."""
        return [self.of(effects) for effects, _ in self.foretold(now, changes)[:most]]

    def foretold(self, now: Appraisal, changes: Sequence[Change]) -> list[tuple[tuple[Candidate, ...], float]]:
        """Sets after changes, best first, each with weighted squared error and twice the price."""
        found: list[tuple[tuple[Candidate, ...], float]] = []
        coming: dict[tuple[Candidate, ...], list[Sequence[Candidate]]] = {}
        for gone, come in changes:
            coming.setdefault(tuple(gone), []).append(come)
        for gone, options in coming.items():
            rest = self.of([c for c in now.effects if c not in gone])
            remaining = self.remaining(rest)
            for come, gain in zip(options, self._gains(rest, options), strict=True):
                effects = (*rest.effects, *come)
                found.append((effects, remaining - float(gain) + 2.0 * self.price(effects)))
        return sorted(found, key=lambda one: one[1])

    def contenders(self, rest: Appraisal) -> tuple[Candidate, ...]:
        """See `Appraiser.contenders`; all, since asking costs little."""
        del rest
        return self.candidates

    def holds(self, richer: Candidate, simpler: Candidate) -> bool:
        """See `Appraiser.holds`."""
        own, other = self._solver.columns[richer], self._solver.columns[simpler]
        if simpler.joints != richer.joints or not 0 < len(other) < len(own):
            return False
        G = self._solver.normal(self._training)[0]
        within = np.linalg.lstsq(G[np.ix_(own, own)], G[np.ix_(own, other)], rcond=1e-10)[0]
        left = np.diag(G)[other] - np.sum(G[np.ix_(own, other)] * within, axis=0)
        return bool(np.all(left <= HELD * np.diag(G)[other]))

    def _gains(self, now: Appraisal, options: Sequence[Sequence[Candidate]]) -> np.ndarray:
        """(k,) fall of the weighted squared error of the training runs that k additions to a set promise."""
        G, slope = self._solver.normal(self._training)
        width = self._solver.width
        C, gone = now.columns[now.free], now.columns[~now.free]
        # Priors pull as well where the expansion's point is not at their mean.
        slope = slope - G[:, gone] @ now.effective[~now.free] + self._solver.centre * width**-2.0
        # In units of their widths, so that the matrices are no worse than one, whatever the runs tell.
        G, slope = width[:, None] * G * width, width * slope
        inner = inverse_of_at_least_one(G[np.ix_(C, C)] + np.eye(len(C))) @ np.column_stack([G[C], slope[C]])
        left, rest = G - G[:, C] @ inner[:, :-1], slope - G[:, C] @ inner[:, -1]
        there, most = set(C.tolist()), self.remaining(now)
        gains = np.zeros(len(options))
        for i, option in enumerate(options):
            own = np.array([j for c in option for j in self._solver.columns[c] if j not in there], dtype=int)
            if len(own):
                S = left[own[:, None], own] + np.eye(len(own)) / self._loose**2
                gains[i] = rest[own] @ np.linalg.lstsq(S, rest[own], rcond=1e-12)[0]
        return np.clip(gains, 0.0, most)

    def remaining(self, one: Appraisal) -> float:
        """Weighted squared error of the training runs that a set leaves."""
        return float(self._solver.weight[self._training] * self.sums.count[self._training] @ one.errors)

    def deviations(self, one: Appraisal) -> np.ndarray:
        """See `Appraiser.deviations`."""
        return deviations(self._solver, one, self._training)

    def _richest(self) -> dict[int, np.ndarray]:
        """Residual of every training unit in the model with all effects."""
        s = self.sums
        whole = self._solver.subset(self.candidates)
        every, units = whole.columns, self._training
        level, still = s.noise**2, s.square / s.count
        for _ in range(LEVELS):
            self._solver.weigh(1.0 / level)
            change = self._solver.linear(every, whole.free, units)
            error = s.errors(every, change, np.arange(len(s.count)))
            if (s.count / level)[units] @ (error - still)[units] > 0.0:
                # Where errors grow from swing to swing, bounds leave a linear answer that is worse than none.
                change, error = np.zeros(len(every)), still
            level = level_of(s, error)
        return {unit: s.residual(unit, every, change) for unit in units.tolist()}


def deviations(solver: Solver, one: Appraisal, units: np.ndarray) -> np.ndarray:
    """(P,) standard deviations of a set's unknowns fitted to units (u,); 0 of the others."""
    C = one.columns[one.free]
    width = solver.width[C]
    G = width[:, None] * solver.normal(units)[0][np.ix_(C, C)] * width
    result = np.zeros(len(solver.sums.values))
    result[C] = width * np.sqrt(np.diag(inverse_of_at_least_one(G + np.eye(len(C)))))
    return result
