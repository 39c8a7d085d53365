"""Test whether a residual is more than noise, and predict how much each candidate effect would lower it (score test).

With the residual r, the derivatives J of the fitted unknowns and an orthonormal basis Q of their columns, an effect
with derivatives d lowers chi2 by about (d' r)^2 / (d' d'), where d' = d - Q Q^T d: Rao's score test (Rao 1948; Silvey,
Statistical Inference, §7.4). No fit with the effect is needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from armdyn.estimation.solve import least_squares, solve_bounded
from armdyn.identify.fit import Fit
from armdyn.identify.noise import ljung_box
from armdyn.identify.problem import EFFECT_PRIOR_STD_TYPICAL_SIZES, Problem
from armdyn.identify.residual.block import ResidualBlock, blocks_by_channel, chi2_sum, chi2_z_value, sample_count
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.settings import DEFAULT_SETTINGS, NoiseSettings

MIN_INIMITABLE_DERIVATIVE_SHARE = 1e-3
"""An effect is not identifiable if less than this share of its derivatives remains without the part that the fitted
parameters can imitate."""


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """Predicted contribution of one candidate effect to a fit (score test).

    Attributes:
        candidate: the candidate effect.
        chi2_decrease: predicted decrease of chi2, with the effect's values within their bounds.
        confounded_with: names of fitted parameters that imitate the effect, if these runs do not identify it; else
            empty.
    """

    candidate: Candidate
    chi2_decrease: float
    confounded_with: tuple[str, ...]


SAMPLES_FACTORISED_AT_ONCE = 2**13
"""Number of samples that are factorised at once, which limits the memory."""


def compress_residuals(
    problem: Problem, blocks: Sequence[ResidualBlock], values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compress the residuals and derivatives of all samples and priors to at most P + 1 rows.

    The compressed residual and derivatives have the same products J'J, J'r and r'r as those of all samples. They come
    from QR factorisations of parts, which are factorised again (Demmel et al., SIAM J. Sci. Comput. 34, 2012), so that
    a long run needs no more memory than a short one.

    Args:
        problem: the problem, whose priors count as samples.
        blocks: residuals and derivatives at `values`.
        values: (P,) values of the unknowns.

    Returns:
        (m,) residuals r and (m, P) derivatives J, m <= P + 1.
    """
    table = np.column_stack([np.diag(problem.prior_weight), problem.prior_weight * (problem.prior_mean - values)])
    for block in blocks:
        for first in range(0, len(block.residual), SAMPLES_FACTORISED_AT_ONCE):
            part = slice(first, first + SAMPLES_FACTORISED_AT_ONCE)
            rows = np.column_stack([block.sensitivities[part], block.residual[part]])
            table = np.asarray(np.linalg.qr(np.vstack([table, rows]), mode="r"))
    return table[:, -1], table[:, :-1]


def score_tests(fit: Fit, candidates: Sequence[Candidate]) -> list[ScoreTest]:
    """Predict how much each candidate effect would lower chi2 if it were added to a fit, the largest decrease first."""
    problem = fit.problem
    residual, jacobian = compress_residuals(problem, problem.blocks(fit.values), fit.values)
    with np.errstate(all="ignore"):
        scaled = jacobian * problem.typical
    if not (np.isfinite(scaled).all() and np.isfinite(residual).all()):  # a diverging simulation predicts nothing
        return [ScoreTest(candidate, 0.0, ()) for candidate in candidates]
    Q, R = np.linalg.qr(scaled[:, fit.free])
    residual = residual - Q @ (Q.T @ residual)
    found = []
    for candidate in candidates:
        columns = np.flatnonzero(problem.mask_of_unknowns(candidate.names))
        found.append(_score(fit, candidate, columns, scaled[:, columns], Q, R, residual))
    return sorted(found, key=lambda score: -score.chi2_decrease)


