r"""What a set of effects is worth to runs, in nats: one score from clean simulations to recordings of real arms.

    worth = fit + transfer - price

fit       log evidence of the training runs: likelihood, less Occam's factor log det(I + T G T) / 2 of the unknowns, T
          their typical sizes (MacKay, Neural Computation 4, 1992), and a Cauchy prior on their sizes.
transfer  log likelihood of every run as predicted by a fit to the *other* training runs: what decides where no model
          is complete, and there training alone names whatever bends most.
price     what a set must gain to be believed; see `Appraiser.price`.

The model's own error is an unknown variance d^2 >= 0 of each joint or channel beside the sensor's s^2. At its best
value the likelihood of n independent samples with mean squared error E is

    -n/2 (E/s^2 - 1)  where E < s^2 (noise-limited),      -n/2 log(E/s^2)  where E > s^2 (model-limited),

with the same slope where they meet. n counts independent samples: what the richest model leaves is correlated, and N
samples of a correlation time of k samples are worth N/k (Bayley & Hammersley, J. R. Stat. Soc. Suppl. 8, 1946).
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log, sqrt
from typing import ClassVar

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from armdyn.identify.candidate import Candidate
from armdyn.identify.leftover import independent_samples, level_of
from armdyn.identify.problem import Problem
from armdyn.identify.subset import Solver, Subset
from armdyn.identify.sums import Sums

SURE = log(100.0)
"""Nats beyond chance at which an effect is believed: one false name in a hundred clean recordings."""
DIMINISHED = 0.2
"""Of the squared error that n values explain, over n squared, what each further one must explain where the model's own
error is what is left: much beside one strong effect, little where an error is spread. A UR10e's held-out error is
3.80 N m with 0.2 and 23 values, 4.45 with 0.3 and 14."""
MARKED = 1.0
"""Logarithm of the squared error by which n further values, times the root of n, always explain enough, however much
one strong effect explained before: a spring that explains most of what a friction leaves."""
NOISY = 1.2
"""Power of what the richest model leaves, over the noise's, up to which it counts as noise: clean simulations reach 1.1
by chance."""
HARM = 0.02
"""Share by which an effect may make the total error of a predicted run larger."""


Change = tuple[Sequence[Candidate], Sequence[Candidate]]
"""Effects that leave a set, and those that come."""


@dataclass(frozen=True, eq=False)
class Appraisal:
    """What one set of effects is worth.

    Attributes:
        effects: of the set, each on one joint.
        worth: nats; compare with that of other sets for the same runs.
        fit: log evidence of the training runs.
        transfer: log likelihood of runs as predicted from the others; 0 where there is nothing to predict.
        price: nats.
        columns: (c,) the unknowns that change.
        free: (c,) bool, those that are fitted; the others return to null.
        change: (c,) their change from the expansion's point in a fit to all training runs.
        effective: (c,) the change that predictions are linear in; see `Linear.bend`.
        errors: (t,) mean squared error of the training units there.
        likelihood: log likelihood of the training runs.
        values: number of the effects' unknowns that the runs determine rather than the priors.
        predicted: (u,) mean squared error of the predicted units.
        misfit: squared error of held-out runs where such are given, else of runs predicted in turn, else of the
            training run, at least the noise's; summed over channels, in the unit's square where they share one, else
            over the noise.
        overall: likewise, of a training run, predicted from the others where there are others, plus that of a held-out
            run where such are given, means over runs. What explains one kind of motion alone is not what is missing.
        totals: (r, k) error of every predicted run over its channels of each unit, root of the sum of squares.
    """

    effects: tuple[Candidate, ...]
    worth: float
    fit: float
    transfer: float
    price: float
    columns: np.ndarray
    free: np.ndarray
    change: np.ndarray
    effective: np.ndarray
    errors: np.ndarray
    likelihood: float
    values: float
    predicted: np.ndarray
    misfit: float
    overall: float
    totals: np.ndarray

    def carries_over(self, before: "Appraisal") -> bool:
        """Whether other runs, where there are any, are predicted better than `before`, and none of them worse."""
        return len(self.predicted) == 0 or (self.transfer > before.transfer and not self.harms(before))

    def harms(self, before: "Appraisal") -> bool:
        """Whether a run is predicted worse than `before`."""
        return bool(np.any(self.totals > (1.0 + HARM) * before.totals))


@dataclass(frozen=True, eq=False)
class Described:
    """A set in numbers for a person.

    Attributes:
        rmse: by channel, of the training runs.
        held_out_rmse: by channel, of runs predicted from others; empty where there are none.
        values: (k,) of the unknowns that were asked for.
        deviations: (k,) their standard deviations.
    """

    rmse: dict[str, float]
    held_out_rmse: dict[str, float]
    values: np.ndarray
    deviations: np.ndarray


class Appraiser(ABC):
    """Appraises sets of effects.

    Args:
        problem: whose unknowns effects have.
        candidates: all effects that a set may hold, each on one joint.

    Attributes:
        limited: share of what the richest model leaves that is more than noise: 0 noise-limited, 1 model-limited.
    """

    limited: float
    most_named: ClassVar[int] = 8
    """Effects of a table of suspects."""
    few: ClassVar[bool] = False
    """Whether there are few candidates with a value or two each, as a pendulum's: then two at once are tried as well,
    which a third may imitate, and worth alone says which set is best."""

    def __init__(self, problem: Problem, candidates: Sequence[Candidate]) -> None:
        self.problem = problem
        self.candidates = tuple(candidates)
        self._reach = Counter(c.effect for c in candidates)
        self._known: dict[frozenset[Candidate], Appraisal] = {}

    @abstractmethod
    def _appraised(self, effects: tuple[Candidate, ...]) -> Appraisal:
        """The appraisal of a set, in the order of the candidates."""

    @abstractmethod
    def values(self, one: Appraisal) -> np.ndarray:
        """(P,) values of all unknowns at a set's minimum."""

    @abstractmethod
    def useful(self, more: Appraisal, fewer: Appraisal) -> bool:
        """Whether the further values of a set explain enough beside what `fewer` explain."""

    @abstractmethod
    def standing(self, one: Appraisal) -> float:
        """Nats by which two sets are held against each other, without the prior on sizes (Schwarz 1978).

        Runs alone decide whether they can tell two sets apart.
        """

    @abstractmethod
    def described(self, one: Appraisal, own: np.ndarray) -> Described:
        """A set in numbers for a person; `own` (k,) are the unknowns whose values are asked for."""

    @abstractmethod
    def promising(self, now: Appraisal, changes: Sequence[Change], most: int) -> list[Appraisal]:
        """Of sets that differ from one by changes, those that are foretold to be worth most, at most so many."""

    @abstractmethod
    def contenders(self, rest: Appraisal) -> tuple[Candidate, ...]:
        """Effects that may be worth as much as any other beside a set."""

    @abstractmethod
    def holds(self, richer: Candidate, simpler: Candidate) -> bool:
        """Whether an effect on the same joint can do all that a simpler one does, as asymmetric friction can."""

    def advance(self, now: Appraisal) -> None:
        """Told what the best set is so far: what is foretold of others may start there."""
        del now

    def settle(self, effects: Iterable[Candidate]) -> Appraisal:
        """The appraisal of a set where it is surest; others are appraised from there."""
        return self.of(effects)

    def with_one_more(self, now: Appraisal, left: Sequence[Candidate]) -> list[Appraisal]:
        """Sets with one effect more that may be the best of them."""
        return [self.of((*now.effects, c)) for c in left]

    def within(self, effects: Iterable[Candidate]) -> tuple[Candidate, ...]:
        """The candidates, each on one joint, that make up `effects`."""
        names = {name for effect in effects for name in effect.names}
        return tuple(c for c in self.candidates if names.issuperset(c.names))

    def of(self, effects: Iterable[Candidate]) -> Appraisal:
        """The appraisal of one set."""
        key = frozenset(effects)
        if key not in self._known:
            self._known[key] = self._appraised(tuple(c for c in self.candidates if c in key))
        return self._known[key]

    def without(self, now: Appraisal, gone: Candidate) -> Appraisal:
        """The appraisal of a set without one of its effects."""
        return self.of([c for c in now.effects if c != gone])

    def price(self, effects: Sequence[Candidate]) -> float:
        """What a set must gain over no effect at all, nats.

        Each effect could have been another one of the catalogue, each of its joints another joint, and is to be sure
        beyond that.
        """
        joints = Counter(c.effect for c in effects)
        return sum(log(len(self._reach)) + n * (log(self._reach[name]) + SURE) for name, n in joints.items())


