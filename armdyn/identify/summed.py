"""Appraisal by sums around one fit: for models that are linear in most of their unknowns, as an arm is."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from math import exp, log, sqrt

import numpy as np
from scipy.special import chdtri

from armdyn.identify.appraisal import SURE, Appraisal, Appraiser
from armdyn.identify.candidate import Candidate
from armdyn.identify.sample_evidence import SampleEvidence, misfit_of
from armdyn.identify.simplest import simplest_of_best
from armdyn.identify.subset import Solver
from armdyn.identify.sums import Sums

DIMINISHED = 0.2
"""Of the squared error that n values explain, over n squared, what each further one must explain where the model's own
error is what is left: much beside one strong effect, little where an error is spread. A UR10e's held-out error is
3.80 N m with 0.2 and 23 values, 4.45 with 0.3 and 14."""
MARKED = 1.0
"""Logarithm of the squared error by which n further values, times the root of n, always explain enough, however much
one strong effect explained before: a spring that explains most of what a friction leaves."""
HELD = 1e-6
"""Share of an effect's square that is left beside another one which can do all that it does."""
LEVELS = 4
"""Rounds in which the richest model's fit and the error that it leaves, which weighs it, settle."""
Change = tuple[Sequence[Candidate], Sequence[Candidate]]
"""Effects that leave a set, and those that come."""


