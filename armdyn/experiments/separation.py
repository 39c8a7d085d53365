r"""Separation of two hypotheses in an experiment, if the rival is refitted to it.

With d the difference of the predicted readings over their noise, J the rival's derivatives and L the information on its
unknowns from earlier runs and priors,

    lambda = min_delta |d - J delta|^2 + delta' L delta = d' (1 + J L^-1 J')^-1 d

is the rise of chi2, earlier runs included, with which the rival explains noise-free data of the other. With measured
data it varies: for a true hypothesis H and a rival R

    chi2_R - chi2_H = |d + J_H z + e|^2_R - |J_H z + e|^2_H,      |.|^2_X = .' (1 + J_X L_X^-1 J_X')^-1 .

with the noise e and the error z of H's values; without z it is close to N(lambda, 4 lambda). H is named where this
rise, with that of earlier runs, exceeds the margin of the diagnosis for every rival. (Atkinson & Fedorov, Biometrika
62, 1975: T-optimal designs; Box & Hill, Technometrics 9, 1967.)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.estimation.descent import DescentSettings, descend
from armdyn.estimation.expansion import QuadraticExpansion
from armdyn.estimation.solve import solve_bounded
from armdyn.experiments.hypothesis import Hypothesis, PlannedExperiment, PredictedExperiment
from armdyn.identify.settings import DEFAULT_SETTINGS

TIE_CHI2 = 2.0 * DEFAULT_SETTINGS.search.tie_nats
"""Difference of chi2 up to which a diagnosis does not distinguish two effects, if the residual is only noise."""
DRAWN_OUTCOMES = 400
"""Number of outcomes of an experiment that are drawn to estimate the probability of a right verdict."""
ADDED_INFORMATION_SHARE = 1e-9
"""Share of its own size that is added to the information on an unknown, so that an unidentifiable unknown keeps its
value."""
MAX_REFIT_STEPS = 12
"""Largest number of steps in the refit of a rival hypothesis."""


class RivalRefitCost:
    """A hypothesis that is fitted to predicted readings of another one: the cost function of this fit."""

    def __init__(self, predicted: PredictedExperiment, readings: np.ndarray) -> None:
        self.predicted, self._readings = predicted, readings
        self.lower, self.upper = predicted.lower, predicted.upper
        self._last: tuple[bytes, QuadraticExpansion] | None = None

    def value(self, values: np.ndarray, limit: float) -> float:
        """Half the rise of chi2 at (m,) values of the rival's unknowns."""
        del limit
        return self.expand(values).cost

    def expand(self, values: np.ndarray) -> QuadraticExpansion:
        """Half the rise of chi2 at (m,) values of the rival's unknowns, with gradient and Gauss-Newton Hessian."""
        if self._last is None or self._last[0] != values.tobytes():
            self._last = values.tobytes(), self._expansion(values)
        return self._last[1]

    def _expansion(self, values: np.ndarray) -> QuadraticExpansion:
        away, prior = values - self.predicted.start, self.predicted.prior
        with np.errstate(all="ignore"):
            readings, slopes = self.predicted.predict(values)
            rest = self._readings - readings
            cost = 0.5 * float(rest @ rest + away @ prior @ away)
        if not np.isfinite(cost):
            return QuadraticExpansion.diverged(len(values))
        return QuadraticExpansion(cost, prior @ away - slopes.T @ rest, slopes.T @ slopes + prior)

    def chi2_increase_and_refit(
        self, start: np.ndarray | None = None, steps: int = MAX_REFIT_STEPS
    ) -> tuple[float, np.ndarray]:
        """Fit the rival; return the rise of chi2 at its best values, and these (m,) values."""
        found = descend(self, self.predicted.start if start is None else start, DescentSettings(steps, 0.02))
        return 2.0 * found.expansion.cost, found.values


def linear_separation(truth: PredictedExperiment, rival: PredictedExperiment) -> float:
    """Rise of chi2 if the rival is refitted to the true hypothesis, by one linearisation at the rival's values."""
    difference = truth.predict(truth.start)[0] - rival.predict(rival.start)[0]
    return float(_rise(rival, rival.start, difference[:, None])[0])