def linearised_fit(fit: Fit, names: Sequence[str]) -> np.ndarray:
    """(P,) values that minimise the cost of the model linearised at a fit, if the parameters `names` are fitted too.

    The values are within their bounds; those that the runs do not identify stay within about
    `EFFECT_PRIOR_STD_TYPICAL_SIZES` typical sizes.
    """
    problem = fit.problem
    columns = np.flatnonzero(fit.free | problem.mask_of_unknowns(names))
    residual, jacobian = compress_residuals(problem, problem.blocks(fit.values), fit.values)
    width = EFFECT_PRIOR_STD_TYPICAL_SIZES * problem.typical[columns]
    scaled = jacobian[:, columns] * width
    lower, upper = ((bound - fit.values)[columns] / width for bound in (problem.lower, problem.upper))
    normal = scaled.T @ scaled + np.eye(len(columns))
    values = fit.values.copy()
    values[columns] += width * solve_bounded(normal, scaled.T @ residual, lower, upper).x
    return values


def _score(
    fit: Fit,
    candidate: Candidate,
    columns: np.ndarray,
    directions: np.ndarray,
    Q: np.ndarray,
    R: np.ndarray,
    residual: np.ndarray,
) -> ScoreTest:
    problem = fit.problem
    norms = np.linalg.norm(directions, axis=0)
    seen = directions[:, norms > 0]
    if seen.shape[1] == 0:
        return ScoreTest(candidate, 0.0, ())
    shares = Q.T @ seen
    left = seen - Q @ shares
    independence = float(np.max(np.linalg.norm(left, axis=0) / norms[norms > 0]))
    if independence < MIN_INIMITABLE_DERIVATIVE_SHARE:
        weights = np.abs(least_squares(R, shares[:, 0], 1e-12) * np.linalg.norm(R, axis=0))
        names = [c.name for c, f in zip(problem.columns, fit.free, strict=True) if f]
        imitators = tuple(n for n, w in zip(names, weights, strict=True) if w > 0.3 * weights.max())
        return ScoreTest(candidate, 0.0, imitators)
    step = np.zeros(len(norms))
    step[norms > 0] = least_squares(left, residual, 1e-6)
    values = fit.values[columns]
    allowed = np.where(step < 0, values > problem.lower[columns], values < problem.upper[columns])
    inside = left[:, allowed[norms > 0]]
    if inside.shape[1] == 0:
        return ScoreTest(candidate, 0.0, ())
    change = inside @ least_squares(inside, residual, 1e-6)
    return ScoreTest(candidate, float(change @ change), ())


@dataclass(frozen=True)
class ResidualTests:
    """Results of three tests of a fit's residual against noise.

    Attributes:
        z: number of standard deviations by which chi2 exceeds the number of samples, for the worst channel.
        whiteness: probability that white noise is at least as correlated as the residual, for the worst run and
            channel, times their number.
        score: probability that the best effect of the catalogue lowers chi2 as much by chance, times the number of
            effects.
        settings: what counts as noise.
    """

    z: float
    whiteness: float
    score: float
    settings: NoiseSettings = DEFAULT_SETTINGS.noise

    @property
    def fails(self) -> bool:
        """Whether the residual is more than noise."""
        noise = self.settings
        return self.z > noise.z or self.whiteness < noise.whiteness or self.score < noise.effect_probability


def residual_tests(fit: Fit, promised: list[ScoreTest]) -> ResidualTests:
    """Test the residual of a fit against noise.

    Args:
        fit: the fit.
        promised: predicted contributions of the candidate effects; see `score_tests`.
    """
    z = max(chi2_z_value(chi2_sum(blocks), sample_count(blocks)) for blocks in blocks_by_channel(fit.blocks).values())
    whiteness = min(ljung_box(block.residual) for block in fit.blocks) * len(fit.blocks)
    chances = (float(chdtrc(max(1, len(s.candidate.names)), s.chi2_decrease)) for s in promised)
    score = min(chances, default=1.0) * max(1, len(promised))
    return ResidualTests(z, min(1.0, whiteness), min(1.0, score), fit.problem.settings.noise)
