"""Find mistakes in recordings: compare the evidence of each possible mistake with that of no mistake.

Every hypothesis is judged over all recordings together, with all effects of the catalogue: one of a description over
all of its recordings, one of a logger over all of its own, one of a single recording beside the others as they stand.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, TypeVar

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from armdyn.inspection.check import MODEL_PLACEHOLDER, Check, Severity, rounded
from armdyn.inspection.description import AS_DESCRIBED
from armdyn.inspection.hypothesis import MISTAKE_PRICE_NATS, FoundMistake, Hypothesis
from armdyn.inspection.mistake import Mistake
from armdyn.inspection.together import AS_IS, SampledRuns
from armdyn.inspection.zeros import rival_zeros

POSSIBLE_MISTAKE_NATS = 8.0
"""Log odds, in nats, over no mistake from which a mistake is reported as possible."""
MISTAKE_TIE_NATS = 6.0
"""Log odds, in nats, up to which two mistakes explain a recording equally well, so that neither is corrected."""
MAX_CORRECTED_RESIDUAL_SHARE = 0.35
"""Largest residual after a mistake's correction, as a share of a channel's mean square, of half of the channels: others
may vibrate. With a larger one the description is of another arm, and no mistake is reported."""
FULLY_EVALUATED_HYPOTHESES, FULLY_EVALUATED_HYPOTHESES_PER_KIND = 8, 3
"""Number of hypotheses that are evaluated fully after a coarse evaluation, and largest number of one kind."""
MIN_RESIDUAL_SHARE_FOR_TWO_MISTAKES = 0.2
"""Residual, as a share of a channel's mean square, from which two mistakes at once are tried, if one mistake explains
nothing; the median of recordings without a mistake is below 0.14."""
MAX_MISTAKES = 3
"""Largest number of mistakes that are searched in one recording."""
MAX_COARSE_DEFICIT_NATS = 10.0
"""Log odds, in nats, by which a hypothesis may be worse than an unchanged recording in the coarse evaluation."""
FIRST_CLOCK_SHIFT_STEP_SECONDS, FIRST_CLOCK_RATE_ERROR_STEP = 0.03, 5e-3
"""First steps of the search for a clock's error: its shift, s, and its relative rate error."""
CLOCK_SEARCH_RANGE_IN_FIRST_STEPS = 4.0
"""Range of the search for a clock's error to either side of its start, in first steps."""
MAX_CLOCK_ERRORS_TRIED = 80
"""Largest number of clock errors that the search for a clock's error tries."""
SEARCH_WIDTH, MAX_MISTAKES_AT_ONCE = 6, 4
"""Number of sets of mistakes that the search for several mistakes at once continues, and their largest number."""
Compared = TypeVar("Compared", bound=SampledRuns[Any])
MistakesOf = Callable[[Compared], Iterator[Mistake]]
"""Function that yields the possible mistakes in some recordings."""
Meaning = tuple[object, ...]
"""Key of a mistake's correction."""


def find_mistakes(runs: Compared, mistakes: MistakesOf[Compared]) -> Iterator[FoundMistake]:
    """Find mistakes in recordings; each is corrected before the next one is searched."""
    reported: set[tuple[str, tuple[str, ...], int]] = set()
    left = frozenset(range(len(runs.runs)))
    for _ in range(MAX_MISTAKES * len(left)):
        found = most_probable_mistakes(runs, mistakes, left)
        if not found:
            return
        for one in found:
            m = one.mistake
            keys = {(m.kind, m.channels, k) for k in one.runs}
            if keys & reported:
                return
            yield one
            reported |= keys
            if one.correction is None:
                left -= set(one.runs)  # what else is wrong in them cannot be told
            else:
                runs = runs.corrected(m.correction, one.runs)