class SampleAppraiser(Appraiser):
    """Appraises sets by sums over samples, each as if it were independent of the others.

    Args:
        sums: of training runs and of runs that are only predicted.
        always: (P,) bool, unknowns that are free in every set.
        candidates: all effects that a set may hold, each on one joint.

    Attributes:
        level: (U,) variance that the richest model leaves, at least the noise.
        independent: (U,) independent samples in it.
    """

    level: np.ndarray
    independent: np.ndarray

    def __init__(self, sums: Sums, always: np.ndarray, candidates: Sequence[Candidate]) -> None:
        super().__init__(sums.problem, candidates)
        self.sums = sums
        self._always = always
        self._typical = np.minimum(sums.problem.typical, sums.width)
        self._by_channel = [np.flatnonzero(sums.training & (sums.channel == i)) for i in range(len(sums.channels))]
        self._training = np.flatnonzero(sums.training)
        self._owner = np.array([-1 if c.run is None else c.run for c in sums.problem.columns])
        training = tuple(np.flatnonzero(np.isin(np.arange(len(sums.runs)), sums.run[sums.training])))
        # With a single training run there are no others to predict it from.
        self.predicted_runs = tuple(r for r in range(len(sums.runs)) if r not in training or len(training) > 1)
        self._folds = [
            _Fold(run, np.flatnonzero(sums.run == run), np.flatnonzero(sums.training & (sums.run != run)))
            for run in self.predicted_runs
        ]
        measured = [next(r.channels[c].unit for r in sums.problem.runs if c in r.channels) for c in sums.channels]
        self._importance = np.ones(len(sums.count)) if len(set(measured)) == 1 else sums.noise**-2.0
        self._kinds = np.array([sorted(set(measured)).index(unit) for unit in measured])

    def measure(self, left: Mapping[int, np.ndarray]) -> None:
        """Take levels and independent samples from the residual of every training unit in the best model there is."""
        self.level, self.independent = self._levels(left), independent_samples(self.sums, left)
        self.limited = self._beyond_noise()
        self._known.clear()

    def _levels(self, left: Mapping[int, np.ndarray]) -> np.ndarray:
        """(U,) variance of each channel from the residual of every training unit, at least its noise's."""
        error = np.zeros(len(self.sums.count))
        for unit, residual in left.items():
            error[unit] = np.mean(residual**2)
        return level_of(self.sums, error)

    @abstractmethod
    def _solved(self, effects: tuple[Candidate, ...]) -> tuple[Solver, Subset]:
        """Where a set is fitted, by sums that hold there, and its columns."""

    @abstractmethod
    def deviations(self, one: Appraisal) -> np.ndarray:
        """(P,) standard deviations of a set's unknowns, the model's own error counted in; 0 of the others."""

    def useful(self, more: Appraisal, fewer: Appraisal) -> bool:
        """Whether the further values of a set explain enough beside what `fewer` explain, or most of what these leave.

        Returns diminish. Training counts as much as held-out runs: what is strong in one kind of motion may be weak in
        another, and small errors beside it are small all the same.
        """
        if self.limited == 0.0:
            return True
        had = int(np.sum(fewer.free) - np.sum(self._always))
        further = int(np.sum(more.free) - np.sum(fewer.free))
        expected = (self.of(()).overall - fewer.overall) / max(had, 1) ** 2
        if fewer.overall - more.overall >= DIMINISHED * further * max(expected, 0.0):
            return True
        return log(fewer.overall / more.overall) >= MARKED * sqrt(max(further, 0))

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

    @property
    def floor(self) -> float:
        """The `misfit` of noise alone."""
        return float(self._importance[self._judged] @ self.sums.noise[self._judged] ** 2)

    def _beyond_noise(self) -> float:
        """Share of what the richest model leaves that is more than noise, the mean over channels.

        A shoulder whose torque is noisy hides nothing of what an elbow's shows.
        """
        channels = [units for units in self._by_channel if len(units)]
        noise = [np.sum(self.sums.noise[units] ** 2) / np.sum(self.level[units]) for units in channels]
        return max(0.0, 1.0 - NOISY * float(np.mean(noise)))

    def standing(self, one: Appraisal) -> float:
        """See `Appraiser.standing`; where only noise is left, likelihood counts twice in the evidence."""
        samples = float(np.sum(self.independent[self.sums.training]))
        occam = one.likelihood - one.fit
        found = one.likelihood + one.transfer + (1.0 - self.limited) * occam - 0.5 * one.values * log(max(samples, 2.0))
        return found / (2.0 - self.limited)

    def described(self, one: Appraisal, own: np.ndarray) -> Described:
        """See `Appraiser.described`."""
        s = self.sums
        values, deviations = self.values(one), self.deviations(one)
        none = np.zeros(0, dtype=int)
        predicted = np.concatenate([none, *(np.flatnonzero(s.run == r) for r in self.predicted_runs)])
        return Described(
            rmse=self._rmse(np.flatnonzero(s.training), one.errors),
            held_out_rmse=self._rmse(predicted, one.predicted) if len(one.predicted) else {},
            values=values[own],
            deviations=deviations[own],
        )

    def _rmse(self, units: np.ndarray, errors: np.ndarray) -> dict[str, float]:
        """Rms error of every channel over units with (u,) mean squared errors."""
        s = self.sums
        result = {}
        for channel, name in enumerate(s.channels):
            mine = s.channel[units] == channel
            if mine.any():
                result[name] = float(np.sqrt(np.average(errors[mine], weights=s.count[units][mine])))
        return result

    def _appraised(self, effects: tuple[Candidate, ...]) -> Appraisal:
        s = self.sums
        solver, one = self._solved(effects)
        columns, free = one.columns, one.free
        change, effective = solver.minimum(one, self._training)
        left = solver.sums.errors(columns, effective, self._training)
        likelihood = self._log_likelihood(left) - self._against_priors(solver, columns, change)
        occam, values = self._freedom(solver, columns[free], change[free], self._training)
        whole = solver.cost(one, change, effective, self._training)
        foretold = [self._predicted(solver, one, change, whole, fold) for fold in self._folds]
        predicted = np.concatenate([np.zeros(0), *(error for error, _ in foretold)])
        errors = [counts * error for error, counts in foretold]
        counted = np.concatenate([np.zeros(0), *errors])
        units = np.concatenate([np.zeros(0, dtype=int), *(fold.units for fold in self._folds)])
        price, fit = self.price(effects), likelihood - occam
        transfer = -0.5 * float(self.independent[units] @ _misfit(counted / s.noise[units] ** 2))
        # Where only noise is left, likelihood says all that predicted runs could say.
        transfer = self.limited * transfer + (1.0 - self.limited) * fit
        error = np.zeros(len(s.count))
        error[self._training] = left
        error[units] = counted
        floored = np.maximum(error, s.noise**2)
        return Appraisal(
            effects=effects,
            worth=fit + transfer - price if self._inside(solver, one, change, effective) else -np.inf,
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
            totals=np.array([self._totals(e, fold.units) for e, fold in zip(errors, self._folds, strict=True)]),
        )

    def _totals(self, errors: np.ndarray, units: np.ndarray) -> np.ndarray:
        """(k,) root of the summed mean squared errors over the channels of each unit of measurement, at least noise."""
        floored = np.maximum(errors, self.sums.noise[units] ** 2)
        kinds = self._kinds[self.sums.channel[units]]
        return np.sqrt(np.bincount(kinds, weights=floored, minlength=int(self._kinds.max()) + 1))

    def _inside(self, solver: Solver, one: Subset, change: np.ndarray, effective: np.ndarray) -> bool:
        """Whether no effect explains what it does by a value that the runs pull beyond a bound.

        A bound at which the effect is absent, and one from which they pull no more than by chance, is none.
        """
        p, C = self.sums.problem, one.columns
        value = solver.sums.values[C] + change
        on = ((value <= p.lower[C]) | (value >= p.upper[C])) & (value != p.null[C]) & one.free & ~self._always[C]
        if not on.any():
            return True
        G, slope = solver.normal(self._training)
        pull = (slope[C] - G[C[:, None], C] @ effective)[on]
        return bool(np.all(0.5 * pull**2 / np.diag(G)[C[on]] < SURE))

    def _log_likelihood(self, error: np.ndarray) -> float:
        """Of training units with (t,) mean squared errors, with one variance of the model's own for each channel."""
        s = self.sums
        ratio = np.zeros(len(s.count))
        ratio[self._training] = error / s.noise[self._training] ** 2
        channels = [units for units in self._by_channel if len(units)]
        mean = np.array([np.average(ratio[units], weights=s.count[units]) for units in channels])
        samples = np.array([self.independent[units].sum() for units in channels])
        return -0.5 * float(samples @ _misfit(mean))

    def _freedom(
        self, solver: Solver, columns: np.ndarray, change: np.ndarray, units: np.ndarray
    ) -> tuple[float, float]:
        """Nats that the freedom of a set's own unknowns costs in units (u,), and how many of them these determine."""
        p, own = self.sums.problem, ~self._always[columns]
        C = columns[own]
        d = (solver.sums.values[columns] + change)[own] - np.where(p.prior_weight > 0, p.prior_mean, p.null)[C]
        if len(C) == 0:
            return 0.0, 0.0
        T = self._typical[C]
        A = T[:, None] * solver.normal(units)[0][C[:, None], C] * T
        A.flat[:: len(C) + 1] += 1.0
        factor, failed = dpotrf(A, lower=1, clean=1)
        if failed:  # where errors grow from swing to swing, rounding leaves less than the one that was added
            spread = np.maximum(np.linalg.eigvalsh(A), 1.0)
            return float(0.5 * np.sum(np.log(spread)) + np.sum(np.log1p((d / T) ** 2))), float(
                np.sum(1.0 - 1.0 / spread)
            )
        inverse, _ = dtrtri(factor, lower=1)
        values = len(C) - float(np.sum(inverse**2))
        return float(np.sum(np.log(np.diag(factor))) + np.sum(np.log1p((d / T) ** 2))), values

    def _against_priors(self, solver: Solver, columns: np.ndarray, change: np.ndarray) -> float:
        """Nats by which unknowns of every set contradict what was measured of them by hand."""
        p, value = self.sums.problem, solver.sums.values[columns] + change
        off = (p.prior_weight[columns] * (value - p.prior_mean[columns]))[self._always[columns]]
        return 0.5 * float(off @ off)

    def _predicted(
        self, solver: Solver, one: Subset, change: np.ndarray, whole: float, fold: "_Fold"
    ) -> tuple[np.ndarray, float]:
        """(u,) mean squared error of a run, predicted by a fit to the other training runs; its own unknowns fit it.

        Beside it, how many times it counts. An effect that has values of its own in that run is no better for being
        fitted to it: the error counts as larger by their Occam factor. Where only noise is left, the part of it that is
        no more than what the others leave uncertain does not count: what a run adds to the cost of the others is
        r' (1 + J S J')^-1 r, with r the prediction's error and S the covariance of what the others say.
        """
        near, effective = solver.minimum(one, fold.others, change)
        before = solver.cost(one, near, effective, fold.others)
        own = one.free & (self._owner[one.columns] == fold.run)
        freedom = 0.0
        if own.any():
            effective = solver.linear(one.columns, own, fold.units, effective)
            freedom, _ = self._freedom(solver, one.columns[own], effective[own], fold.units)
        error = solver.sums.errors(one.columns, effective, fold.units)
        occam = float(np.exp(self.limited * 2.0 * freedom / np.sum(self.independent[fold.units])))
        total = float(solver.weight[fold.units] * self.sums.count[fold.units] @ error)
        if not self.sums.training[fold.units].any() or total == 0.0:
            return error, occam
        certain = float(np.clip((whole - before) / total, 0.0, 1.0))
        return error, occam * (self.limited + (1.0 - self.limited) * certain)


@dataclass(frozen=True, eq=False)
class _Fold:
    """A run to be predicted, its units, and those of the other training runs."""

    run: int
    units: np.ndarray
    others: np.ndarray


def _misfit(ratio: np.ndarray) -> np.ndarray:
    """-2 log likelihood per sample at the best variance of the model's own error, of squared error over noise."""
    return np.where(ratio < 1.0, ratio - 1.0, np.log(np.maximum(ratio, 1.0)))
