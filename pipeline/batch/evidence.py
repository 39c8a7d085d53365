"""The evidence of one series for a step, for a slow drift, and for neither.

Three descriptions of the weighted values z = w y of a series compete, with u_k the unit step after recording k:

    constant: w,    drift: w, w t, perhaps w t^2,    change: any of these, and w u_k, or w (u_k - u_l) if it ends again.

The scatter about each of them is an AR(1) process: neighbouring recordings are alike, by the weather, or because kinds
of motion come in blocks. Its coefficient phi is not known, so each description has the phi that suits it best: what a
strong correlation of neighbours explains as well as a step is no evidence for a step. The evidence of p coefficients is

    -n/2 ln r - p/2 ln n + 1/2 ln(1 - phi^2) + ln P(phi),

with r the sum of squares that is left when z_i is replaced by z_i - phi z_i-1 (Prais and Winsten 1954; Schwarz 1978).
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from armdyn.recording.channels import FloatArray
from pipeline.batch.series import MIN_RECORDINGS_PER_SIDE_OF_STEP, ParameterSeries, medians_of_five

NEIGHBOUR_CORRELATIONS = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 0.95])
"""Values of phi, the correlation of neighbours, that are tried."""
DRIFT_COEFFICIENTS = (2, 3)
"""Numbers of coefficients of a drift: a straight line, and wear that grows or slows down, a parabola."""
MIN_PULSE_SHARE = 0.25
"""Least share of the recordings before, during and after a change that comes and goes.