def most_probable_mistakes(
    runs: Compared, mistakes: MistakesOf[Compared], left: frozenset[int]
) -> tuple[FoundMistake, ...]:
    """The mistakes that explain recordings best; empty if none explains them better than no mistake does.

    Args:
        runs: the recordings.
        mistakes: function that yields the possible mistakes.
        left: indices of the recordings in which mistakes are searched.
    """
    screened = _screened(runs, mistakes, [which for which in _sets(runs) if left.issuperset(which)])
    count = len(runs.runs)
    near = [
        Hypothesis((offered[i],), which, count)
        for which, (offered, values) in screened.items()
        for i in _foremost(offered, values, -MAX_COARSE_DEFICIT_NATS)
    ]
    if not near:
        return ()
    as_is = runs.evidence(AS_IS, ())
    found = _best(runs, near, as_is.value)
    for which, (offered, values) in screened.items():
        share = [s for s, (k, _) in zip(as_is.share, runs.units, strict=True) if k in which]
        much = not found and float(np.median(share)) > MIN_RESIDUAL_SHARE_FOR_TWO_MISTAKES
        # One of several mistakes may be explained by another one that was not made.
        if much or (found and found.chosen.runs == which and found.chosen.meaning[1] == AS_DESCRIBED):
            several = _several(runs.only(which), offered, values)
            near += [replace(h, runs=which, run_count=count) for h in several]
            found = _best(runs, near, as_is.value)
            if found:
                break
    return _as_found(runs, found) if found else ()


def _sets(runs: Compared) -> list[tuple[int, ...]]:
    """Sets of recordings that may have a mistake in common: all, those of one logger, and each alone."""
    every = tuple(range(len(runs.runs)))
    return list(dict.fromkeys([every, *_loggers(runs), *((k,) for k in every)]))


def _loggers(runs: Compared) -> list[tuple[int, ...]]:
    """Indices of the recordings of each logger, which writes the same channels into all of them."""
    found: dict[frozenset[str], list[int]] = {}
    for k, run in enumerate(runs.runs):
        found.setdefault(frozenset(run.run.channels), []).append(k)
    return [tuple(which) for which in found.values()]


def _screened(
    runs: Compared, mistakes: MistakesOf[Compared], sets: Sequence[tuple[int, ...]]
) -> Mapping[tuple[int, ...], tuple[list[Mistake], np.ndarray]]:
    """For each set of recordings the mistakes that they may have, and (m,) coarse log odds over no mistake, nats."""
    every, loggers = tuple(range(len(runs.runs))), _loggers(runs)

    def possible(m: Mistake, which: tuple[int, ...]) -> bool:
        of_all = m.description == AS_DESCRIBED or which == every
        return of_all or (m.description.of_logger and which in loggers)

    offered = {which: [m for m in mistakes(runs.only(which)) if possible(m, which)] for which in sets}
    gains: list[dict[Meaning, float]] = []
    for k, run in enumerate(runs.runs):
        meanings = {_key(m): (m.correction, m.description) for which in sets if k in which for m in offered[which]}
        values = run.coarse_log_evidence([AS_IS, *meanings.values()]) if meanings else np.zeros(1)
        gains.append(dict(zip(meanings, (values[1:] - values[0]).tolist(), strict=True)))
    return {
        which: (
            those,
            np.array(
                [sum(gains[k][_key(m)] for k in which) - Hypothesis((m,), which, len(every)).price for m in those]
            ),
        )
        for which, those in offered.items()
    }


def _key(m: Mistake) -> Meaning:
    return (*sorted(m.correction.readings.items()), m.description)


def _foremost(mistakes: Sequence[Mistake], values: np.ndarray, least: float) -> list[int]:
    """Indices of the best mistakes, with a limit for each kind, and of all effects of these kinds."""
    near: list[int] = []
    for i in np.argsort(values)[::-1].tolist():
        alike = sum(mistakes[k].kind == mistakes[i].kind for k in near)
        if len(near) < FULLY_EVALUATED_HYPOTHESES and alike < FULLY_EVALUATED_HYPOTHESES_PER_KIND and values[i] > least:
            near.append(i)
    # What looks like a mistake may be an effect of the same kind, however the coarse evidence ranks it.
    kinds = {mistakes[i].kind for i in near}
    return near + [i for i, m in enumerate(mistakes) if m.is_effect and m.kind in kinds and i not in near]


