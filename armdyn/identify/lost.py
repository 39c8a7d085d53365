"""Whether a fit is lost: worse than no model at all, so that nothing may be concluded from it.

A simulation from wrong values ends in another motion, and a descent in a minimum that has nothing to do with the
recording. What it leaves then varies more than the signal itself does. Predictions that are linear in what is fitted
have one minimum and are never lost.
"""

from collections.abc import Sequence

import numpy as np

from armdyn.identify.fit import NEAR_NOISE, Fit
from armdyn.identify.problem import Block, Problem, by_channel
from armdyn.identify.sentence import listed
from armdyn.identify.study import Study

MOST_NAMED = 3
"""Parameters that a sentence asks start values of."""


def lost(study: Study, fit: Fit) -> bool:
    """Whether a fit of a model with states leaves more than the signals' own spread, in training or held-out runs.

    What is at the noise is not lost: a recording in which nothing happens has no spread but that. See `left_of_spread`.
    """
    if study.model.linear or fit.chi2_per_sample < NEAR_NOISE:
        return False
    kinds = [fit.blocks, study.held_out_blocks(fit)] if study.held_out else [fit.blocks]
    return not all(left_of_spread(kind) <= 1.0 for kind in kinds)


def left_of_spread(blocks: Sequence[Block]) -> float:
    """Variance of the residual over that of the signal, the mean over channels: 0 is perfect, 1 as good as a constant.

    Both vary about the mean of every run: an offset that a model lacks is no other motion.
    """
    shares = []
    for mine in by_channel(blocks).values():
        left, spread = (
            sum(float(np.var(x) * len(x)) for x in parts)
            for parts in ([b.misfit for b in mine], [b.measured.value for b in mine])
        )
        shares.append(left / spread if spread > 0.0 else 0.0)
    return float(np.mean(shares))


def lost_sentence(fit: Fit) -> str:
    """For a person: that a fit is lost, and of which parameters start values or priors are needed."""
    return (
        f"lost: give start values or a prior for {listed(_asked(fit))}. The fit leaves more than the signal itself "
        "varies by, so it says nothing of what the model lacks."
    )


def _asked(fit: Fit) -> list[str]:
    """Parameters of the base that nothing is known of beforehand: on a bound first, then what the cost feels most.

    Where there is none, or the simulation diverges, what was stated may be wrong.
    """
    problem = fit.problem
    own = ~problem.per_run & ~problem.is_effect
    unknown = own & problem.fitted & (problem.prior_weight == 0.0)
    asked = np.flatnonzero(unknown if unknown.any() and np.isfinite(fit.cost) else own)
    feels = np.nan_to_num(np.diag(_curvature(problem, fit.values)))[asked] * problem.typical[asked] ** 2
    bound = [problem.columns[j].name in fit.at_bound for j in asked]
    order = np.lexsort((-feels, ~np.array(bound, dtype=bool)))
    return [problem.columns[j].name for j in asked[order][:MOST_NAMED]]


def _curvature(problem: Problem, values: np.ndarray) -> np.ndarray:
    """(P, P) second derivatives of the cost; not finite where a simulation diverges."""
    with np.errstate(all="ignore"):
        return problem.expansion(values, np.ones(len(values), dtype=bool)).hessian