Shorter ones cannot be told from kinds of motion that come in blocks.
"""
MAX_PULSE_PLACES = 40
"""Number of places at which such a change may begin or end; in longer series they are further apart."""
PRIOR_ITERATIONS = 200


@dataclass(frozen=True)
class _Description:
    """A constant or a drift, with the changes that may come on top, for one phi.

    Attributes:
        phi: correlation of neighbours.
        smooth: orthonormal basis of the constant or the drift, decorrelated, (n, p).
        log_volume: logarithm of the determinant of its coefficients' covariance, halved, with a minus sign.
        norms: norm of each step, (k,), and each pulse, (l,), after its components along `smooth` were removed.
    """

    phi: float
    smooth: FloatArray
    log_volume: float
    norms: FloatArray


@dataclass(frozen=True)
class Evidence:
    """Evidence from m series, in nats.

    Attributes:
        change_over_constant: the best change compared with a constant, (m,).
        change_over_drift: the best change compared with a drift, (m,).
        drift_over_constant: a drift compared with a constant, (m,).
        change: index of the best change in `SeriesEvidence.changes`, (m,).
    """

    change_over_constant: FloatArray
    change_over_drift: FloatArray
    drift_over_constant: FloatArray
    change: np.ndarray


class SeriesEvidence:
    """The descriptions of one series of n recordings.

    Attributes:
        weight: weights, inversely proportional to the standard deviations of the values, (n,).
        scores: weighted values without outliers, (n,).
        changes: indices of the first recordings of a change, (k + l, 2): k steps, which never end (n), and l pulses.
    """

    def __init__(self, series: ParameterSeries) -> None:
        scale = series.scale()
        self.weight = np.median(scale) / scale
        self._raw = self.weight * (series.value - np.median(series.value)) / np.median(scale)
        self._outliers = series.outliers()
        self.scores = self._cleaned(self._raw[None], self._outliers)[0]
        powers = self.weight * np.vander(series.centred_time, DRIFT_COEFFICIENTS[-1], increasing=True).T
        self._splits = series.splits()
        self._pulses = _pulse_places(self._splits, len(scale))
        ends = np.full(len(self._splits), len(scale))
        self.changes = np.concatenate([np.column_stack([self._splits, ends]), self._splits[self._pulses]])
        self._descriptions = [
            (count, i, self._describe(powers[:count], phi))
            for i, phi in enumerate(NEIGHBOUR_CORRELATIONS)
            for count in (1, *DRIFT_COEFFICIENTS)
        ]
        fits = {count: np.linalg.lstsq(powers[:count].T, self.scores, rcond=None)[0] for count in DRIFT_COEFFICIENTS}
        self._drifts = {count: powers[:count].T @ fit for count, fit in fits.items()}

    def _cleaned(self, scores: FloatArray, outliers: np.ndarray) -> FloatArray:
        """Scores (m, n) in which outliers, (m, n) or (n,) bool, have the median of five neighbouring recordings."""
        return np.where(outliers, self.weight * medians_of_five(scores / self.weight), scores)

    def _describe(self, columns: FloatArray, phi: float) -> _Description:
        smooth, triangle = np.linalg.qr(_decorrelated(columns, phi).T)
        along = _along_steps(smooth.T, self.weight, phi)[:, self._splits]
        later = _decorrelated(self.weight[None], phi)[0]
        beyond = _from_the_end(later[None] ** 2)[0] - later**2
        squares = (beyond + self.weight**2)[self._splits]
        first, last = self._pulses.T
        shared = (beyond + later * self.weight)[self._splits[last]]
        pulses = squares[first] + squares[last] - 2.0 * shared
        kept = np.concatenate(
            [
                squares - np.sum(along**2, axis=0),
                pulses - np.sum((along[:, first] - along[:, last]) ** 2, axis=0),
            ]
        )
        norms = np.sqrt(np.where(kept > 1e-6, kept, np.inf))  # for two groups of times, a step is a line
        return _Description(phi, smooth, -float(np.sum(np.log(np.abs(np.diag(triangle))))), norms)

    def _fit(self, scores: FloatArray, of: _Description) -> tuple[FloatArray, FloatArray, np.ndarray, FloatArray]:
        """Residuals (m, n) of a description, their squares (m,), the best change on top (m,) and what it explains."""
        own = _decorrelated(scores, of.phi)
        left = own - (own @ of.smooth) @ of.smooth.T
        steps = _along_steps(left, self.weight, of.phi)[:, self._splits]
        first, last = self._pulses.T
        along = np.concatenate([steps, steps[:, first] - steps[:, last]], axis=1) / of.norms
        best = np.argmax(np.abs(along), axis=1)
        return left, np.sum(left**2, axis=1), best, along[np.arange(len(along)), best]

    def evidence(self, scores: FloatArray, log_prior: FloatArray) -> Evidence:
        """Compare the descriptions of m series of scores (m, n); the prior is of `NEIGHBOUR_CORRELATIONS`."""
        count = scores.shape[1]
        without, changed = np.full((2, len(scores)), -np.inf), np.full(len(scores), -np.inf)
        change = np.zeros(len(scores), dtype=int)
        for coefficients, i, of in self._descriptions:
            _, squares, best, size = self._fit(scores, of)
            drifts, kept = int(coefficients > 1), np.maximum(squares - size**2, 1e-12 * squares)
            alone = log_prior[i] + _evidence(squares, coefficients, count, of.phi)
            without[drifts] = np.maximum(without[drifts], alone)
            here = log_prior[i] + _evidence(kept, coefficients + 1, count, of.phi)
            change = np.where(here > changed, best, change)
            changed = np.maximum(changed, here)
        return Evidence(changed - without[0], changed - without[1], without[1] - without[0], change)

    def correlation_likelihood(self) -> FloatArray:
        """Log likelihood of each correlation of neighbours, (6,), under the description that fits best with it.

        The likelihood is that of the residuals (REML, Patterson and Thompson 1971), which is not biased towards small
        correlations by the coefficients that were fitted.
        """
        count, changes = len(self.scores), len(self.changes)
        likelihood = np.full(len(NEIGHBOUR_CORRELATIONS), -np.inf)
        for coefficients, i, of in self._descriptions:
            _, squares, best, size = self._fit(self.scores[None], of)
            apart, free = 0.5 * np.log(1.0 - of.phi**2) + of.log_volume, count - coefficients
            smooth = apart - 0.5 * free * np.log(squares[0] / free + 1e-300)
            kept = max(float(squares[0] - size[0] ** 2), 1e-12 * float(squares[0])) + 1e-300
            changed = apart - np.log(of.norms[best[0]] * changes) - 0.5 * (free - 1) * np.log(kept / (free - 1))
            likelihood[i] = max(likelihood[i], smooth, changed)
        return likelihood

    def permuted(self, log_prior: FloatArray, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Scores of scatter about a constant, and about the series' own drift: each (count, n).

        The decorrelated residuals of a constant and of the drift, outliers included, are put in another order and
        correlated again, with a correlation that is drawn from its probability given the series and the prior. Without
        a correlation they are the series itself in another order, and the chance is exact; with one, the best change is
        taken out of them, as no order of what decorrelation makes of a step has anything to do with scatter.
        """
        likelihood = self.correlation_likelihood() + log_prior
        shares = np.exp(likelihood - likelihood.max())
        drawn = rng.multinomial(count, shares / shares.sum())
        outlying, made = self._raw - self.scores, []
        for coefficients in (1, self._best_drift(log_prior)):
            scatter, outliers = [], []
            for phi, times in zip(NEIGHBOUR_CORRELATIONS, drawn, strict=True):
                of = next(of for n, _, of in self._descriptions if (n, of.phi) == (coefficients, phi))
                fitted, _, best, size = self._fit(self.scores[None], of)
                left = fitted[0] - size[0] * self._direction(int(best[0]), of) if phi > 0.0 else fitted[0]
                order = rng.permuted(np.tile(np.arange(len(left)), (times, 1)), axis=1)
                mixed = left[order]
                mixed[:, 0] /= np.sqrt(1.0 - phi**2)
                scatter.append(lfilter([1.0], [1.0, -phi], mixed, axis=1) + outlying[order])
                outliers.append(self._outliers[order])
            about = self._drifts.get(coefficients, 0.0)
            made.append(self._cleaned(np.vstack(scatter) + about, np.vstack(outliers)))
        return made[0], made[1]

    def _best_drift(self, log_prior: FloatArray) -> int:
        """Number of coefficients of the drift with the most evidence."""
        found = dict.fromkeys(DRIFT_COEFFICIENTS, -np.inf)
        for coefficients, i, of in self._descriptions:
            if coefficients in found:
                squares = self._fit(self.scores[None], of)[1]
                here = log_prior[i] + _evidence(squares, coefficients, len(self.scores), of.phi)[0]
                found[coefficients] = max(found[coefficients], here)
        return max(found, key=lambda coefficients: found[coefficients])

    def _direction(self, change: int, of: _Description) -> FloatArray:
        """Unit vector (n,) of a change beside a description."""
        first, end = self.changes[change]
        place = np.arange(len(self.scores))
        own = _decorrelated((self.weight * ((place >= first) & (place < end)))[None], of.phi)[0]
        return np.asarray((own - of.smooth @ (of.smooth.T @ own)) / of.norms[change])