def _several(runs: Compared, mistakes: Sequence[Mistake], values: np.ndarray) -> list[Hypothesis]:
    """The most probable sets of several mistakes that all of some recordings have, by their coarse evidence.

    The best sets of each size are continued with every further mistake, even where one mistake alone explains nothing.
    """
    which, found = tuple(range(len(runs.runs))), list[tuple[float, Hypothesis]]()
    alone = [m for m in mistakes if m.description == AS_DESCRIBED and m.correctable and not m.is_effect]
    value_of = {id(m): value for m, value in zip(mistakes, values, strict=True)}
    order = np.argsort([-value_of[id(m)] for m in alone])[:SEARCH_WIDTH]
    best = [Hypothesis((alone[i],), which, len(which)) for i in order]
    as_is = sum(float(run.coarse_log_evidence([AS_IS])[0]) for run in runs.runs)
    for _ in range(1, MAX_MISTAKES_AT_ONCE):
        longer = {
            frozenset(map(id, (*h.mistakes, m))): replace(h, mistakes=(*h.mistakes, m))
            for h in best
            for m in alone
            if not h.excludes(m)
        }
        if not longer:
            break
        tried = list(longer.values())
        total = sum(run.coarse_log_evidence([h.meaning for h in tried]) for run in runs.runs)
        odds = total - as_is - np.array([h.price for h in tried])
        order = np.argsort(-odds)[:SEARCH_WIDTH]
        best = [tried[i] for i in order]
        found += [(float(odds[i]), tried[i]) for i in order]
    found.sort(key=lambda pair: -pair[0])
    return [h for value, h in found[:FULLY_EVALUATED_HYPOTHESES] if value > -MAX_COARSE_DEFICIT_NATS]


@dataclass(frozen=True, eq=False)
class BestHypothesis:
    """The best of several hypotheses.

    Attributes:
        chosen: the hypothesis.
        value: its log evidence less its price, nats.
        log_odds: log odds over no mistake, or over fewer mistakes, nats.
        second: log evidence less price of the next best hypothesis, nats.
        rival: a mistake of that hypothesis, if it explains the recordings as well.
    """

    chosen: Hypothesis
    value: float
    log_odds: float
    second: float
    rival: Mistake | None


def _best(runs: Compared, hypotheses: Sequence[Hypothesis], as_is: float) -> BestHypothesis | None:
    """The best hypothesis; None where it does not explain the recordings."""
    found = [runs.evidence(h.meaning, h.runs) for h in hypotheses]
    values = [one.value - h.price for one, h in zip(found, hypotheses, strict=True)]
    best = int(np.argmax(values))
    chosen, value = hypotheses[best], values[best]
    fewer = [replace(chosen, mistakes=rest) for rest in combinations(chosen.mistakes, len(chosen.mistakes) - 1) if rest]

    def log_odds(evidence: float, price: float = 0.0) -> float:
        """Log odds over another hypothesis; all recordings have the model's error in common, and so count as one."""
        return (found[best].value - evidence) / len(chosen.runs) - (chosen.price - price)

    without = [log_odds(runs.evidence(h.meaning, h.runs).value, h.price) for h in fewer]
    if without and min(without) < POSSIBLE_MISTAKE_NATS:
        return _best(runs, [h for h in (*hypotheses, *fewer) if len(h.mistakes) < len(chosen.mistakes)], as_is)
    concerned = [chosen.concerns(unit) for unit in runs.units]
    concerned = concerned if any(concerned) else [k in chosen.runs for k, _ in runs.units]
    explained = float(np.median(found[best].share[concerned])) <= MAX_CORRECTED_RESIDUAL_SHARE
    if log_odds(as_is) < POSSIBLE_MISTAKE_NATS or not explained or any(m.is_effect for m in chosen.mistakes):
        return None
    effects = (
        log_odds(one.value, h.price)
        for one, h in zip(found, hypotheses, strict=True)
        if any(m.is_effect for m in h.mistakes)
    )
    odds = min(log_odds(as_is), log_odds(runs.evidence_of_no_model(chosen.runs)), *effects, *without)
    if odds < POSSIBLE_MISTAKE_NATS:
        return None
    # A further mistake beside these is not a rival of them.
    others = [
        k for k, h in enumerate(hypotheses) if not chosen.families <= h.families and set(h.runs) & set(chosen.runs)
    ]
    next_best = max(others, key=lambda k: values[k], default=best)
    second = max([*(values[k] for k in others), as_is])
    tied = value - second < MISTAKE_TIE_NATS and len(chosen.mistakes) == 1 and second > as_is
    rival = hypotheses[next_best].mistakes[0] if tied else None
    return BestHypothesis(chosen, value, odds, second, rival)


