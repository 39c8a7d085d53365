"""Which effect to add next: refit what promises most, rank by evidence, accept what held-out runs confirm."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from armdyn.identify.evidence import Whitening, p_value
from armdyn.identify.fit import GROSS, Fit
from armdyn.identify.held_out import chi2_of, cost_in_turn
from armdyn.identify.noise import whitened
from armdyn.identify.problem import Block
from armdyn.identify.ranking import SIGNIFICANCE, TIE, Option, Ranking
from armdyn.identify.score import Candidate, Score
from armdyn.identify.study import Study

LEADING = 2
"""Options that are followed to their minimum."""
REFITTED = 9
"""Candidates that are refitted; the truth was among the first eight by score every time, gross errors apart."""
CONFIRMED = 4
"""Of these, how many are tried on held-out runs."""
CLOSE = 2.0
"""Chi2 per sample at which a fit has certainly found the right minimum."""
THOROUGH = 4
BY_CHANCE = 1.0
"""Standard deviations of chi2 by which it may exceed the number of samples before anything counts as left."""
CLEARLY = 0.05
"""Far above the noise, share by which the chi2 of held-out runs must fall."""
AT_FLOOR = 2.0
"""Chi2 per sample of held-out runs below which they cannot improve by much more than chance."""
UNHARMED = 3.0
"""By how much the whitened cost of held-out runs may rise by chance."""
SAME, SAME_SHARE = 0.1, 1e-5
"""Differences of evidence, and share of the largest, up to which two effects do the same and the catalogue's order
decides which is named first: rounding must not."""
PAIRED = 5
"""Best single effects that are tried in pairs."""


def rank(study: Study, now: Fit, effects: Sequence[Candidate], promised: Sequence[Score]) -> Ranking:
    """Refit the most promising single effects and rank them."""
    identifiable = [s for s in promised if s.drop > 0]
    chosen = identifiable if now.chi2_per_sample > GROSS else identifiable[:REFITTED]
    return compare(study, now, effects, [(s.candidate,) for s in chosen], tried=len(promised))


def rank_pairs(study: Study, now: Fit, effects: Sequence[Candidate], singles: Ranking) -> Ranking:
    """Pairs of the best single effects and of the present ones, each pair in place of the effect added last."""
    pool: list[Option] = []
    for option in singles.options:
        twin = any(abs(option.weighed.cost - other.weighed.cost) < 1.0 for other in pool)  # they do exactly the same
        if not twin and len(pool) < PAIRED:
            pool.append(option)
    pairs = [(a.added[0], b.added[0]) for a, b in combinations(pool, 2)]
    return compare(study, now, effects, pairs, tried=10 * len(pairs))


def compare(
    study: Study,
    now: Fit,
    effects: Sequence[Candidate],
    additions: Sequence[tuple[Candidate, ...]],
    *,
    tried: int,
) -> Ranking:
    """Refit the model with each addition, weigh all under one whitening, try the best on held-out runs.

    Args:
        study: runs and catalogue.
        now: the fit that they must improve on.
        effects: what the additions are added to.
        additions: each an effect or more.
        tried: number of effects that the best was chosen from.
    """
    additions = list(additions)
    fits = _raced(study, now, effects, additions)
    first = tuple(effects) == study.present and all(len(added) == 1 for added in additions)
    if first and now.chi2_per_sample > GROSS and fits and min(f.chi2_per_sample for f in fits) > CLOSE:
        # Far from the truth the nearest minimum may be the wrong one: the best few get other starts as well. Later fits
        # start from these.
        for i in sorted(range(len(fits)), key=lambda i: fits[i].cost)[:THOROUGH]:
            near = _nearest(study, now, effects, additions[i])
            fits[i] = study.fit_thoroughly((*effects, *additions[i]), near)
            if fits[i].chi2_per_sample < CLOSE:
                break
    # What leads, or would if it were not for its last steps, is followed to its minimum before it is judged.
    for i in sorted(range(len(fits)), key=lambda i: fits[i].bic)[:LEADING]:
        fits[i] = study.fit_to_the_end((*effects, *additions[i]), now)
    compared, whitening = study.weighed([now, *fits])
    present, others = compared[0], compared[1:]
    certain_noise = now.samples + BY_CHANCE * np.sqrt(2.0 * now.samples)
    options = []
    for added, found, weight in zip(additions, fits, others, strict=True):
        drop, extra = present.cost - weight.cost, max(1, weight.count - present.count)
        own = study.problem.of([name for candidate in added for name in candidate.names])
        bounded = bool(np.all(study.problem.lower[own] == study.problem.null[own]))
        options.append(
            Option(
                added=added,
                effects=(*effects, *added),
                fit=found,
                weighed=weight,
                delta_bic=present.bic - weight.bic,
                p_value=min(1.0, tried * p_value(drop, extra, one_sided=bounded)),
                share=(now.cost - found.cost) / max(now.cost - certain_noise, 1e-9),
                far=now.chi2_per_sample > GROSS,
            )
        )
    place = {candidate.effect: i for i, candidate in enumerate(study.candidates)}
    grain = max(SAME, SAME_SHARE * max((abs(o.delta_bic) for o in options), default=0.0))
    options.sort(key=lambda o: (-round(o.delta_bic / grain), [place.get(c.effect, -1) for c in o.added]))
    return confirmed(study, now, Ranking(tuple(options), tuple(o.delta_bic for o in options), whitening, present))


def _raced(
    study: Study, now: Fit, effects: Sequence[Candidate], additions: Sequence[tuple[Candidate, ...]]
) -> list[Fit]:
    """Fits with each addition; of more than `REFITTED` only the best so far are carried on to the end."""
    starts = [_nearest(study, now, effects, added) for added in additions]
    if len(additions) <= REFITTED:
        return [study.fit_with((*effects, *a), near) for a, near in zip(additions, starts, strict=True)]
    fits = [study.sketch((*effects, *a), near) for a, near in zip(additions, starts, strict=True)]
    for i in sorted(range(len(fits)), key=lambda i: fits[i].cost)[:REFITTED]:
        fits[i] = study.fit_with((*effects, *additions[i]), fits[i])
    return fits


def _nearest(study: Study, now: Fit, effects: Sequence[Candidate], added: Sequence[Candidate]) -> Fit:
    """Where a fit with several additions starts: from the best fit with one of them."""
    if len(added) == 1:
        return now
    return min((study.fit_with((*effects, c), now) for c in added), key=lambda f: f.cost)


def confirmed(study: Study, now: Fit, ranking: Ranking) -> Ranking:
    """The ranking with the best options tried on held-out runs."""
    worth = [o for o in ranking.options if o.p_value < SIGNIFICANCE and o.delta_bic > 0]
    reference = study.held_out_blocks(now) if worth else None
    if reference is None:
        return ranking
    best: float | None = None
    options, evidence = [], []
    for option in ranking.options:
        # Runs held out in turn can only refuse an option: when one has passed, what is not tied with it is no matter.
        if study.held_out:
            tested = option in worth and (
                worth.index(option) < CONFIRMED or worth[0].delta_bic - option.delta_bic < TIE
            )
        else:
            tested = option in worth and option.accepted and (best is None or best - option.delta_bic < TIE)
        blocks = study.held_out_blocks(option.fit) if tested else None
        if blocks is None:
            options.append(option)
            evidence.append(option.delta_bic)
            continue
        gain, fell = gained(study, (now, reference), (option.fit, blocks), ranking.whitening, far=option.far)
        options.append(replace(option, held_out_gain=gain, held_out_fell=fell, held_out=tuple(blocks)))
        if best is None and options[-1].accepted:
            best = option.delta_bic
        # Runs that were given to be held out add to the evidence; runs held out in turn are in it already.
        evidence.append(option.delta_bic + (gain if study.held_out else 0.0))
    grain = max(SAME, SAME_SHARE * max((abs(e) for e in evidence), default=0.0))
    order = sorted(range(len(options)), key=lambda i: -round(evidence[i] / grain))
    return Ranking(
        tuple(options[i] for i in order), tuple(evidence[i] for i in order), ranking.whitening, ranking.present
    )


def gained(
    study: Study, before: tuple[Fit, Sequence[Block]], after: tuple[Fit, Sequence[Block]], whitening: Whitening, *,
    far: bool,
) -> tuple[float, bool]:  # fmt: skip
    """Fall of the whitened cost of held-out runs, and whether their error fell, or rose no more than by chance.

    Args:
        study: runs and catalogue.
        before: fit without the effect, and its residuals on held-out runs.
        after: with it.
        whitening: of the cost.
        far: whether the model without it is far above the noise.
    """
    (now, reference), (other, blocks) = before, after
    gain = _cost(reference, whitening) - _cost(blocks, whitening)
    error, samples = chi2_of(blocks), sum(len(block.residual) for block in blocks)
    least = 1.0 - (CLEARLY if far else 0.0)
    # Near the noise a model fitted to fewer runs predicts worse for being less certain, not for being wrong.
    harmless = gain > -UNHARMED or not study.held_out
    fell = error < least * chi2_of(reference) or (error < AT_FLOOR * samples and harmless)
    if not fell and not study.held_out:
        added = cost_in_turn(other)
        fell = added < least * cost_in_turn(now) or added < AT_FLOOR * samples
    return gain, fell


def superfluous(study: Study, now: Fit, effects: Sequence[Candidate], kept: Sequence[Candidate]) -> Option | None:
    """The effect, not among `kept`, whose removal improves the whitened BIC most; None when every one is needed."""
    removable = [c for c in effects if c not in kept]
    if not removable:
        return None
    fits = [study.fit_with([e for e in effects if e is not c], now) for c in removable]
    compared, _ = study.weighed([now, *fits])
    gains = [compared[0].bic - weight.bic for weight in compared[1:]]
    best = int(np.argmax(gains))
    if gains[best] <= 0:
        return None
    rest = tuple(e for e in effects if e is not removable[best])
    return Option((removable[best],), rest, fits[best], compared[best + 1], gains[best], 1.0, 0.0, False)


def _cost(blocks: Sequence[Block], whitening: Whitening) -> float:
    total = 0.0
    for block in blocks:
        coefficients, std = whitening[block.channel]
        left = whitened(block.residual, coefficients) / std
        total += float(left @ left)
    return total
