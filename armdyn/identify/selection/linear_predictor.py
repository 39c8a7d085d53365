r"""Predict runs with any set of effects of a model that is linear around one fit, such as an arm's.

With X the derivatives of the predictions with respect to every unknown and r the residual, the sums X'X, X'r and r'r of
every run and channel contain all that is needed to fit a set of effects and to predict other runs (`sums`). Unknowns
are in typical sizes. The *wide model*, in which every effect on every joint may have its typical size, and more where
the runs show more, gives the error that remains with any set, and thus the weight of a sample. A set is judged by what
it predicts of motions to which it was not fitted:

    score = - sum_c n_c / 2 misfit(E_c / v_c) - complexity penalty,

where E_c is the mean squared error of channel c in training runs that are each predicted from the others, and in
held-out runs predicted from all training runs; v_c that of the wide model. n_c counts independent samples. The sensor's
noise has N_c / tau_c of them; the model's own error repeats itself, and has `NoiseSettings.model_errors` however
long a recording is. With m = 1 - noise variance / v_c, the variance of a mean square gives

    1 / n_c = (1 - m)^2 tau_c / N_c + m^2 / model_errors.

A joint that moves in one run only cannot be predicted from the other runs: there the stretches of this run are
predicted in turn (`LinearScorer.folds`).
"""

from collections.abc import Collection, Iterable, Sequence
from functools import cached_property

import numpy as np

from armdyn.estimation.correlation import correlation_time
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.posterior import NormalPrior, Posterior
from armdyn.estimation.solve import least_squares
from armdyn.identify.fit import Fit
from armdyn.identify.problem import transfer_values
from armdyn.identify.residual.block import ResidualBlock
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.set_score import EffectSetScorer
from armdyn.identify.selection.sums import Sums

MIN_INIMITABLE_EFFECT_SHARE = 1e-6
"""Share of an effect's squared derivatives that other effects cannot imitate, below which it is a sum of the others."""
STRETCHES_PER_RUN = 5
"""Number of stretches of a training run that are predicted in turn where no other run can predict it."""
MIN_INFORMATION_OF_OTHER_RUNS = 0.01
"""Share of the information on a joint's unknowns that the other runs must have, so that they can predict a run."""
MAX_REWEIGHTING_ROUNDS = 6
"""Largest number of rounds in which the wide model and its errors, which are its weights, are computed in turn."""
TRAINING_ROW, HELD_OUT_ROW = 0, 1
"""Row index of training runs, and of held-out runs, in arrays of errors."""


def misfit_per_sample(ratio: np.ndarray) -> np.ndarray:
    """-2 log likelihood per sample, with the most likely variance of the model's own error.

    Args:
        ratio: mean squared error over the noise variance.
    """
    return np.where(ratio < 1.0, ratio - 1.0, np.log(np.maximum(ratio, 1.0)))


class LinearPredictor(EffectSetScorer):
    """Predicts runs with any set of effects, by one linearisation of the model.

    Args:
        sums: sums of derivatives and residuals of the training runs and of the runs that are only predicted.
        always: (P,) bool, unknowns that are fitted with every set.
        candidates: all effects that a set may contain, each on one joint.
        given: effects that the model has already; see `EffectSetScorer`.
        catalogue_size: see `EffectSetScorer`.
        independent_errors: number of independent samples of the model's own error in one channel; None means that of
            the settings.
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

    def __init__(
        self,
        sums: Sums,
        always: np.ndarray,
        candidates: Sequence[Candidate],
        given: Sequence[Candidate] = (),
        catalogue_size: int = 0,
        independent_errors: float | None = None,
        uncertain: Collection[str] = (),
        *,
        leaves_out: bool = True,
    ) -> None:
        super().__init__(sums.problem, candidates, given, catalogue_size)
        self._uncertain, self._leaves_out = uncertain, leaves_out
        p, self.sums = sums.problem, sums
        self._independent_errors = (
            self.settings.noise.model_errors if independent_errors is None else independent_errors
        )
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
        m = np.clip(1.0 - self.settings.noise.variance_ratio * noise / self._variance, 0.0, 1.0)
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
        """Standard deviation by run and channel of training runs, with which a fit weighs samples as these fits did."""
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
        """Candidates that a search tries: not those that every set has, and not those that are sums of two others.

        Asymmetric friction, for example, is the sum of friction and an offset: a search that adds one effect at a time
        could not choose between the sum and its parts.
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
        within = least_squares(G[k:, k:], G[k:, :k], 1e-10)
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

    def predicted_gain(self, before: np.ndarray, after: np.ndarray) -> float:
        """Gain of log likelihood, nats, of held-out runs between (2, c) mean squared errors; 0 without such runs."""
        found = [self._log_likelihoods(errors)[HELD_OUT_ROW] for errors in (before, after)]
        return float(found[1] - found[0])

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

    def _of(self, effects: Iterable[Candidate]) -> np.ndarray:
        """(k,) positions of the effects' unknowns among the columns."""
        return np.concatenate([np.zeros(0, dtype=int), *(self.positions[c] for c in effects)])