class Summed(Appraiser):
    """Appraises sets by one expansion.

    Args:
        sums: of training runs and of runs that are only predicted.
        always: (P,) bool, unknowns that are free in every set.
        candidates: all effects that a set may hold, each on one joint.
        given: see `Appraiser`; what they explain counts where returns diminish, as if they had just been found.
        sparse: whether few effects are hoped to explain everything, so that returns need not grow less; see `useful`.

    Attributes:
        limited: share of what the richest model leaves that is more than noise: 0 noise-limited, 1 model-limited.
        complete: whether few effects are hoped to explain everything, and all together leave no more than noise.
    """

    most_named = 8

    def __init__(
        self,
        sums: Sums,
        always: np.ndarray,
        candidates: Sequence[Candidate],
        given: Sequence[Candidate] = (),
        sparse: bool = False,
    ) -> None:
        super().__init__(sums.problem, candidates, given)
        self._sparse = sparse
        self.sums = sums
        self._always = always
        self._solver = Solver(sums, always, candidates)
        self._evidence = SampleEvidence(self._solver)
        self._training = self._evidence.training
        measured = [next(r.channels[c].unit for r in sums.problem.runs if c in r.channels) for c in sums.channels]
        self._importance = np.ones(len(sums.count)) if len(set(measured)) == 1 else sums.noise**-2.0
        self._kinds = np.array([sorted(set(measured)).index(unit) for unit in measured])
        self._evidence.measure(*self._richest())
        self.limited = self._evidence.limited
        self.complete = sparse and self.limited == 0.0

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

    def _appraised(self, effects: tuple[Candidate, ...]) -> Appraisal:
        s = self.sums
        solver, known, one = self._solver, self._evidence, self._solver.subset(effects)
        columns, free = one.columns, one.free
        change, effective = solver.minimum(one, known.training)
        left = solver.sums.errors(columns, effective, known.training)
        likelihood = float(known.log_likelihood(left).sum()) - known.against_priors(columns, change)
        occam, values = known.freedom(columns[free], change[free], known.training)
        whole = solver.cost(one, change, effective, known.training)
        foretold = [known.predicted(one, change, whole, fold) for fold in known.folds]
        predicted = np.concatenate([np.zeros(0), *(error for error, _ in foretold)])
        errors = [counts * error for error, counts in foretold]
        counted = np.concatenate([np.zeros(0), *errors])
        units = np.concatenate([np.zeros(0, dtype=int), *(fold.units for fold in known.folds)])
        price, fit = self.price(effects), likelihood - occam
        transfer = -0.5 * float(known.independent[units] @ misfit_of(counted / s.noise[units] ** 2))
        # Where only noise is left, likelihood says all that predicted runs could say.
        transfer = self.limited * transfer + (1.0 - self.limited) * fit
        error = np.zeros(len(s.count))
        error[known.training] = left
        error[units] = counted
        floored = np.maximum(error, s.noise**2)
        return Appraisal(
            effects=effects,
            worth=fit + transfer - price if known.inside(one, change, effective) else -np.inf,
            fit=fit,
            transfer=transfer,
            price=price,
            columns=columns,
            free=free,
            change=change,
            effective=effective,
            errors=left,
            likelihood=likelihood,
            values=values,
            predicted=predicted,
            misfit=float(self._importance[self._judged] @ floored[self._judged]),
            overall=float(self._overall @ floored),
            totals=np.array([self._totals(e, fold.units) for e, fold in zip(errors, known.folds, strict=True)]),
        )

    def _totals(self, errors: np.ndarray, units: np.ndarray) -> np.ndarray:
        """(k,) root of the summed mean squared errors over the channels of each unit of measurement, at least noise."""
        floored = np.maximum(errors, self.sums.noise[units] ** 2)
        kinds = self._kinds[self.sums.channel[units]]
        return np.sqrt(np.bincount(kinds, weights=floored, minlength=int(self._kinds.max()) + 1))

    @cached_property
    def _judged(self) -> np.ndarray:
        """Units whose error is the `misfit` of a set, by which a search knows when to end."""
        # Runs that were given to be held out are another motion; runs held out in turn are often much alike.
        held_out = np.flatnonzero(~self.sums.training)
        return held_out if len(held_out) else self._training

    @cached_property
    def _overall(self) -> np.ndarray:
        """(U,) weights of squared errors in a set's `overall` misfit."""
        weight = self._importance.copy()
        for mine in (self.sums.training, ~self.sums.training):
            weight[mine] /= max(len(np.unique(self.sums.run[mine])), 1)
        return weight

    def surely(self, more: Appraisal, fewer: Appraisal) -> bool:
        """Whether a set explains more of the training runs than an imitation could, where few effects may explain all.

        Then no run that the others predict badly speaks against it: of what they hardly show they tell little.
        """
        if not self._sparse:
            return False
        before, after = (self._evidence.log_likelihood(one.errors) for one in (fewer, more))
        return bool(np.maximum(after - before - self._evidence.imitable, 0.0).sum() >= more.price - fewer.price)

    def useful(self, more: Appraisal, fewer: Appraisal) -> bool:
        """Whether the further values of a set explain enough beside what `fewer` explain, or most of what these leave.

        Returns diminish where the model's own error is left; where few effects may explain all, what gains more than an
        imitation could is enough. Training counts as much as held-out runs: what is strong in one kind of motion may be
        weak in another, and small errors beside it are small all the same.
        """
        if self.complete or self.surely(more, fewer):
            return True
        had = int(np.sum(fewer.free) - np.sum(self._always))
        further = int(np.sum(more.free) - np.sum(fewer.free))
        expected = (self.of(()).overall - fewer.overall) / max(had, 1) ** 2
        if fewer.overall - more.overall >= DIMINISHED * further * max(expected, 0.0):
            return True
        return log(fewer.overall / more.overall) >= MARKED * sqrt(max(further, 0))

    def usual(self, one: Appraisal) -> tuple[Candidate, ...]:
        """Effects of a set that are no larger than every description is wrong by; see `Effect.usual`.

        Their values, fitted with that as their prior, are such as it draws: the sum of their squares, over its
        variances, is below the `SURE` quantile of chi-squared.
        """
        share = {effect.name: effect.usual for effect in self.problem.model.effects}
        return tuple(c for c in one.effects if share[c.effect] and self._is_usual(one, c, share[c.effect]))

    def _is_usual(self, one: Appraisal, candidate: Candidate, share: float) -> bool:
        own, p = self._solver.columns[candidate], self.sums.problem
        width, centre = self.sums.width.copy(), self.sums.centre.copy()
        width[own], centre[own] = share * p.typical[own], (p.null - self.sums.values)[own]
        solver = Solver(replace(self.sums, width=width, centre=centre), self._always, self.candidates)
        solver.weigh(self._solver.weight)
        subset = solver.subset(one.effects)
        change, _ = solver.minimum(subset, self._training)
        off = (change[np.searchsorted(subset.columns, own)] - centre[own]) / width[own]
        return float(off @ off) < chdtri(len(own), exp(-SURE))

    def best_with_one_more(self, now: Appraisal, left: Sequence[Candidate]) -> Appraisal:
        """See `Appraiser.best_with_one_more`: what leaves least, or stands in for it."""
        return simplest_of_best(now, [self.of((*now.effects, c)) for c in left])

    def standing(self, one: Appraisal) -> float:
        """See `Appraiser.standing`; where only noise is left, likelihood counts twice in the evidence."""
        samples = float(np.sum(self._evidence.independent[self.sums.training]))
        occam = one.likelihood - one.fit
        found = one.likelihood + one.transfer + (1.0 - self.limited) * occam - 0.5 * one.values * log(max(samples, 2.0))
        return found / (2.0 - self.limited)

    def errors(self, one: Appraisal) -> tuple[dict[str, float], dict[str, float]]:
        """See `Appraiser.errors`."""
        predicted = np.concatenate([np.zeros(0, dtype=int), *(fold.units for fold in self._evidence.folds)])
        held_out = self._rmse(predicted, one.predicted) if len(one.predicted) else {}
        return self._rmse(self._training, one.errors), held_out

    def fitted(self, one: Appraisal) -> tuple[np.ndarray, np.ndarray]:
        """See `Appraiser.fitted`; the model's own error is counted in the deviations, 0 for what is not fitted."""
        C = one.columns[one.free]
        width = self._solver.width[C]
        G = width[:, None] * self._solver.normal(self._training)[0][np.ix_(C, C)] * width
        deviations = np.zeros(len(self.sums.values))
        deviations[C] = width * np.sqrt(np.diag(np.linalg.inv(G + np.eye(len(C)))))
        return self.values(one), deviations

    def _rmse(self, units: np.ndarray, errors: np.ndarray) -> dict[str, float]:
        """Rms error of every channel over units with (u,) mean squared errors."""
        s = self.sums
        result = {}
        for channel, name in enumerate(s.channels):
            mine = s.channel[units] == channel
            if mine.any():
                result[name] = float(np.sqrt(np.average(errors[mine], weights=s.count[units][mine])))
        return result

    def shortlist(self, now: Appraisal, changes: Sequence[Change], most: int) -> list[Appraisal]:
        """Of sets that differ from one by changes, those that are foretold to be worth most, at most so many."""
        return [self.of(effects) for effects, _ in self._by_predicted_gain(now, changes)[:most]]

    def _by_predicted_gain(
        self, now: Appraisal, changes: Sequence[Change]
    ) -> list[tuple[tuple[Candidate, ...], float]]:
        """Sets after changes, best first, each with its predicted weighted squared error plus twice its price."""
        found: list[tuple[tuple[Candidate, ...], float]] = []
        coming: dict[tuple[Candidate, ...], list[Sequence[Candidate]]] = {}
        for gone, come in changes:
            coming.setdefault(tuple(gone), []).append(come)
        for gone, options in coming.items():
            rest = self.of([c for c in now.effects if c not in gone])
            remaining = self._remaining(rest)
            for come, gain in zip(options, self._gains(rest, options), strict=True):
                effects = (*rest.effects, *come)
                found.append((effects, remaining - float(gain) + 2.0 * self.price(effects)))
        return sorted(found, key=lambda one: one[1])

    def holds(self, richer: Candidate, simpler: Candidate) -> bool:
        """Whether an effect on the same joint can do all that a simpler one does, as asymmetric friction can."""
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
        inner = np.linalg.solve(G[np.ix_(C, C)] + np.eye(len(C)), np.column_stack([G[C], slope[C]]))
        left, rest = G - G[:, C] @ inner[:, :-1], slope - G[:, C] @ inner[:, -1]
        there, most = set(C.tolist()), self._remaining(now)
        gains = np.zeros(len(options))
        for i, option in enumerate(options):
            own = np.array([j for c in option for j in self._solver.columns[c] if j not in there], dtype=int)
            if len(own):
                S = left[own[:, None], own] + np.eye(len(own))
                gains[i] = rest[own] @ np.linalg.lstsq(S, rest[own], rcond=1e-12)[0]
        return np.clip(gains, 0.0, most)

    def _remaining(self, one: Appraisal) -> float:
        """Weighted squared error of the training runs that a set leaves."""
        return float(self._solver.weight[self._training] * self.sums.count[self._training] @ one.errors)

    def _richest(self) -> tuple[dict[int, np.ndarray], float]:
        """Residual of every training unit in the model with all effects, and how many numbers the runs determine."""
        s = self.sums
        whole = self._solver.subset(self.candidates)
        every, units = whole.columns, self._training
        level = s.noise**2
        for _ in range(LEVELS):
            self._solver.weigh(1.0 / level)
            change = self._solver.linear(every, whole.free, units)
            level = s.level(s.errors(every, change, np.arange(len(s.count))))
        _, values = self._evidence.freedom(every[whole.free], change[whole.free], units)
        return {unit: s.residual(unit, every, change) for unit in units.tolist()}, values
