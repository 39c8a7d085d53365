"""Score sets of effects of a model that is linear around one fit, such as an arm's; see `linear_predictor`."""

from collections.abc import Iterable, Sequence
from math import log

import numpy as np

from armdyn.estimation.posterior import freedom_nats, size_nats, wald_distance
from armdyn.estimation.solve import inverse_positive, solve_positive
from armdyn.identify.fit import Fit
from armdyn.identify.problem import transfer_values
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.linear_predictor import HELD_OUT_ROW, LinearPredictor
from armdyn.identify.selection.set_score import EffectSetScore

SCORED_REMOVALS = 4
"""Number of removals from a set, those with the least predicted loss, whose score is computed in each round."""


class LinearScorer(LinearPredictor):
    """Scores sets of effects with one linearisation of the model; see `LinearPredictor` for its arguments."""

    max_ranked_effects = 8

    def predicts_to_the_noise(self, effects: Sequence[Candidate]) -> bool:
        """Whether the error of predicted runs with a set is only noise, so that no other set can predict better."""
        errors = self.prediction_errors(self.prior_widths(effects, 0.0))
        limit, count = self.settings.noise.max_variance_ratio, self._stages.count.reshape(2, -1)
        return bool(np.all(errors <= self._noise * np.array([[limit(n) for n in row] for row in count])))

    def _score_of(self, effects: tuple[Candidate, ...]) -> EffectSetScore:
        widths = self.prior_widths(effects, 0.0)
        change = self.best_change(widths, self.training)
        errors, own = self.mean_squared_errors(change), self._of(effects)
        information, unit = self._normal(self.training)[0][np.ix_(own, own)], np.ones(len(own))
        predicted = np.array([self.leave_one_out_errors(widths), errors[HELD_OUT_ROW]]) if self._leaves_out else errors
        likelihood, held_out_log_likelihood = self._log_likelihoods(errors).tolist()
        freedom = self._freedom_nats(own) + float(size_nats((change - self._null)[own]))
        worth = self.log_likelihood(predicted) - self.complexity_penalty(effects) - float(self._unnamed_nats(change))
        return EffectSetScore(
            effects=effects,
            score=worth if self._is_inside(widths, change, own) else -np.inf,
            likelihood=likelihood,
            held_out_log_likelihood=held_out_log_likelihood,
            occam_penalty_nats=freedom,
            effective_parameter_count=len(own) - float(np.trace(inverse_positive(information + np.diag(unit)))),
            columns=self.columns,
            change=change * self.typical,
            misfit=float(self._misfit(errors)),
        )

    def _freedom_nats(self, own: np.ndarray) -> float:
        """Nats that the freedom of the unknowns (k,) `own` costs, beside that of the values that every set has."""
        unnamed = np.setdiff1d(np.flatnonzero(self._unnamed), own)
        return self._freedom_of(own, unnamed) - self._freedom_of(own[:0], unnamed)

    def _freedom_of(self, own: np.ndarray, unnamed: np.ndarray) -> float:
        """Nats that the freedom of the unknowns (k,) `own` and of those without a name, (m,) `unnamed`, costs."""
        both, sizes = np.append(own, unnamed), np.append(np.ones(len(own)), self._unnamed[unnamed])
        return float(freedom_nats(self._normal(self.training)[0][np.ix_(both, both)], sizes))

    def evidence(self, at: Fit, errors: np.ndarray, effects: Sequence[Candidate], *, described: bool = False) -> float:
        """Log evidence, nats, of a fitted set with this scorer's weights, less its complexity.

        Args:
            at: the fit.
            errors: (2, c) its mean squared errors; see `mean_squared_errors_of`.
            effects: the set.
            described: whether the values that every set has without a name are as described; else they were fitted.
        """
        own, values = self._of(effects), transfer_values(at.values, at.problem, self.problem)[self.columns]
        unnamed = np.zeros(0, dtype=int) if described else np.setdiff1d(np.flatnonzero(self._unnamed), own)
        sizes = (values - self.problem.null[self.columns])[own] / self.typical[own]
        price = self._freedom_of(own, unnamed) + float(size_nats(sizes)) + self.complexity_penalty(effects)
        return self.log_likelihood(errors) - price - (0.0 if described else self.unnamed_nats(at))

    def _misfit(self, errors: np.ndarray) -> np.ndarray:
        """(...) misfit as in `EffectSetScore.misfit`, from (..., 2, c) mean squared errors."""
        return np.asarray(np.sum(self._importance * np.maximum(errors, self._floor), axis=(-2, -1)))

    @property
    def _floor(self) -> np.ndarray:
        """(2, c) least mean squared error: that of the noise, where there are samples."""
        return self._noise * (self._samples > 0.0)

    def _is_inside(self, widths: np.ndarray, change: np.ndarray, own: np.ndarray) -> bool:
        """Whether no effect relies on a value that the runs pull beyond its bound.

        A bound at which the effect is absent, and one that they do not pull beyond by more than chance, do not count.
        """
        on_bound = (change <= self._lower) | (change >= self._upper)
        if not np.any((on_bound & (change != self._null))[own]):
            return True
        beyond = np.zeros(len(widths))
        beyond[widths > 0.0] = self._posterior(widths, self.training).gain_beyond_bound_nats
        return bool(np.all((beyond < self.settings.search.acceptance_nats)[own] | (change == self._null)[own]))

    def approximate_addition_scores(self, now: EffectSetScore, options: Sequence[Sequence[Candidate]]) -> np.ndarray:
        """(k,) approximate scores of a set with each of k additions, without full solutions, to find promising ones.

        They are those of the fitted runs, less what freedom costs in evidence (MacKay, Neural Computation 4, 1992).
        """
        errors, freedom, unnamed = self._first_order(now, options)
        prices = self.complexity_penalties(now.effects, options)
        return self._log_likelihoods(errors).sum(axis=-1) - now.occam_penalty_nats - freedom - prices - unnamed

    def _first_order(
        self, now: EffectSetScore, options: Sequence[Sequence[Candidate]]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(k, 2, c) predicted mean squared errors of a set with each of k additions, (k,) nats of their freedom.

        The last result are (k,) nats of the values that every set has; see `unnamed_nats`.

        The unknowns of the set adapt linearly; only those of the addition respect their bounds.
        """
        widths, x = self.prior_widths(now.effects, 0.0), now.change / self.typical
        c = np.flatnonzero(widths > 0.0)
        G, slope = self._normal(self.training)
        left = slope - G @ x
        response = -inverse_positive(G[np.ix_(c, c)] + np.diag(widths[c] ** -2.0)) @ G[c]
        S = G + G[:, c] @ response
        moved, freedom = np.zeros((len(widths), len(options))), np.zeros(len(options))
        added = [own[widths[own] == 0.0] for own in map(self._of, options)]
        for size in {len(own) for own in added}:
            same = np.array([i for i, own in enumerate(added) if len(own) == size])
            own = np.array([added[i] for i in same]).reshape(len(same), size)
            A = S[own[:, :, None], own[:, None, :]] + np.eye(size)
            d = np.clip(solve_positive(A, left[own]), (self._lower - x)[own], (self._upper - x)[own])
            moved[own, same[:, None]] = d
            moved[np.ix_(c, same)] = np.einsum("cmi,mi->cm", response[:, own], d)
            freedom[same] = freedom_nats(A - np.eye(size), np.ones(size)) + size_nats(d)
        changed = x[:, None] + moved
        errors = self._stages.squared_errors(changed) / np.maximum(self._stages.count, 1.0)[:, None]
        return errors.T.reshape(len(options), 2, -1), freedom, self._unnamed_nats(changed)

    def set_with_next_reported_effect(
        self, now: EffectSetScore, options: Sequence[Sequence[Candidate]]
    ) -> EffectSetScore:
        """Of the sets with one of the options added, the one that leaves the least squared error."""
        return self.evaluate((*now.effects, *min(options, key=lambda one: self._misfit_with((*now.effects, *one)))))

    def leading_effects(self, now: EffectSetScore, effects: Sequence[Candidate]) -> list[Candidate]:
        """Effects on single joints that each remove the leading share of the squared error, added one by one.

        They are added in the order of backward elimination by the error that each value removes, as in an F test, the
        last one first: an effect that imitates two others explains most where it is added alone, but is hardly needed
        beside them.
        """
        order, left, error = list[Candidate](), list(effects), self._misfit_with((*now.effects, *effects))
        while left:
            distances = self.wald_distances(self.prior_widths((*now.effects, *left), 0.0), [(c,) for c in left])
            cheap = [c for _, c in sorted(zip(distances, left, strict=True), key=lambda one: one[0])[:SCORED_REMOVALS]]
            errors = {c: self._misfit_with((*now.effects, *(other for other in left if other is not c))) for c in cheap}
            gone = min(cheap, key=lambda c: (errors[c] - error) / len(c.names))
            error = errors[gone]
            order.insert(0, gone)
            left.remove(gone)
        found, error = list[Candidate](), now.misfit
        for one in order:
            before, error = error, self._misfit_with((*now.effects, *found, one))
            if before - error < self.settings.search.leading_share * now.misfit:
                break
            found.append(one)
        return found

    def _misfit_with(self, effects: Iterable[Candidate]) -> float:
        """Squared error of a set, see `EffectSetScore.misfit`, without its score."""
        change = self.best_change(self.prior_widths(effects, 0.0), self.training)
        return float(self._misfit(self.mean_squared_errors(change)))

    def wald_distances(self, widths: np.ndarray, parts: Iterable[Sequence[Candidate]]) -> list[float]:
        """Distance of the values of some effects together from nothing, in standard deviations; see `wald_distance`.

        Args:
            widths: (c,) prior widths of the unknowns.
            parts: effects, for each distance.
        """
        change, covariance = self._fitted_change(widths)
        return [wald_distance(change[own], covariance[np.ix_(own, own)]) for own in map(self._of, parts)]

    def _fitted_change(self, widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(c,) change of the unknowns from null in a fit with (c,) prior widths, and (c, c) its covariance."""
        found, c = self._posterior(widths, self.training), np.flatnonzero(widths > 0.0)
        change, covariance = self._absent.copy(), np.zeros((len(widths), len(widths)))
        change[c], covariance[np.ix_(c, c)] = found.change, found.covariance
        return change - self._null, covariance

    def effects_without_sure_value(self, effects: Iterable[Candidate], width: float, least: float) -> list[Candidate]:
        """Those of a set's effects of which no value alone is sure; for the arguments see `unsure_values`."""
        change, covariance = self._fitted_change(self.prior_widths(effects, width))
        size = np.abs(change) / np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        return [c for c in effects if c not in self.given and np.all(size[self.positions[c]] <= least)]

    def unsure_values(self, effects: Sequence[Candidate], width: float, least: float) -> list[str]:
        """Names of the values that have to stay at null, so that the runs are sure of a value of every effect of a set.

        They are all values of an effect, if none is sure with the others at null.

        Args:
            effects: effects of the set.
            width: prior width of all other effects.
            least: size of a sure value in its standard deviations.
        """
        change, covariance = self._fitted_change(self.prior_widths(effects, width))
        held = list[int]()
        for one in self.effects_without_sure_value(effects, width, least):
            left = [k for k in self.positions[one].tolist() if covariance[k, k] > 0.0]
            while left:
                distances = np.abs(change[left]) / np.sqrt(np.diag(covariance)[left])
                if distances.min() > least:
                    break
                k = left.pop(int(distances.argmin()))
                gain = covariance[:, k] / covariance[k, k]
                change, covariance = change - gain * change[k], covariance - np.outer(gain, covariance[k])
                held.append(k)
        return [self.problem.columns[self.columns[k]].parameter.name for k in held]

    def promising_removals(
        self, now: EffectSetScore, parts: Sequence[tuple[Candidate, ...]]
    ) -> list[tuple[Candidate, ...]]:
        """Parts of a set without which it loses least likelihood, less what their absence saves, the best first.

        They are all parts of a set that relies on a value beyond its bound: any one may be the cause.
        """
        if not np.isfinite(now.score):
            return list(parts)
        distances = self.wald_distances(self.prior_widths(now.effects, 0.0), parts)
        prices = [self.complexity_penalty([c for c in now.effects if c not in part]) for part in parts]
        losses = {part: 0.5 * d**2 + price for part, d, price in zip(parts, distances, prices, strict=True)}
        return sorted(parts, key=losses.__getitem__)[:SCORED_REMOVALS]

    def values(self, one: EffectSetScore) -> np.ndarray:
        """(P,) predicted values of all unknowns at a set's minimum; see `EffectSetScorer.values`."""
        return self.changed_values(one.change / self.typical)

    def values_part_way(self, one: EffectSetScore, share: float) -> np.ndarray:
        """(P,) values of all unknowns a share of the way to a set's predicted minimum, without other effects."""
        free = self.prior_widths(one.effects, 0.0) > 0.0
        return self.changed_values(np.where(free, share, 1.0) * one.change / self.typical)

    def changed_values(self, change: np.ndarray) -> np.ndarray:
        """(P,) values of all unknowns after a (c,) change of the scorer's unknowns, in typical sizes."""
        moved = change != 0.0
        return self.sums.changed(self.columns[moved], (change * self.typical)[moved])

    def schwarz_criterion_nats(self, one: EffectSetScore) -> float:
        """Score of a set in nats without the prior on sizes (Schwarz 1978), for comparing two sets."""
        return one.likelihood - 0.5 * one.effective_parameter_count * log(max(float(self._samples.sum()), 2.0))

    def rmse_by_channel(self, one: EffectSetScore) -> tuple[dict[str, float], dict[str, float]]:
        """Root mean square error by channel, of training runs and of runs predicted from others."""
        training, held_out = self.mean_squared_errors(one.change / self.typical)
        predicted = held_out if not self.sums.training.all() else np.zeros(0)
        if self.sums.training.all() and len(np.unique(self.sums.run)) > 1:
            predicted = self.leave_one_out_errors(self.prior_widths(one.effects, 0.0))
        return self._rms(training), self._rms(predicted)

    def _rms(self, errors: np.ndarray) -> dict[str, float]:
        return {name: float(np.sqrt(error)) for name, error in zip(self.sums.channels, errors, strict=False)}

    def fitted_values(self, one: EffectSetScore) -> tuple[np.ndarray, np.ndarray]:
        """(P,) values of a set, and their (P,) standard deviations, which include the model's own error.

        Standard deviations of unknowns that are not fitted are 0.
        """
        widths = self.prior_widths(one.effects, 0.0)
        deviations = np.zeros(len(self.sums.values))
        spread = np.sqrt(np.diag(self._posterior(widths, self.training).covariance))
        deviations[self.columns[widths > 0.0]] = self.typical[widths > 0.0] * spread
        return self.values(one), deviations
