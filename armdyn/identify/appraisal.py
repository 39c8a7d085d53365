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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log

import numpy as np

from armdyn.identify.noise import correlation_time
from armdyn.identify.score import Candidate
from armdyn.identify.sums import Sums

SURE = log(100.0)
"""Nats beyond chance at which an effect is believed: one false name in a hundred clean recordings."""
RELATIVE = 0.01
"""Share by which each value must lower the error of the other runs' predictions, where the model's own error is all that
is left: less is imitation of that error."""
HARM = 0.02
"""Share by which an effect may make the total error of a predicted run larger."""
REFINEMENTS = 6
"""Rounds in which unknowns that leave their bounds are put on them."""
LEVELS = 4
"""Rounds in which the richest model's fit and the error that it leaves, which weighs it, settle."""


@dataclass(frozen=True, eq=False)
class Appraisal:
    """What one set of effects is worth.

    Attributes:
        effects: of the set, each on one joint.
        worth: nats; compare with that of other sets for the same runs.
        fit: log evidence of the training runs.
        transfer: log likelihood of runs as predicted from the others; 0 where there is nothing to predict.
        price: nats.
        columns: (c,) the unknowns that are free.
        change: (c,) their change from the expansion's point in a fit to all training runs.
        predicted: (u,) mean squared error of the predicted units.
        totals: (r, k) error of every predicted run over its channels of each unit, root of the sum of squares.
    """

    effects: tuple[Candidate, ...]
    worth: float
    fit: float
    transfer: float
    price: float
    columns: np.ndarray
    change: np.ndarray
    predicted: np.ndarray
    totals: np.ndarray

    def carries_over(self, before: "Appraisal") -> bool:
        """Whether other runs, where there are any, are predicted better than `before`, and none of them worse."""
        if len(self.predicted) == 0:
            return True
        harmed = bool(np.any(self.totals > (1.0 + HARM) * before.totals))
        return self.transfer > before.transfer and not harmed


