"""On which joints an effect is worth its unknowns."""

from collections.abc import Sequence
from math import comb, prod

import numpy as np

from armdyn.identify.evidence import Weighed
from armdyn.identify.fit import Fit
from armdyn.identify.score import Candidate
from armdyn.identify.study import Study

LEADING = 2
"""Options that are followed to their minimum."""

Addition = tuple[Candidate, ...]


def on_needed_joints(
    study: Study,
    now: Fit,
    effects: Sequence[Candidate],
    additions: Sequence[Addition],
    fits: Sequence[Fit],
    weights: Sequence[Weighed],
) -> tuple[list[Addition], list[Fit]] | None:
    """The additions on those joints only that are worth it, with their fits; None where all are.

    Derivatives promise what fewer joints cost; where the refit does not keep that, all of them stay.

    Args:
        study: runs and catalogue.
        now: the fit without any addition.
        effects: what the additions are added to.
        additions: each an effect or more.
        fits: with each addition.
        weights: of these fits.
    """
    sparse = [needed(study, added, w) for added, w in zip(additions, weights, strict=True)]
    if sparse == list(additions):
        return None
    reduced = [
        study.fit_with((*effects, *fewer), whole) if fewer else now for fewer, whole in zip(sparse, fits, strict=True)
    ]
    for i in sorted(range(len(fits)), key=lambda i: reduced[i].bic)[:LEADING]:
        if sparse[i]:
            reduced[i] = study.fit_to_the_end((*effects, *sparse[i]), reduced[i])
    compared, _ = study.weighed([now, *reduced, *fits])
    less, more = compared[1 : 1 + len(fits)], compared[1 + len(fits) :]
    chosen: dict[Addition, Fit] = {}
    for i, fewer in enumerate(sparse):
        if fewer and less[i].bic <= more[i].bic:
            chosen[fewer] = reduced[i]
        elif fewer:
            chosen[additions[i]] = fits[i]
    return list(chosen), list(chosen.values())


def needed(study: Study, added: tuple[Candidate, ...], weight: Weighed) -> tuple[Candidate, ...]:
    """The candidates on those joints only that are worth their unknowns.

    Joints go one after the other, as long as the BIC falls. The cost of all that went counts together: each of two
    neighbouring links may be superfluous as long as the other is free.
    """
    kept = []
    for candidate in added:
        if not candidate.joints:
            kept.append(candidate)
            continue
        columns = {j: _moving(study, candidate.on([j]), weight) for j in candidate.joints}
        joints = [j for j in candidate.joints if len(columns[j])]
        gone = np.zeros(0, dtype=int)
        saved = 0.0
        while joints:
            savings = [_saving(study, np.concatenate([gone, columns[j]]), weight) for j in joints]
            best = int(np.argmax(savings))
            if savings[best] <= saved:
                break
            saved = savings[best]
            gone = np.concatenate([gone, columns[joints.pop(best)]])
        if joints:
            kept.append(candidate if len(joints) == len(candidate.joints) else candidate.on(joints))
    return tuple(kept)


def selections(study: Study, added: Sequence[Candidate]) -> int:
    """Number of ways to choose as many joints as each effect has of those on which it could act."""
    whole = {c.effect: len(c.joints) for c in (*study.candidates, *study.present)}
    return prod(comb(max(whole[c.effect], len(c.joints)), len(c.joints)) for c in added)


def _moving(study: Study, candidate: Candidate, weight: Weighed) -> np.ndarray:
    """Indices of the candidate's unknowns that were fitted and are on no bound."""
    columns = np.flatnonzero(study.problem.of(candidate.names))
    return columns[np.diag(weight.covariance)[columns] > 0]


def _saving(study: Study, columns: np.ndarray, weight: Weighed) -> float:
    """By how much the BIC falls when these unknowns return to null and all others are fitted again (Wald)."""
    covariance = weight.covariance[np.ix_(columns, columns)]
    scale = np.sqrt(np.diag(covariance))
    moved = (weight.values - study.problem.null)[columns] / scale
    wald = float(moved @ np.linalg.pinv(covariance / np.outer(scale, scale), rcond=1e-12, hermitian=True) @ moved)
    determined = float(np.sum(1.0 - scale**2 * study.problem.prior_weight[columns] ** 2))
    return determined * float(np.log(weight.samples)) - wald
