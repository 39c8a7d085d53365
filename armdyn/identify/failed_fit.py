"""Detect a failed ("lost") fit: its residual varies like the signal itself, so nothing may be concluded from it.

A simulation from wrong values ends in another motion, and the fit in a minimum that has nothing to do with the
recording. Predictions that are linear in the fitted values have one minimum, so such fits are never lost.
"""

from collections.abc import Sequence

import numpy as np

from armdyn.identify.fit import Fit
from armdyn.identify.problem import Problem
from armdyn.identify.residual.block import ResidualBlock, blocks_by_channel
from armdyn.identify.sentence import join_names

MAX_NAMED_PARAMETERS = 3
"""Largest number of parameters that the sentence on a lost fit names."""


def residual_variance_ratio(blocks: Sequence[ResidualBlock]) -> float:
    """Variance of the residual over the variance of the measured signal, as a mean over channels.

    0 is a perfect prediction, 1 is as good as a constant. Both variances are about the mean of each run, because an
    offset alone does not mean another motion.
    """
    shares = []
    for mine in blocks_by_channel(blocks).values():
        left, spread = (
            sum(float(np.var(x) * len(x)) for x in parts)
            for parts in ([b.misfit for b in mine], [b.measured.value for b in mine])
        )
        shares.append(left / spread if spread > 0.0 else 0.0)
    return float(np.mean(shares))


def failed_fit_sentence(fit: Fit) -> str:
    """Sentence for a reader that a fit is lost, and which parameters need start values or priors."""
    asked, why = join_names(_asked(fit)), "The fit leaves most of what the signal itself varies by"
    if not np.isfinite(fit.cost):
        asked += ", or a base of your own a shorter step"
        why = "The simulation diverges from every start that was tried"
    return f"lost: give start values or a prior for {asked}. {why}, so it says nothing of what the model lacks."


def _asked(fit: Fit) -> list[str]:
    """Parameters of the base model without prior: first those on a bound, then by influence on the cost.

    Empty where every parameter has a prior or the simulation diverges; then a stated value may be wrong.
    """
    problem = fit.problem
    own = ~problem.per_run & ~problem.is_effect
    unknown = own & problem.fitted & (problem.prior_weight == 0.0)
    asked = np.flatnonzero(unknown if unknown.any() and np.isfinite(fit.cost) else own)
    feels = np.nan_to_num(np.diag(_curvature(problem, fit.values)))[asked] * problem.typical[asked] ** 2
    bound = [problem.columns[j].name in fit.at_bound for j in asked]
    order = np.lexsort((-feels, ~np.array(bound, dtype=bool)))
    return [problem.columns[j].name for j in asked[order][:MAX_NAMED_PARAMETERS]]


def _curvature(problem: Problem, values: np.ndarray) -> np.ndarray:
    """(P, P) second derivatives of the cost; not finite where a simulation diverges."""
    with np.errstate(all="ignore"):
        return problem.expansion(values, np.ones(len(values), dtype=bool)).hessian
