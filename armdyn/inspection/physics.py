"""Find mistakes in a recording: compare the evidence of each possible mistake with that of an unchanged recording."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from armdyn.inspection.arm import AS_DESCRIBED, SampledArmRun
from armdyn.inspection.check import MODEL_PLACEHOLDER, Check, Severity, rounded
from armdyn.inspection.correction import Correction
from armdyn.inspection.mistakes import Mistake
from armdyn.inspection.swing import SampledSwingRun

MISTAKE_PRICE_NATS = 8.0
"""Log prior odds against each mistake, nats: about one recording in ten has one of about a hundred mistakes."""
CERTAIN_MISTAKE_NATS = 12.0
"""Log odds, in nats, over an unchanged recording from which a mistake is certain; recordings without a mistake reach 6,
see docs/inspect.md."""
POSSIBLE_MISTAKE_NATS = 8.0
"""Log odds, in nats, over an unchanged recording from which a mistake is reported as possible."""
MISTAKE_TIE_NATS = 6.0
"""Log odds, in nats, up to which two mistakes explain a recording equally well, so that neither is corrected."""
MAX_CORRECTED_RESIDUAL_SHARE = 0.35
"""Largest residual after a mistake's correction, as a share of the channels' mean square. With a larger one the
description is of another arm, and no mistake is reported."""
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
ComparedRun = TypeVar("ComparedRun", SampledArmRun, SampledSwingRun)


@dataclass(frozen=True, eq=False)
class FoundMistake:
    """A mistake that was found in a recording, with its evidence.

    Attributes:
        mistake: the mistake.
        log_odds_over_unchanged: log odds of the mistake over an unchanged recording, nats.
        log_odds_over_next_best: log odds of the mistake over the next best hypothesis, nats.
        rival: another mistake that explains the recording as well; None without one.
    """

    mistake: Mistake
    log_odds_over_unchanged: float
    log_odds_over_next_best: float
    rival: Mistake | None = None

    @property
    def certain(self) -> bool:
        """Whether the mistake is certain, rather than possible."""
        return self.log_odds_over_unchanged >= CERTAIN_MISTAKE_NATS

    @property
    def correction(self) -> Correction | None:
        """The correction of the recording; None if the mistake or its correction is not certain."""
        known = self.certain and self.rival is None and self.mistake.correctable
        return self.mistake.correction if known and self.mistake.correction.readings else None


def find_mistakes(run: ComparedRun, mistakes: Callable[[ComparedRun], Iterator[Mistake]]) -> Iterator[FoundMistake]:
    """Find mistakes in a recording; each is corrected before the next one is searched."""
    reported: set[tuple[str, tuple[str, ...]]] = set()
    for _ in range(MAX_MISTAKES):
        found = most_probable_mistakes(run, list(mistakes(run)))
        for one in found:
            m = one.mistake
            if (m.kind, m.channels) in reported:
                return
            yield one
            reported.add((m.kind, m.channels))
            if m.description != AS_DESCRIBED or not one.certain or one.rival is not None:
                return
            run = replace(run, run=m.correction.applied_to(run.run))
        if not found:
            return


def most_probable_mistakes(run: ComparedRun, mistakes: Sequence[Mistake]) -> tuple[FoundMistake, ...]:
    """The one or two mistakes that explain a recording best; empty if no mistake explains it better."""
    screened = run.coarse_log_evidence(
        [(Correction(), AS_DESCRIBED), *((m.correction, m.description) for m in mistakes)]
    )
    least, values = float(screened[0]) - MAX_COARSE_DEFICIT_NATS, screened[1:] - [_price((m,)) for m in mistakes]
    near = _foremost(mistakes, values, least)
    if not near:
        return ()
    as_is = run.log_evidence(Correction(), AS_DESCRIBED)
    found = _best(run, [(mistakes[i],) for i in near], as_is.value)
    if found or float(np.median(as_is.share)) < MIN_RESIDUAL_SHARE_FOR_TWO_MISTAKES:
        return found
    pairs = [
        (mistakes[i], second)
        for i in _foremost(mistakes, values, -np.inf)
        for second in mistakes
        if mistakes[i].kind != second.kind and mistakes[i].description == AS_DESCRIBED == second.description
    ]
    if not pairs:
        return ()
    values = run.coarse_log_evidence([(_corrected(pair), AS_DESCRIBED) for pair in pairs]) - [
        _price(pair) for pair in pairs
    ]
    best = [i for i in np.argsort(values)[::-1][:FULLY_EVALUATED_HYPOTHESES].tolist() if values[i] > least]
    return _best(run, [pairs[i] for i in best], as_is.value)


def _price(mistakes: Sequence[Mistake]) -> float:
    """Log prior odds against all these mistakes at once, nats."""
    return sum(m.prior_odds_nats + MISTAKE_PRICE_NATS for m in mistakes)


def _corrected(mistakes: Sequence[Mistake]) -> Correction:
    """The correction of one mistake after the other."""
    return reduce(Correction.followed_by, (m.correction for m in mistakes), Correction())


def _foremost(mistakes: Sequence[Mistake], values: np.ndarray, least: float) -> list[int]:
    """Indices of the best mistakes, with a limit for each kind."""
    near: list[int] = []
    for i in np.argsort(values)[::-1].tolist():
        alike = sum(mistakes[k].kind == mistakes[i].kind for k in near)
        if len(near) < FULLY_EVALUATED_HYPOTHESES and alike < FULLY_EVALUATED_HYPOTHESES_PER_KIND and values[i] > least:
            near.append(i)
    return near


def _best(run: ComparedRun, sets: Sequence[tuple[Mistake, ...]], as_is: float) -> tuple[FoundMistake, ...]:
    """The best of several sets of mistakes; empty where it does not explain the recording."""
    if not sets:
        return ()
    found = [run.log_evidence(_corrected(mistakes), mistakes[-1].description) for mistakes in sets]
    values: list[float] = [one.value - _price(mistakes) for one, mistakes in zip(found, sets, strict=True)]
    best = int(np.argmax(values))
    chosen = sets[best]
    concerned = [k for k, c in enumerate(run.channels) if any(c in m.channels for m in chosen)] or slice(None)
    explained = float(np.mean(found[best].share[concerned])) <= MAX_CORRECTED_RESIDUAL_SHARE
    least = max(as_is, run.log_evidence_of_no_model())
    of_description = any(m.description.mass != 1.0 or m.description.length != 1.0 for m in chosen)
    # A description belongs to all its recordings, so a mistake in it must be certain.
    enough = CERTAIN_MISTAKE_NATS if of_description else POSSIBLE_MISTAKE_NATS
    if values[best] - least < enough or not explained or any(m.is_effect for m in chosen):
        return ()
    same = {m.family for m in chosen}
    others: list[int] = [k for k, those in enumerate(sets) if {m.family for m in those} != same]
    next_best = max(others, key=lambda k: values[k], default=best)
    lead = values[best] - max([*(values[k] for k in others), as_is])
    rival = sets[next_best][0] if lead < MISTAKE_TIE_NATS and len(chosen) == 1 and values[next_best] > as_is else None
    chosen = tuple(_with_fitted_clock(run, chosen, k) for k in range(len(chosen)))
    return tuple(FoundMistake(m, values[best] - least, lead, rival) for m in chosen)


def _with_fitted_clock(run: ComparedRun, chosen: tuple[Mistake, ...], which: int) -> Mistake:
    """A clock mistake with the shift and rate error that explain best, in place of the nearest ones tried."""
    m = chosen[which]
    if not m.clock:
        return m
    (reading, *_) = m.correction.readings.values()

    def cost(clock: np.ndarray) -> float:
        tried = m.with_clock(FIRST_CLOCK_SHIFT_STEP_SECONDS * clock[0], FIRST_CLOCK_RATE_ERROR_STEP * clock[1])
        return -run.log_evidence(_corrected([*chosen[:which], tried, *chosen[which + 1 :]]), AS_DESCRIBED).value

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


def mistake_checks(run: ComparedRun, mistakes: Callable[[ComparedRun], Iterator[Mistake]]) -> Iterator[Check]:
    """Findings on mistakes in a recording, from its comparison with the model."""
    for found in find_mistakes(run, mistakes):
        m, certain = found.mistake, found.certain
        lead = f"{rounded(found.log_odds_over_next_best)} more than anything else"
        sure = f"{rounded(found.log_odds_over_unchanged)} nats more probable than as it stands, {lead}"
        rival = "" if found.rival is None else f", or {found.rival.in_words}: this recording does not tell which"
        remedy = f"armdyn inspect {MODEL_PLACEHOLDER} {run.run.source or run.run.name} --fix fixed"
        remedy = remedy if found.correction else "record a motion that tells, or ask who made the recording"
        yield Check(
            m.kind, Severity.WRONG if certain else Severity.SUSPECT, run.run.name, m.channels,
            f"{'' if certain else 'perhaps '}{m.in_words}{rival} ({sure})", m.remedy or remedy,
            evidence=found.log_odds_over_next_best, correction=found.correction,
        )  # fmt: skip