def _as_found(runs: Compared, best: BestHypothesis) -> tuple[FoundMistake, ...]:
    """The mistakes of the best hypothesis in all recordings that have them, with fitted clocks."""
    chosen = _extended(runs, best.chosen, best.value)
    each = [_with_fitted_clock(runs.only(chosen.runs), chosen.mistakes, k) for k in range(len(chosen.mistakes))]
    # A unit that explains the torques only beside gains is not certain.
    gains = runs.columns_of_effect("torque_gain")
    without_gains = runs.evidence(best.chosen.meaning, best.chosen.runs, gains).value - best.chosen.price
    sure = without_gains - best.second >= MISTAKE_TIE_NATS
    each = [replace(m, correctable=m.correctable and (sure or m.kind != "torque_unit")) for m in each]
    lead, rival = (best.value - best.second) / len(best.chosen.runs), best.rival
    others = rival_zeros(runs, chosen, MISTAKE_TIE_NATS) if rival is None else None
    if others is not None:
        lead, rival = min(lead, others.lead), others.as_mistake
    return tuple(FoundMistake(m, chosen.runs, best.log_odds, lead, rival) for m in each)


def _extended(runs: Compared, chosen: Hypothesis, value: float) -> Hypothesis:
    """The hypothesis for all recordings that it explains better, each by more than a mistake's price."""
    for k in set(range(chosen.run_count)) - set(chosen.runs) if chosen.meaning[1] == AS_DESCRIBED else ():
        wider = replace(chosen, runs=tuple(sorted((*chosen.runs, k))))
        now = runs.evidence(wider.meaning, wider.runs).value - wider.price
        if now - value > MISTAKE_PRICE_NATS:
            chosen, value = wider, now
    return chosen


def _with_fitted_clock(runs: Compared, chosen: tuple[Mistake, ...], which: int) -> Mistake:
    """A clock mistake with the shift and rate error that explain best, in place of the nearest ones tried."""
    m, every = chosen[which], tuple(range(len(runs.runs)))
    if not m.clock:
        return m
    (reading, *_) = m.correction.readings.values()

    def cost(clock: np.ndarray) -> float:
        tried = m.with_clock(FIRST_CLOCK_SHIFT_STEP_SECONDS * clock[0], FIRST_CLOCK_RATE_ERROR_STEP * clock[1])
        fitted = Hypothesis((*chosen[:which], tried, *chosen[which + 1 :]), every, len(every))
        return -runs.evidence(fitted.meaning, every).value

    start = np.array(
        [reading.delay / FIRST_CLOCK_SHIFT_STEP_SECONDS, reading.clock_rate_error / FIRST_CLOCK_RATE_ERROR_STEP]
    )
    bounds = [(x - CLOCK_SEARCH_RANGE_IN_FIRST_STEPS, x + CLOCK_SEARCH_RANGE_IN_FIRST_STEPS) for x in start]
    simplex = start + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    both = minimize(
        cost, start, method="Nelder-Mead", bounds=bounds,
        options={"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.05, "maxfev": MAX_CLOCK_ERRORS_TRIED},
    )  # fmt: skip
    alone = minimize_scalar(
        lambda late: cost(np.array([late, 0.0])), bounds=bounds[0], method="bounded",
        options={"xatol": 1e-3, "maxiter": MAX_CLOCK_ERRORS_TRIED // 2},
    )  # fmt: skip
    late, pace = (float(alone.x), 0.0) if alone.fun <= both.fun + MISTAKE_PRICE_NATS else both.x.tolist()
    return m.with_clock(FIRST_CLOCK_SHIFT_STEP_SECONDS * late, FIRST_CLOCK_RATE_ERROR_STEP * pace)


def mistake_checks(runs: Compared, mistakes: MistakesOf[Compared]) -> Iterator[Check]:
    """Findings on mistakes in recordings, from their comparison with the model."""
    for found in find_mistakes(runs, mistakes):
        m, certain = found.mistake, found.certain
        lead = f"{rounded(found.log_odds_over_next_best)} more than anything else"
        sure = f"{rounded(found.log_odds_over_unchanged)} nats more probable than no mistake with every effect, {lead}"
        sure += f", over {len(found.runs)} recordings together" if len(found.runs) > 1 else ""
        rival = "" if found.rival is None else f", or {found.rival.in_words}: this recording does not tell which"
        for k in found.runs:
            run = runs.runs[k].run
            remedy = f"armdyn inspect {MODEL_PLACEHOLDER} {run.source or run.name} --fix fixed"
            remedy = remedy if found.correction else "record a motion that tells, or ask who made the recording"
            yield Check(
                m.kind, Severity.WRONG if certain else Severity.SUSPECT, run.name, m.channels,
                f"{'' if certain else 'perhaps '}{m.in_words}{rival} ({sure})", m.remedy or remedy,
                evidence=found.log_odds_over_next_best, correction=found.correction,
            )  # fmt: skip