@dataclass(frozen=True, eq=False)
class ExpectedOutcome:
    """Expected result of an experiment with h hypotheses.

    Attributes:
        chi2_increase: (h, h) rise of chi2 if hypothesis i is true and hypothesis j is refitted; 0 on the diagonal.
        correct_decision_probability: (h,) probability that each hypothesis, if true, is the only plausible one
            afterwards.
        prior_probability: (h,) probability of each hypothesis before the experiment.
    """

    chi2_increase: np.ndarray
    correct_decision_probability: np.ndarray
    prior_probability: np.ndarray

    @property
    def separation(self) -> float:
        """Separation of the two hypotheses that are hardest to distinguish, in standard deviations."""
        apart = self.chi2_increase[~np.eye(len(self.chi2_increase), dtype=bool)]
        return float(np.sqrt(max(apart.min(), 0.0))) if len(apart) else 0.0

    @property
    def probability(self) -> float:
        """Probability of a unique right verdict, averaged over the hypotheses."""
        return float(self.prior_probability @ self.correct_decision_probability)


def hypothesis_probabilities(hypotheses: Sequence[Hypothesis]) -> np.ndarray:
    """(h,) probability of each hypothesis, from its fit to the runs so far."""
    misfit = np.array([h.misfit for h in hypotheses])
    weight = np.exp(-0.5 * (misfit - misfit.min()))
    return np.asarray(weight / weight.sum())


def expected_outcome(hypotheses: Sequence[Hypothesis], experiment: PlannedExperiment, seed: int = 0) -> ExpectedOutcome:
    """Predict the result of an experiment, by nonlinear refits of every rival and random outcomes."""
    predicted = [PredictedExperiment(h, experiment) for h in hypotheses]
    count = len(predicted)
    rises, right = np.zeros((count, count)), np.ones(count)
    rng = np.random.default_rng(seed)
    for i, truth in enumerate(predicted):
        readings, slopes = truth.predict(truth.start)
        noise = rng.standard_normal((len(readings), DRAWN_OUTCOMES))
        errors = truth.start[:, None] + truth.covariance_root @ rng.standard_normal((len(truth.start), DRAWN_OUTCOMES))
        errors = np.clip(errors, truth.lower[:, None], truth.upper[:, None]) - truth.start[:, None]
        off = noise + slopes @ errors
        own = _rise(truth, truth.start, off)
        wins = np.ones(DRAWN_OUTCOMES, dtype=bool)
        for j, rival in enumerate(predicted):
            if i == j:
                continue
            rises[i, j], best = RivalRefitCost(rival, readings).chi2_increase_and_refit()
            other = _rise(rival, best, (readings - rival.predict(best)[0])[:, None] + off)
            earlier = hypotheses[j].misfit - hypotheses[i].misfit
            wins &= other - own + earlier > TIE_CHI2
        right[i] = float(np.mean(wins))
    return ExpectedOutcome(rises, right, hypothesis_probabilities(hypotheses))


def _rise(rival: PredictedExperiment, values: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """(r,) rise of chi2 for (n, r) readings minus predictions, linearised at (m,) values of the rival's unknowns.

    It is min_delta |r - J delta|^2 + (a + delta)' L (a + delta), with a the distance of the values from the prior,
    within the bounds of the unknowns: friction does not become negative.
    """
    slopes = rival.predict(values)[1] * rival.typical
    prior = rival.prior * np.outer(rival.typical, rival.typical)
    away, lower, upper = ((x - values) / rival.typical for x in (rival.start, rival.lower, rival.upper))
    normal = slopes.T @ slopes + prior
    normal.flat[:: len(normal) + 1] *= 1.0 + ADDED_INFORMATION_SHARE
    normal.flat[:: len(normal) + 1] += np.finfo(float).tiny
    pull = (slopes.T @ rest).T + prior @ away  # (r, m)
    change = solve_bounded(normal, pull, lower, upper).x
    explained = np.sum((2.0 * pull - change @ normal) * change, axis=1)
    return np.asarray(np.sum(rest**2, axis=0) + away @ prior @ away - explained)
