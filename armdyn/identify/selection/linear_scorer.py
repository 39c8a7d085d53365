r"""Score sets of effects of a model that is linear around one fit, such as an arm's: each by a small linear system.

With X the derivatives of the predictions with respect to every unknown and r the residual, the sums X'X, X'r and r'r of
every run and channel contain all that is needed to fit a set of effects and to predict other runs (`sums`). Unknowns
are in typical sizes. The *wide model*, in which every effect on every joint may have its typical size, and more where
the runs show more, gives the error that remains with any set, and thus the weight of a sample. A set is judged by what
it predicts of motions to which it was not fitted:

    score = - sum_c n_c / 2 misfit(E_c / v_c) - complexity penalty,

where E_c is the mean squared error of channel c in training runs that are each predicted from the others, and in
held-out runs predicted from all training runs; v_c that of the wide model. n_c counts independent samples. The sensor's
noise has N_c / tau_c of them; the model's own error repeats itself, and has `INDEPENDENT_MODEL_ERROR_SAMPLES` however
long a recording is. With m = 1 - noise variance / v_c, the variance of a mean square gives

    1 / n_c = (1 - m)^2 tau_c / N_c + m^2 / INDEPENDENT_MODEL_ERROR_SAMPLES.

A joint that moves in one run only cannot be predicted from the other runs: there the stretches of this run are
predicted in turn (`LinearScorer.folds`).
"""

from collections.abc import Collection, Iterable, Sequence
from functools import cached_property
from math import log, sqrt

import numpy as np

from armdyn.estimation.correlation import correlation_time
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.posterior import NormalPrior, Posterior, freedom_nats, size_nats, wald_distance
from armdyn.estimation.solve import inverse_positive, solve_positive
from armdyn.identify.fit import Fit
from armdyn.identify.problem import transfer_values
from armdyn.identify.residual.block import ResidualBlock
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.set_score import ACCEPTANCE_NATS, EffectSetScore, EffectSetScorer
from armdyn.identify.selection.sums import Sums

INDEPENDENT_MODEL_ERROR_SAMPLES = 20.0
"""Number of independent samples of a model's own error in one channel, however long a recording is. With 8 the springs
of a Gen3 arm are not found; with 20 the error on exam runs is below that of the best single prior width for 10 of 15
imperfect arms, and at most 1.13 times it for the others."""
MAX_RESIDUAL_TO_NOISE_VARIANCE = 1.2
"""Ratio of the residual variance of the wide model to the noise variance up to which the residual counts as noise: for
clean simulations with many samples it is up to 1.1; see `max_noise_ratio`."""
MIN_LEADING_SHARE = 0.05
"""Share of the squared error of the model as given that an effect on one joint removes, from which on it is reported
before the others."""
MIN_INIMITABLE_EFFECT_SHARE = 1e-6
"""Share of an effect's squared derivatives that other effects cannot imitate, below which it is a sum of the others."""
STRETCHES_PER_RUN = 5
"""Number of stretches of a training run that are predicted in turn where no other run can predict it."""
MIN_INFORMATION_OF_OTHER_RUNS = 0.01
"""Share of the information on a joint's unknowns that the other runs must have, so that they can predict a run."""
SCORED_REMOVALS = 4
"""Number of removals from a set, those with the least predicted loss, whose score is computed in each round."""
MAX_REWEIGHTING_ROUNDS = 6
"""Largest number of rounds in which the wide model and its errors, which are its weights, are computed in turn."""
TRAINING_ROW, HELD_OUT_ROW = 0, 1
"""Row index of training runs, and of held-out runs, in arrays of errors."""


def max_noise_ratio(samples: float) -> float:
    """Largest ratio of a mean squared residual to the noise variance that counts as noise.

    Args:
        samples: number of independent samples; by chance the ratio varies about one with a standard deviation of
            sqrt(2 / samples).
    """
    return MAX_RESIDUAL_TO_NOISE_VARIANCE * (1.0 + sqrt(2.0 / max(samples, 1.0)))


def misfit_per_sample(ratio: np.ndarray) -> np.ndarray:
    """-2 log likelihood per sample, with the most likely variance of the model's own error.

    Args:
        ratio: mean squared error over the noise variance.
    """
    return np.where(ratio < 1.0, ratio - 1.0, np.log(np.maximum(ratio, 1.0)))