def correlation_prior(likelihoods: FloatArray) -> FloatArray:
    """Estimate how often each correlation of neighbours occurs in a batch, from the log likelihoods of s series.

    The maximum-likelihood distribution over `NEIGHBOUR_CORRELATIONS` by expectation maximisation (Laird 1978), with one
    further series of which nothing is known, so that no correlation is impossible.
    """
    kinds = likelihoods.shape[1]
    relative = np.exp(likelihoods - likelihoods.max(axis=1, keepdims=True))
    prior = np.full(kinds, 1.0 / kinds)
    for _ in range(PRIOR_ITERATIONS):
        shares = relative * prior
        shares /= shares.sum(axis=1, keepdims=True)
        prior = (shares.sum(axis=0) + 1.0 / kinds) / (len(relative) + 1.0)
    return prior


def _evidence(squares: FloatArray, coefficients: int, count: int, phi: float) -> FloatArray:
    """Evidence (m,) of a number of coefficients that leave sums of squares (m,) of n = count scores."""
    of_correlation = 0.5 * np.log(1.0 - phi**2)
    return np.asarray(of_correlation - 0.5 * coefficients * np.log(count) - 0.5 * count * np.log(squares + 1e-300))


def _pulse_places(splits: np.ndarray, count: int) -> np.ndarray:
    """Indices in `splits` at which a change that comes and goes begins and ends, (l, 2)."""
    least = max(MIN_RECORDINGS_PER_SIDE_OF_STEP, int(np.ceil(MIN_PULSE_SHARE * count)))
    places = np.arange(0, len(splits), max(1, len(splits) // MAX_PULSE_PLACES))
    first, last = (grid.ravel() for grid in np.meshgrid(places, places, indexing="ij"))
    begin, end = splits[first], splits[last]
    allowed = (begin >= least) & (end - begin >= least) & (count - end >= least)
    return np.column_stack([first[allowed], last[allowed]])


def _decorrelated(values: FloatArray, phi: float) -> FloatArray:
    """Values (m, n) without the correlation of neighbours, z_i - phi z_i-1 (Prais and Winsten 1954)."""
    left = values.copy()
    left[:, 1:] -= phi * values[:, :-1]
    left[:, 0] *= np.sqrt(1.0 - phi**2)
    return left


def _along_steps(left: FloatArray, weight: FloatArray, phi: float) -> FloatArray:
    """Products of residuals (m, n) with the weighted, decorrelated step that begins at each recording: (m, n)."""
    after = np.concatenate([[0.0], phi * weight[:-1]])  # a step's first recording has none before it to share with
    return _from_the_end(left * (weight - after)) + left * after


def _from_the_end(values: FloatArray) -> FloatArray:
    """Sums of each value (m, n) and all later ones: (m, n)."""
    return np.cumsum(values[:, ::-1], axis=1)[:, ::-1]
