"""Likelihood, freedom and predictions of a set of effects, by sums over samples: what an appraisal is made of."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from armdyn.identify.appraisal import SURE
from armdyn.identify.noise import correlation_time
from armdyn.identify.subset import Solver, Subset

NOISY = 1.2
"""Power of what the richest model leaves, over the noise's, up to which it counts as noise: clean simulations reach 1.1
where samples are many; see `noisy`."""


def noisy(samples: float) -> float:
    """Mean square, over the noise's, up to which so many independent samples count as noise.

    By chance it varies by a standard deviation of sqrt(2 / samples) about one.
    """
    return NOISY * (1.0 + sqrt(2.0 / max(samples, 1.0)))


@dataclass(frozen=True, eq=False)
class Fold:
    """A run to be predicted, its units, and those of the other training runs."""

    run: int
    units: np.ndarray
    others: np.ndarray


class SampleEvidence:
    """What runs say of subsets of the unknowns, each sample as if it were independent of the others.

    Args:
        solver: of the sums of training runs and of runs that are only predicted.

    Attributes:
        training: units of the training runs.
        folds: the runs that are predicted.
        level: (U,) variance that the richest model leaves, at least the noise.
        independent: (U,) independent samples in it.
        imitable: (c,) nats that may be gained at most, in each channel that was measured, from what the richest model
            leaves beyond the noise.
        limited: share of what it leaves that is more than noise, the mean over channels: 0 noise-limited, 1
            model-limited.
    """

    level: np.ndarray
    independent: np.ndarray
    imitable: np.ndarray
    limited: float

    def __init__(self, solver: Solver) -> None:
        self.solver, self.sums, self._always = solver, solver.sums, solver.always
        sums = self.sums
        self._typical = np.minimum(sums.problem.typical, sums.width)
        by_channel = (np.flatnonzero(sums.training & (sums.channel == i)) for i in range(len(sums.channels)))
        self._by_channel = [units for units in by_channel if len(units)]
        self.training = np.flatnonzero(sums.training)
        self._owner = np.array([-1 if c.run is None else c.run for c in sums.problem.columns])
        training = np.unique(sums.run[sums.training]).tolist()
        # Training runs stand in for held-out ones where none are given and there are several of them.
        others = [r for r in range(len(sums.runs)) if r not in training]
        runs = others or (training if len(training) > 1 else ())
        self.folds = tuple(
            Fold(run, np.flatnonzero(sums.run == run), np.flatnonzero(sums.training & (sums.run != run)))
            for run in runs
        )

    def measure(self, left: Mapping[int, np.ndarray], values: float) -> None:
        """Take levels and independent samples from the best model there is.

        Args:
            left: residual of every training unit there.
            values: numbers that the runs determine there; as many samples follow any noise.
        """
        samples = float(np.sum(self.sums.count[self.training]))
        error = np.zeros(len(self.sums.count))
        for unit, residual in left.items():
            error[unit] = np.mean(residual**2) * samples / max(samples - values, 0.5 * samples)
        self.level = self.sums.level(error)
        self.independent = self._independent_samples(left)
        self.imitable, self.limited = self._beyond_noise()
        self.solver.weigh(self.independent / (self.sums.count * self.level))

    def _independent_samples(self, left: Mapping[int, np.ndarray]) -> np.ndarray:
        """(U,) number of samples over their correlation time, from the residual of each training unit."""
        independent = self.sums.count.copy()
        for units in self._by_channel:
            times = [correlation_time([left[unit]]) for unit in units.tolist()]
            same = self.sums.channel == self.sums.channel[units[0]]
            independent[same] /= np.average(times, weights=self.sums.count[units])
        return independent

    def _beyond_noise(self) -> tuple[np.ndarray, float]:
        """`imitable` and `limited`: a shoulder whose torque is noisy hides nothing of what an elbow's shows."""
        noise = np.array(
            [np.sum(self.sums.noise[units] ** 2) / np.sum(self.level[units]) for units in self._by_channel]
        )
        samples = np.array([self.independent[units].sum() for units in self._by_channel])
        noise *= [noisy(count) for count in samples.tolist()]
        return 0.5 * samples * np.log(np.maximum(1.0 / noise, 1.0)), max(0.0, 1.0 - float(np.mean(noise)))

    def inside(self, one: Subset, change: np.ndarray, effective: np.ndarray) -> bool:
        """Whether no effect explains what it does by a value that the runs pull beyond a bound.

        A bound at which the effect is absent, and one from which they pull no more than by chance, is none.
        """
        p, C = self.sums.problem, one.columns
        value = self.sums.values[C] + change
        on = ((value <= p.lower[C]) | (value >= p.upper[C])) & (value != p.null[C]) & one.free & ~self._always[C]
        if not on.any():
            return True
        G, slope = self.solver.normal(self.training)
        pull = (slope[C] - G[C[:, None], C] @ effective)[on]
        return bool(np.all(0.5 * pull**2 / np.diag(G)[C[on]] < SURE))

    def log_likelihood(self, error: np.ndarray) -> np.ndarray:
        """(c,) of each channel, of training units with (t,) mean squared errors, with a variance of the model's own."""
        s = self.sums
        ratio = np.zeros(len(s.count))
        ratio[self.training] = error / s.noise[self.training] ** 2
        mean = np.array([np.average(ratio[units], weights=s.count[units]) for units in self._by_channel])
        samples = np.array([self.independent[units].sum() for units in self._by_channel])
        return -0.5 * samples * misfit_of(mean)

    def freedom(self, columns: np.ndarray, change: np.ndarray, units: np.ndarray) -> tuple[float, float]:
        """Nats that the freedom of a set's own unknowns costs in units (u,), and how many of them these determine."""
        p, own = self.sums.problem, ~self._always[columns]
        C = columns[own]
        d = (self.sums.values[columns] + change)[own] - np.where(p.prior_weight > 0, p.prior_mean, p.null)[C]
        if len(C) == 0:
            return 0.0, 0.0
        T = self._typical[C]
        A = T[:, None] * self.solver.normal(units)[0][C[:, None], C] * T
        A.flat[:: len(C) + 1] += 1.0
        factor, _ = dpotrf(A, lower=1, clean=1)
        inverse, _ = dtrtri(factor, lower=1)
        values = len(C) - float(np.sum(inverse**2))
        return float(np.sum(np.log(np.diag(factor))) + np.sum(np.log1p((d / T) ** 2))), values

    def against_priors(self, columns: np.ndarray, change: np.ndarray) -> float:
        """Nats by which unknowns of every set contradict what was measured of them by hand."""
        p, value = self.sums.problem, self.sums.values[columns] + change
        off = (p.prior_weight[columns] * (value - p.prior_mean[columns]))[self._always[columns]]
        return 0.5 * float(off @ off)

    def predicted(self, one: Subset, change: np.ndarray, whole: float, fold: Fold) -> tuple[np.ndarray, float]:
        """(u,) mean squared error of a run, predicted by a fit to the other training runs; its own unknowns fit it.

        Beside it, how many times it counts. An effect that has values of its own in that run is no better for being
        fitted to it: the error counts as larger by their Occam factor. Where only noise is left, the part of it that is
        no more than what the others leave uncertain does not count: what a run adds to the cost of the others is
        r' (1 + J S J')^-1 r, with r the prediction's error and S the covariance of what the others say.
        """
        near, effective = self.solver.minimum(one, fold.others, change)
        before = self.solver.cost(one, near, effective, fold.others)
        own = one.free & (self._owner[one.columns] == fold.run)
        freedom = 0.0
        if own.any():
            effective = self.solver.linear(one.columns, own, fold.units, effective)
            freedom, _ = self.freedom(one.columns[own], effective[own], fold.units)
        error = self.sums.errors(one.columns, effective, fold.units)
        occam = float(np.exp(self.limited * 2.0 * freedom / np.sum(self.independent[fold.units])))
        total = float(self.solver.weight[fold.units] * self.sums.count[fold.units] @ error)
        if not self.sums.training[fold.units].any() or total == 0.0:
            return error, occam
        certain = float(np.clip((whole - before) / total, 0.0, 1.0))
        return error, occam * (self.limited + (1.0 - self.limited) * certain)


def misfit_of(ratio: np.ndarray) -> np.ndarray:
    """-2 log likelihood per sample at the best variance of the model's own error, of squared error over noise."""
    return np.where(ratio < 1.0, ratio - 1.0, np.log(np.maximum(ratio, 1.0)))