class LinearScorer(EffectSetScorer):
    """Scores sets of effects with one linearisation of the model.

    Args:
        sums: sums of derivatives and residuals of the training runs and of the runs that are only predicted.
        always: (P,) bool, unknowns that are fitted with every set.
        candidates: all effects that a set may contain, each on one joint.
        given: effects that the model has already; see `EffectSetScorer`.
        catalogue_size: see `EffectSetScorer`.
        independent_errors: number of independent samples of the model's own error in one channel.
        uncertain: effects that every set has without a name, with their own priors, and that are not searched, such as
            links that may differ a little from their description.
        leaves_out: whether training runs are predicted from one another. Else they are judged by their fit, for a model
            that is linear only near a fit to all runs.

    Attributes:
        columns: (c,) indices of the unknowns: those that are always fitted first, then those of the candidates.
        typical: (c,) typical sizes of these unknowns.
        positions: (k,) positions in `columns` of the unknowns of each candidate.
        training: indices of the units (one channel in a stretch of one run) that fits use.
        folds: for each part of the training runs that is predicted from the rest, the units that are fitted and those
            that are predicted.
    """

    max_ranked_effects = 8

    def __init__(
        self,
        sums: Sums,
        always: np.ndarray,
        candidates: Sequence[Candidate],
        given: Sequence[Candidate] = (),
        catalogue_size: int = 0,
        independent_errors: float = INDEPENDENT_MODEL_ERROR_SAMPLES,
        uncertain: Collection[str] = (),
        *,
        leaves_out: bool = True,
    ) -> None:
        super().__init__(sums.problem, candidates, given, catalogue_size)
        self._uncertain, self._leaves_out = uncertain, leaves_out
        p, self.sums, self._independent_errors = sums.problem, sums, independent_errors
        moved = np.einsum("uii->i", sums.equations.gram[sums.training]) > 0.0
        of_effects = p.mask_of_unknowns([name for c in candidates for name in c.names])
        base = np.flatnonzero(always & ~of_effects & moved)
        self.columns = np.append(base, np.flatnonzero(of_effects & moved))
        C, t = self.columns, p.typical[self.columns]
        self.typical, self._base = t, len(base)
        self.positions = {
            c: len(base) + np.flatnonzero(p.mask_of_unknowns(c.names)[C[len(base) :]]) for c in candidates
        }
        self._lower, self._upper = ((bound - sums.values)[C] / t for bound in (p.lower, p.upper))
        self._centre, self._wide = sums.centre[C] / t, sums.width[C] / t
        self._unnamed = np.zeros(len(C))
        for one in (c for c in candidates if c.effect in uncertain and c not in given):
            self._unnamed[self.positions[one]] = self._wide[self.positions[one]]
        self._latent = sums.driver[C] != C
        # An effect that is present at the expansion's point returns to null in sets without it.
        self._absent = np.where(self._latent, 0.0, (p.null - sums.values)[C] / t)
        self._absent[: len(base)] = 0.0
        self._null = (p.null - sums.values)[C] / t
        measured = [next(r.channels[c].unit for r in p.runs if c in r.channels) for c in sums.channels]
        noise = [np.average(sums.noise[sums.training & (sums.channel == c)] ** 2) for c in range(len(sums.channels))]
        self._noise = np.array(noise)
        self._importance = np.ones(len(measured)) if len(set(measured)) == 1 else 1.0 / self._noise
        self.equations, self._unit, stretch = self._cut()
        self._channel, self._is_training = sums.channel[self._unit], sums.training[self._unit]
        self._stages = self._of_stages()
        self.training = np.flatnonzero(self._is_training)
        self.folds = self._folds(stretch)
        self._normals: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        self._variance, self._samples = self._measured()
        self._normals.clear()

    def _cut(self) -> tuple[NormalEquations, np.ndarray, np.ndarray]:
        """Sums in typical sizes; for each, (U,) the unit of `sums`, and (U,) the stretch of its run."""
        s, C, t = self.sums, self.columns, self.typical
        parts, unit, stretch = [], [], []
        for i, block in enumerate(s.blocks):
            X, r = block.sensitivities[:, C] * (block.noise * t), block.misfit
            for k, rows in enumerate(np.array_split(np.arange(len(r)), STRETCHES_PER_RUN if s.training[i] else 1)):
                parts.append(NormalEquations.of_samples(X[rows], r[rows]))
                unit.append(i)
                stretch.append(k)
        return NormalEquations.stacked(parts), np.array(unit), np.array(stretch)

    def _folds(self, stretch: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """See `folds`; (U,) `stretch` is the stretch of the run to which each sum belongs."""
        run, units = self.sums.run[self._unit], self.training
        runs = np.unique(run[units])
        alone = np.zeros((len(self.sums.runs), len(self._noise)), dtype=bool)
        information = np.einsum("uii->ui", self.equations.gram)
        for c in range(len(self._noise)):
            of_channel = units[self._channel[units] == c]
            whole = information[of_channel].sum(axis=0)
            seen = whole > 0.0
            for k in runs:
                others = information[of_channel[run[of_channel] != k]].sum(axis=0)
                share = np.median(others[seen] / whole[seen]) if seen.any() else 1.0
                alone[k, c] = len(runs) == 1 or share < MIN_INFORMATION_OF_OTHER_RUNS
        apart = alone[run, self._channel]
        judged = [(run != k, (run == k) & ~apart) for k in runs]
        judged += [(~((stretch == k) & apart), (stretch == k) & apart) for k in range(STRETCHES_PER_RUN)]
        folds = [(units[fitted[units]], units[left[units]]) for fitted, left in judged]
        return [(fitted, left) for fitted, left in folds if len(left)]

    def _measured(self) -> tuple[np.ndarray, np.ndarray]:
        """(2, c) mean squared error of the wide model by channel, training and held-out runs; (2, c) its samples.

        A value larger than typical is as free as it is large, as under a Cauchy prior. Where other runs are predicted
        better without that freedom, or by the expansion's point, those errors are used.
        """
        noise, channels = self._noise, len(self._noise)
        self._variance, self._samples = np.tile(noise, (2, 1)), np.ones((2, channels))
        change = np.zeros(len(self.columns))
        least = np.maximum(self.mean_squared_errors(change), noise)
        self._variance[:] = np.maximum(least / 30.0, noise)
        widths = self.prior_widths((), 1.0)
        for _ in range(MAX_REWEIGHTING_ROUNDS):
            self._samples[:] = [self._counted(k) for k in (TRAINING_ROW, HELD_OUT_ROW)]
            self._normals.clear()
            change = self.best_change(widths, self.training)
            seen = np.minimum(np.hypot(1.0, change - self._null), self._wide)
            widths = np.where((widths > 0.0) & (self._unnamed == 0.0), seen, widths)
            self._variance = np.maximum(self.mean_squared_errors(change), noise)
            least = np.minimum(least, self._variance)
        self._variance = least
        time = np.array([self._correlation_time(c, change) for c in range(channels)])
        m = np.clip(1.0 - MAX_RESIDUAL_TO_NOISE_VARIANCE * noise / self._variance, 0.0, 1.0)
        count = np.array([self._counted(k) for k in (TRAINING_ROW, HELD_OUT_ROW)])
        with np.errstate(divide="ignore"):
            samples = 1.0 / ((1.0 - m) ** 2 * np.maximum(time / count, 0.0) + m**2 / self._independent_errors)
        return self._variance, np.where(count > 0.0, samples, 0.0)

    def _counted(self, stage: int) -> np.ndarray:
        """(c,) samples of every channel in the training or in the held-out runs."""
        return self._stages.count.reshape(2, -1)[stage]

    def _correlation_time(self, channel: int, change: np.ndarray) -> float:
        s = self.sums
        units = np.flatnonzero((s.channel == channel) & s.training)
        if not len(units):  # a joint that moves in held-out runs alone
            return 1.0
        left = [s.residual(int(unit), self.columns, change * self.typical) for unit in units]
        return float(np.average([correlation_time([one]) for one in left], weights=s.equations.count[units]))

    @property
    def effective_noise(self) -> dict[tuple[str, str], float]:
        """Effective noise of the training runs, by run and channel: with it, a sample has the weight of these fits."""
        return {
            (block.run, block.channel): float(self._weight()[self.sums.channel[i]] ** -0.5)
            for i, block in enumerate(self.sums.blocks)
            if self.sums.training[i]
        }

    def _weight(self) -> np.ndarray:
        """(c,) weight of a squared error in training runs."""
        return np.asarray(self._samples[TRAINING_ROW] / (self._counted(TRAINING_ROW) * self._variance[TRAINING_ROW]))

    def prior_widths(self, effects: Iterable[Candidate], width: float, *, described: bool = False) -> np.ndarray:
        """(c,) prior widths of the unknowns, in typical sizes: wide for some effects and the base, narrow for others.

        Args:
            effects: effects that are fitted with wide priors.
            width: prior width of all other effects; 0 leaves them out.
            described: leave out the effects that every set has without a name, as if their description were exact.
        """
        found = np.zeros(len(self.columns)) if described else self._unnamed.copy()
        rest = self._of(self.searched_effects if width else ())
        found[rest] = np.where(self._latent, 0.0, np.minimum(width, self._wide))[rest]
        found[: self._base] = self._wide[: self._base]
        for one in effects:
            found[self.positions[one]] = self._wide[self.positions[one]]
        return found

    @cached_property
    def searched_effects(self) -> tuple[Candidate, ...]:
        """Candidates, without those of every set and without sums of others, as asymmetric friction is of two effects.

        Either would be as good, and a search that adds one effect at a time would end with whichever came first.
        """
        searched = (c for c in self.candidates if c.effect not in self._uncertain)
        return tuple(c for c in searched if c in self.given or not self._is_sum(c))

    def _is_sum(self, one: Candidate) -> bool:
        """Whether an effect is the sum of simpler effects on its joint."""
        own = self.positions[one]
        simpler = [c for c in self.candidates if c.joints == one.joints and 0 < len(self.positions[c]) < len(own)]
        if not simpler or not one.joints:
            return False
        G, others = self._normal(self.training)[0], self._of(simpler)
        both, k = np.append(own, others), len(own)
        scale = 1.0 / np.sqrt(np.diag(G))[both]
        G = G[np.ix_(both, both)] * np.outer(scale, scale)
        within = np.linalg.lstsq(G[k:, k:], G[k:, :k], rcond=1e-10)[0]
        return bool(np.all(1.0 - np.sum(G[:k, k:] * within.T, axis=1) < MIN_INIMITABLE_EFFECT_SHARE))

    def best_change(self, widths: np.ndarray, units: np.ndarray) -> np.ndarray:
        """(c,) change of the unknowns, in typical sizes, that fits some units best.

        Args:
            widths: (c,) prior widths; an unknown of width 0 is not fitted.
            units: (u,) indices of the units (one channel in one run) that are fitted.
        """
        free = widths > 0.0
        change = np.where(free, 0.0, self._absent)
        change[free] = self._posterior(widths, units).change
        return change

    def _posterior(self, widths: np.ndarray, units: np.ndarray) -> Posterior:
        """Posterior of the unknowns with a width, while all others are at null; see `best_change`."""
        free = widths > 0.0
        c, gone = np.flatnonzero(free), np.flatnonzero(~free & (self._absent != 0.0))
        G, slope = self._normal(units)
        prior = NormalPrior(widths[c], self._centre[c], self._lower[c], self._upper[c])
        return prior.posterior(G[np.ix_(c, c)], slope[c] - G[np.ix_(c, gone)] @ self._absent[gone])

    def _normal(self, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(c, c) and (c,) weighted sums of X'X and X'r over units (u,)."""
        key = units.tobytes()
        if key not in self._normals:
            self._normals[key] = self.equations.weighted(self._weight()[self._channel[units]], units)
        return self._normals[key]

    def _of_stages(self) -> NormalEquations:
        """Sums of every channel over all training runs, then over all held-out runs."""
        stage = np.where(self._is_training, TRAINING_ROW, HELD_OUT_ROW) * len(self._noise) + self._channel
        return self.equations.grouped(stage, 2 * len(self._noise))

    def mean_squared_errors(self, change: np.ndarray) -> np.ndarray:
        """(2, c) mean squared error of every channel in training and in held-out runs after a (c,) change of unknowns.

        It is 0 where there are no samples.
        """
        total = self._stages.squared_error(change, np.arange(len(self._stages.count)))
        return (total / np.maximum(self._stages.count, 1.0)).reshape(2, -1)

    def leave_one_out_errors(self, widths: np.ndarray) -> np.ndarray:
        """(c,) mean squared error, by channel, of training runs that are each predicted from the others; see `folds`.

        Args:
            widths: (c,) prior widths of the unknowns.
        """
        total = np.zeros(len(self._noise))
        for fitted, left in self.folds:
            error = self.equations.squared_error(self.best_change(widths, fitted), left)
            total += np.bincount(self._channel[left], weights=error, minlength=len(total))
        return np.asarray(total / np.maximum(self._counted(TRAINING_ROW), 1.0))

    def prediction_errors(self, widths: np.ndarray) -> np.ndarray:
        """(2, c) mean squared error, by channel, of training runs predicted from the others, and of held-out runs.

        Args:
            widths: (c,) prior widths of the unknowns.
        """
        fitted, held_out = self.mean_squared_errors(self.best_change(widths, self.training))
        return np.array([self.leave_one_out_errors(widths) if self._leaves_out else fitted, held_out])

    def prediction_log_likelihood(self, widths: np.ndarray) -> float:
        """Log likelihood of training runs that are predicted from the others, plus that of held-out runs.

        Args:
            widths: (c,) prior widths of the unknowns.
        """
        return self.log_likelihood(self.prediction_errors(widths))

    def log_likelihood(self, errors: np.ndarray) -> float:
        """Log likelihood of (2, c) mean squared errors of training and held-out runs, by channel."""
        return float(self._log_likelihoods(errors).sum())

    def gain(self, before: Fit, after: Fit) -> float:
        """Gain of log probability, nats, of the training runs from one fit to another one."""
        errors = [self.mean_squared_errors_of(fit.blocks, ()) for fit in (before, after)]
        found = [self._log_likelihoods(one)[TRAINING_ROW] for one in errors]
        return float(found[1] - found[0]) + self.unnamed_nats(before) - self.unnamed_nats(after)

    def unnamed_nats(self, at: Fit) -> float:
        """Nats that the values of a fit cost which every set has without a name: the farther off, the less likely."""
        values = transfer_values(at.values, at.problem, self.problem)
        return float(self._unnamed_nats((values - self.sums.values)[self.columns] / self.typical))

    def _unnamed_nats(self, change: np.ndarray) -> np.ndarray:
        """(...) nats of (c, ...) changes of the unknowns, in typical sizes; see `unnamed_nats`."""
        own = self._unnamed > 0.0
        away = (change[own].T - self._centre[own]) / self._unnamed[own]
        return np.asarray(0.5 * np.sum(away**2, axis=-1))

    def mean_squared_errors_of(
        self, training: Sequence[ResidualBlock], held_out: Sequence[ResidualBlock]
    ) -> np.ndarray:
        """(2, c) mean squared error, by channel, of residuals of the training and of the held-out runs."""
        total, count = np.zeros((2, len(self._noise))), np.zeros((2, len(self._noise)))
        for row, blocks in ((TRAINING_ROW, training), (HELD_OUT_ROW, held_out)):
            for block in blocks:
                place = row, self.sums.channels.index(block.channel)
                total[place] += float(block.misfit @ block.misfit)
                count[place] += len(block.misfit)
        return total / np.maximum(count, 1.0)

    def _log_likelihoods(self, errors: np.ndarray) -> np.ndarray:
        """(..., 2) log likelihoods of training and of held-out runs, from (..., 2, c) mean squared errors."""
        return np.asarray(-0.5 * np.sum(self._samples * misfit_per_sample(errors / self._variance), axis=-1))

    def predicts_to_the_noise(self, effects: Sequence[Candidate]) -> bool:
        """Whether the error of predicted runs with a set is only noise, so that no other set can predict better."""
        errors = self.prediction_errors(self.prior_widths(effects, 0.0))
        count = self._stages.count.reshape(2, -1)
        return bool(np.all(errors <= self._noise * np.array([[max_noise_ratio(n) for n in row] for row in count])))

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

    def _of(self, effects: Iterable[Candidate]) -> np.ndarray:
        """(k,) positions of the effects' unknowns among the columns."""
        return np.concatenate([np.zeros(0, dtype=int), *(self.positions[c] for c in effects)])

    def _is_inside(self, widths: np.ndarray, change: np.ndarray, own: np.ndarray) -> bool:
        """Whether no effect relies on a value that the runs pull beyond its bound.

        A bound at which the effect is absent, and one that they do not pull beyond by more than chance, do not count.
        """
        beyond = np.zeros(len(widths))
        beyond[widths > 0.0] = self._posterior(widths, self.training).gain_beyond_bound_nats
        return bool(np.all((beyond < ACCEPTANCE_NATS)[own] | (change == self._null)[own]))

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
        """Effects on single joints that each remove `MIN_LEADING_SHARE` of the squared error, added one by one.

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
            if before - error < MIN_LEADING_SHARE * now.misfit:
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
        change, c = self.best_change(widths, self.training) - self._null, np.flatnonzero(widths > 0.0)
        covariance = np.zeros((len(widths), len(widths)))
        covariance[np.ix_(c, c)] = self._posterior(widths, self.training).covariance
        return change, covariance

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