class Appraiser:
    """Appraises sets of effects by sums.

    Args:
        sums: of training runs and of runs that are only predicted.
        always: (P,) bool, unknowns that are free in every set.
        candidates: all effects that a set may hold, each on one joint.
    """

    def __init__(self, sums: Sums, always: np.ndarray, candidates: Sequence[Candidate]) -> None:
        self.sums = sums
        self.candidates = tuple(candidates)
        self._always = np.flatnonzero(always)
        self._columns = {c: np.flatnonzero(sums.problem.of(c.names)) for c in candidates}
        self._owner = np.array([-1 if c.run is None else c.run for c in sums.problem.columns])
        training = tuple(np.flatnonzero(np.isin(np.arange(len(sums.runs)), sums.run[sums.training])))
        # With a single training run there are no others to predict it from.
        self.predicted_runs = tuple(
            r for r in range(len(sums.runs)) if r not in training or len(training) > 1
        )
        self._units = [(run, np.flatnonzero(sums.run == run)) for run in self.predicted_runs]
        measured = [
            next(r.channels[c].unit for r in sums.problem.runs if c in r.channels) for c in sums.channels
        ]
        self._kinds = np.array([sorted(set(measured)).index(unit) for unit in measured])
        self._known: dict[frozenset[Candidate], Appraisal] = {}
        self._weight = np.ones(len(sums.count))
        self.level, self.independent = self._levels()
        self._weight = self.independent / (sums.count * self.level)

    def of(self, effects: Iterable[Candidate]) -> Appraisal:
        """The appraisal of one set."""
        key = frozenset(effects)
        if key not in self._known:
            self._known[key] = self._appraised(tuple(c for c in self.candidates if c in key))
        return self._known[key]

    def price(self, effects: Sequence[Candidate], values: float) -> float:
        """What a set must gain over no effect at all, nats.

        Each effect could have been another one of the catalogue, each of its joints another joint, and is to be sure
        beyond that; each value must besides lower the model's own error by `RELATIVE`.

        Args:
            effects: of the set.
            values: number of its unknowns that the runs determine rather than their priors.
        """
        names = {c.effect for c in self.candidates}
        total = 0.0
        for name in {c.effect for c in effects}:
            reach = sum(c.effect == name for c in self.candidates)
            joints = sum(c.effect == name for c in effects)
            total += log(len(names)) + joints * (log(reach) + SURE)
        return total + RELATIVE * values * self._limited

    def foretold(self, now: Appraisal, others: Sequence[Candidate]) -> np.ndarray:
        """(k,) fall of the weighted squared error of the training runs that each of k effects promises beside a set."""
        G, slope = self._normal(self.sums.training)
        width = self.sums.width
        C = now.columns
        scaled = np.linalg.solve(G[np.ix_(C, C)] + np.diag(width[C] ** -2.0), np.column_stack([G[C], slope[C]]))
        left, rest = G - G[:, C] @ scaled[:, :-1], slope - G[:, C] @ scaled[:, -1]
        gains = np.empty(len(others))
        for i, candidate in enumerate(others):
            own = self._columns[candidate]
            own = own[~np.isin(own, C)]
            S = left[np.ix_(own, own)] + np.diag(width[own] ** -2.0)
            gains[i] = rest[own] @ np.linalg.solve(S, rest[own]) if len(own) else 0.0
        return gains

    @cached_property
    def _limited(self) -> float:
        """Independent samples of predicted runs times the share of what is left that is the model's own error."""
        s = self.sums
        share = 1.0 - s.noise**2 / self.level
        units = np.isin(s.run, self.predicted_runs) if self.predicted_runs else s.training
        return float(np.sum((self.independent * share)[units]))

    def _levels(self) -> tuple[np.ndarray, np.ndarray]:
        """(U,) variance that the richest model leaves, at least the noise, and (U,) independent samples."""
        s = self.sums
        every = self._of(self.candidates)
        level = s.noise**2
        for _ in range(LEVELS):
            self._weight = 1.0 / level
            change = self._solved(every, s.training)
            error = s.errors(every, change, np.arange(len(s.count)))
            for channel in range(len(s.channels)):
                units = s.channel == channel
                known = units & s.training
                if known.any():
                    left = float(np.average(error[known], weights=s.count[known]))
                    level = np.where(units, np.maximum(s.noise**2, left), level)
        independent = s.count.copy()
        for channel in range(len(s.channels)):
            units = np.flatnonzero(s.channel == channel)
            known = [u for u in units if s.training[u]]
            times = [correlation_time(s.residual(u, every, change)) for u in known]
            if times:
                independent[units] /= np.average(times, weights=s.count[known])
        return level, independent

    def _appraised(self, effects: tuple[Candidate, ...]) -> Appraisal:
        s = self.sums
        columns = self._of(effects)
        change = self._solved(columns, s.training)
        fit = self._log_likelihood(s.errors(columns, change, np.arange(len(s.count))), s.training)
        occam, values = self._freedom(columns, change)
        fit -= occam
        errors = [self._predicted(columns, run, units) for run, units in self._units]
        parts = [
            float(np.sum(self.independent[units] * _misfit(e / s.noise[units] ** 2)))
            for e, (_, units) in zip(errors, self._units, strict=True)
        ]
        transfer, price = -0.5 * sum(parts), self.price(effects, values)
        worth = fit + transfer - price if self._inside(columns, change) else -np.inf
        totals = np.array([self._totals(e, units) for e, (_, units) in zip(errors, self._units, strict=True)])
        predicted = np.concatenate(errors) if errors else np.zeros(0)
        return Appraisal(effects, worth, fit, transfer, price, columns, change, predicted, totals)

    def _totals(self, errors: np.ndarray, units: np.ndarray) -> np.ndarray:
        """(k,) root of the summed mean squared errors over the channels of each unit of measurement, at least noise."""
        floored = np.maximum(errors, self.sums.noise[units] ** 2)
        kinds = self._kinds[self.sums.channel[units]]
        return np.sqrt(np.bincount(kinds, weights=floored, minlength=int(self._kinds.max()) + 1))

    def _inside(self, columns: np.ndarray, change: np.ndarray) -> bool:
        """Whether no effect explains what it does by a value on a bound other than that of its absence."""
        p = self.sums.problem
        value = self.sums.values[columns] + change
        on = ((value <= p.lower[columns]) | (value >= p.upper[columns])) & (value != p.null[columns])
        return not np.any(on & ~np.isin(columns, self._always))

    def _of(self, effects: Iterable[Candidate]) -> np.ndarray:
        parts = [self._always, *(self._columns[c] for c in effects)]
        return np.unique(np.concatenate(parts)).astype(int)

    def _log_likelihood(self, error: np.ndarray, units: np.ndarray) -> float:
        """Of (U,) mean squared errors, with one variance of the model's own error for each channel."""
        s, total = self.sums, 0.0
        for channel in range(len(s.channels)):
            chosen = units & (s.channel == channel)
            if chosen.any():
                ratio = float(np.average((error / s.noise**2)[chosen], weights=s.count[chosen]))
                total -= 0.5 * float(np.sum(self.independent[chosen])) * float(_misfit(np.array(ratio)))
        return total

    def _freedom(self, columns: np.ndarray, change: np.ndarray) -> tuple[float, float]:
        """Nats that the freedom of a set's own unknowns costs, and how many of them the runs determine."""
        own = ~np.isin(columns, self._always)
        C, d = columns[own], (change - self.sums.centre[columns])[own]
        if len(C) == 0:
            return 0.0, 0.0
        T = np.minimum(self.sums.problem.typical[C], self.sums.width[C])
        A = np.eye(len(C)) + T[:, None] * self._normal(self.sums.training)[0][np.ix_(C, C)] * T
        values = float(np.sum(1.0 - np.diag(np.linalg.inv(A))))
        return float(np.linalg.slogdet(A)[1] / 2 + np.sum(np.log1p((d / T) ** 2))), values

    def _normal(self, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, P) weighted sum of X'X and (P,) of X'r over units, (U,) bool."""
        key = units.tobytes() + self._weight.tobytes()
        if key not in self._normals:
            w = self._weight[units]
            self._normals[key] = np.tensordot(w, self.sums.gram[units], 1), w @ self.sums.slope[units]
        return self._normals[key]

    @cached_property
    def _normals(self) -> dict[bytes, tuple[np.ndarray, np.ndarray]]:
        return {}

    def _predicted(self, columns: np.ndarray, run: int, units: np.ndarray) -> np.ndarray:
        """(u,) mean squared error of a run's units, fitted to the other training runs; what is its own is fitted to it."""
        s = self.sums
        change = self._solved(columns, s.training & (s.run != run))
        own = self._owner[columns] == run
        if own.any():
            others = np.where(own, 0.0, change)
            change = others + self._solved(columns, s.run == run, own, others)
        return s.errors(columns, change, units)

    def _solved(
        self, columns: np.ndarray, units: np.ndarray, free: np.ndarray | None = None, others: np.ndarray | None = None
    ) -> np.ndarray:
        """(c,) change of the unknowns that fits units best, within their bounds; those not `free` stay at `others`."""
        s, p = self.sums, self.sums.problem
        G, slope = self._normal(units)
        G, slope = G[np.ix_(columns, columns)], slope[columns]
        width, centre = s.width[columns], s.centre[columns]
        lower, upper = (p.lower - s.values)[columns], (p.upper - s.values)[columns]
        moving = np.ones(len(columns), dtype=bool) if free is None else free.copy()
        change = np.zeros(len(columns)) if others is None else others.copy()
        for _ in range(REFINEMENTS):
            i = np.flatnonzero(moving)
            if len(i) == 0:
                break
            t = width[i]
            right = slope[i] - G[np.ix_(i, ~moving)] @ change[~moving]
            A = t[:, None] * G[np.ix_(i, i)] * t + np.eye(len(i))
            change[i] = t * np.linalg.solve(A, t * right + centre[i] / t)
            outside = moving & ((change < lower) | (change > upper))
            if not outside.any():
                break
            change[outside] = np.clip(change, lower, upper)[outside]
            moving &= ~outside
        return np.where(moving, np.clip(change, lower, upper), change) if others is None else np.where(moving, change, 0.0)


def _misfit(ratio: np.ndarray) -> np.ndarray:
    """-2 log likelihood per sample at the best variance of the model's own error, of squared error over noise."""
    return np.where(ratio < 1.0, ratio - 1.0, np.log(np.maximum(ratio, 1.0)))
