r"""The best set of effects of the size found so far, where adding one at a time may have gone astray.

Adding one effect at a time ends with the wrong set where the first one imitates two others. Other sets are foretold
from derivatives at fits that exist already. At the best fit one expansion of the whitened cost with every effect,

    c(d) = c - 2 g' d + d' G d,     d = null - value of what leaves, free of what stays or comes, 0 of the rest,

foretells any set that differs in small effects (Hocking, Biometrics 32, 1976, on choosing subsets by their normal
equations). For large ones it is too far, but the runners-up of the step before are fits with one effect less: what one
more promises there foretells the others (a beam search: Russell & Norvig, Artificial Intelligence, 4th ed., §4.1). The
most promising sets are refitted, the best is moved to, and it is asked again, until none is better.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from armdyn.identify.evidence import Whitening, whitening_of
from armdyn.identify.fit import Fit
from armdyn.identify.noise import whitened
from armdyn.identify.ranking import TIE
from armdyn.identify.score import Candidate
from armdyn.identify.select import CLOSE, SAME, gained
from armdyn.identify.study import Study

MOST_EXCHANGED = 2
"""Effects that leave at once, at most."""
REFITTED = 6
"""Sets that are refitted in every round."""
WORTH = 5 * TIE
"""Foretold difference of evidence beyond which a set is not refitted: the foretelling is off by less."""
MOST_ROUNDS = 5
BEAM = 6
"""Runners-up of the step before that are gone on from."""
PROMISES = 3
"""Of each, how many effects are tried beside it."""


Beam = tuple[tuple[Candidate, ...], Fit]


@dataclass(frozen=True, eq=False)
class Exchanged:
    """The best set of effects.

    Attributes:
        effects: of it.
        fit: its minimum.
        tied: effects of other sets of that size that do as well.
    """

    effects: tuple[Candidate, ...]
    fit: Fit
    tied: tuple[Candidate, ...]


@dataclass(frozen=True, eq=False)
class _Foretold:
    effects: tuple[Candidate, ...]
    values: np.ndarray
    bic: float


def exchanged(study: Study, now: Fit, effects: Sequence[Candidate], beam: Sequence[Beam]) -> Exchanged:
    """The set of no more effects than `effects` with the best evidence; effects that the model came with stay.

    Args:
        study: runs and catalogue.
        now: the fit with `effects`.
        effects: the set to improve on.
        beam: sets of one effect less, with their fits.
    """
    here, fit = tuple(effects), now
    rivals: list[tuple[Candidate, ...]] = []
    promising = _gone_on(study, beam)
    for _ in range(MOST_ROUNDS):
        promising = [o for o in (*promising, *_foretold(study, fit, here)) if set(o.effects) != set(here)]
        fits = [study.fit_from(option.effects, option.values, fit) for option in promising]
        compared, whitening = study.weighed([fit, *fits])
        behind = np.array([weight.bic - compared[0].bic for weight in compared[1:]])
        sets = [option.effects for option in promising]
        rivals = [s for s, b in zip(sets, behind, strict=True) if len(s) == len(here) and abs(b) < TIE]
        for i in np.argsort(behind):
            if behind[i] < -SAME and _confirmed(study, fit, fits[i], whitening, float(behind[i])):
                here, fit, promising = sets[i], fits[i], []
                break
        else:
            break
    tied = dict.fromkeys(c for rival in rivals for c in rival if c not in here)
    return Exchanged(here, fit, tuple(tied))


def _confirmed(study: Study, now: Fit, other: Fit, whitening: Whitening, behind: float) -> bool:
    """Whether held-out runs let another fit take the place of this one."""
    if not study.held_out and other.chi2_per_sample < CLOSE:
        return True  # at the noise the likelihood is to be trusted, and one run alone may teach too little
    before = study.held_out_blocks(now)
    after = study.held_out_blocks(other)
    if before is None or after is None:
        return True
    gain, fell = gained(study, (now, before), (other, after), whitening, far=False)
    return fell and (not study.held_out or gain > behind)


def _gone_on(study: Study, beam: Sequence[Beam]) -> list[_Foretold]:
    """Sets of one effect more than those of the beam, the most promising of all."""
    found: dict[frozenset[Candidate], _Foretold] = {}
    costs: list[float] = []
    for effects, fit in sorted(beam, key=lambda b: b[1].cost):
        if len(costs) == BEAM:
            break
        if any(abs(cost - fit.cost) < 1.0 for cost in costs):  # exactly the same under another name
            continue
        costs.append(fit.cost)
        for score in study.scores(fit, effects)[:PROMISES]:
            added = (*effects, score.candidate)
            option = _Foretold(added, fit.values, fit.cost - score.drop)
            known = found.get(frozenset(added))
            if known is None or known.bic > option.bic:
                found[frozenset(added)] = option
    return sorted(found.values(), key=lambda option: option.bic)[:REFITTED]


def _foretold(study: Study, fit: Fit, effects: tuple[Candidate, ...]) -> list[_Foretold]:
    """The most promising other sets of no more effects, with the values foretold for their minima."""
    problem = study.problem
    expansion = _expansion(study, fit)
    present = [e for e in effects if e in study.present]
    added = [e for e in effects if e not in study.present]
    fresh = [c for c in study.candidates if c not in effects]
    base = problem.fitted & ~problem.of([n for c in (*study.candidates, *study.present) for n in c.names])
    columns = {c: np.flatnonzero(problem.of(c.names)) for c in (*added, *present, *fresh)}
    always = np.concatenate([np.flatnonzero(base & fit.free), *(columns[c] for c in present)])
    found = []
    for count in range(1, min(MOST_EXCHANGED, len(added)) + 1):
        for leaving in combinations(added, count):
            staying = [e for e in added if e not in leaving]
            for size in range(count + 1):
                for coming in combinations(fresh, size):
                    chosen = (*present, *staying, *coming)
                    free = np.concatenate([always, *(columns[c] for c in (*staying, *coming))])
                    gone = np.concatenate([columns[c] for c in leaving])
                    option = _minimum(study, fit, expansion, free.astype(int), gone)
                    if option is not None:
                        found.append(_Foretold(chosen, *option))
    now = expansion.cost + expansion.penalty * fit.free.sum()
    found.sort(key=lambda option: option.bic)
    return [option for option in found[:REFITTED] if option.bic < now + WORTH]


@dataclass(frozen=True, eq=False)
class _Expansion:
    """c, g and G over all unknowns, and what an unknown costs."""

    cost: float
    gradient: np.ndarray
    gram: np.ndarray
    penalty: float


def _expansion(study: Study, fit: Fit) -> _Expansion:
    problem, whitening = study.problem, whitening_of(fit)
    prior = problem.prior_weight * (problem.prior_mean - fit.values)
    cost, samples = float(prior @ prior), 0
    gradient, gram = problem.prior_weight * prior, np.diag(problem.prior_weight**2)
    for block in problem.blocks(fit.values):
        coefficients, std = whitening[block.channel]
        residual = whitened(block.residual, coefficients) / std
        sensitivities = whitened(block.sensitivities, coefficients) / std
        cost += float(residual @ residual)
        gradient = gradient + sensitivities.T @ residual
        gram = gram + sensitivities.T @ sensitivities
        samples += len(residual)
    return _Expansion(cost, gradient, gram, float(np.log(samples)))


def _minimum(
    study: Study, fit: Fit, at: _Expansion, free: np.ndarray, gone: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """Values and evidence foretold for a set; None where it leaves the bounds or is not determined."""
    problem = study.problem
    seen = np.diag(at.gram)[free] > 0
    if not seen.all():
        return None
    change = np.zeros(len(fit.values))
    change[gone] = problem.null[gone] - fit.values[gone]
    slope = at.gradient[free] - at.gram[np.ix_(free, gone)] @ change[gone]
    scale = np.sqrt(np.diag(at.gram)[free])
    scaled = at.gram[np.ix_(free, free)] / np.outer(scale, scale)
    try:
        factor = np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:
        return None
    if np.min(np.diag(factor)) < 1e-5:  # an exact imitation
        return None
    change[free] = np.linalg.solve(scaled, slope / scale) / scale
    values = fit.values + change
    outside = (values < problem.lower) | (values > problem.upper)
    if np.any(outside[free]):
        return None
    cost = at.cost - 2 * at.gradient @ change + change @ at.gram @ change
    return values, float(cost) + at.penalty * len(free)
