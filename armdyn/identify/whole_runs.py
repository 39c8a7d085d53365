"""Compare sets of effects by the residual of whole simulated runs, in addition to their evidence with process noise.

Process noise absorbs errors that add up over many swings. So where the residual is far above the sensor's noise, a
wrong friction may have the better evidence. Then the residuals of whole runs, fitted and held-out ones, are compared as
well: for one or two effects alone, for every effect exchanged for another, and for one more effect. Effects whose
values are zero at the end, or that increase the error of held-out runs, are removed.
"""

from collections.abc import Callable, Sequence
from itertools import combinations, islice

import numpy as np
from scipy.special import chdtri

from armdyn.estimation.posterior import wald_distance
from armdyn.estimation.solve import solve_positive
from armdyn.identify.fit import Fit, fit
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.set_score import EffectSetScore
from armdyn.identify.state_space.scorer import StateSpaceScorer
from armdyn.identify.state_space.study import StateSpaceStudy
from armdyn.identify.uncertainty import uncertainty

EFFECTS_COMPARED_OVER_WHOLE_RUNS, EFFECTS_COMPARED_IN_PAIRS = 12, 6
"""Number of effects, those with the best evidence, that are compared alone over whole runs, and number of those (with
the smallest residual) of which pairs are compared."""
FORETOLD_SETS_FITTED = 3
"""Number of sets, those for which linearised whole runs foretell the smallest residual, that are fitted, and of effects
alone, those with the smallest residual of a quick fit, that are fitted from the likeliest other start values too. On
two public recordings of pendulums the best of 15 pairs was the first or the second one; four more answer as before."""
RIVALS_TRIED_PER_EFFECT = 2
"""Number of other effects, those with the best evidence, that are tried in place of each effect of a set."""

STEPS_WITHOUT_EFFECT = 6
"""Number of steps of a fit without an effect whose values may be zero, from where its linearisation expects it."""

Effects = tuple[Candidate, ...]


def improve_effect_set_by_run_errors(
    study: StateSpaceStudy, scorer: StateSpaceScorer, whole: EffectSetScore, say: Callable[[str], None]
) -> EffectSetScore:
    """Improve a set of effects that was chosen by evidence: whole runs may show a set with a clearly smaller residual.

    Args:
        study: runs and catalogue.
        scorer: scorer of sets by evidence.
        whole: the set with the best evidence.
        say: called with a text on the progress.

    Returns:
        The set, without effects that whole runs show to be absent.
    """
    effects, found = whole.effects, _fitted(study, whole.effects)
    if scorer.candidates and np.any(study.excess(found) > study.settings.search.compared_excess):
        gross = found.chi2_per_sample > study.settings.noise.gross_chi2
        effects = _pair_or(study, scorer, effects, gross, say)
        say("comparing rivals over whole runs")
        effects = _exchanged(study, scorer, effects)
        say("comparing further effects over whole runs")
        effects = _added(study, scorer, effects)
    return scorer.optimise(_without_nothing(study, effects))


def _fitted(study: StateSpaceStudy, effects: Effects) -> Fit:
    return study.fit_base_with_effects((*study.present, *effects))


def _left_quickly(study: StateSpaceStudy, effects: Effects) -> float:
    """Residual of a set, from a quick fit."""
    return study.left((*study.present, *effects))


def _left(study: StateSpaceStudy, effects: Effects) -> float:
    """Residual of a set; of an effect alone, where values are guesses, also from the likeliest other start values."""
    left = _left_quickly(study, effects)
    if len(effects) == 1 and study.model.guessed_parameters:
        left = min(left, study.squared_error(_fitted(study, effects)))
    return left


def _excess(study: StateSpaceStudy, effects: Effects) -> np.ndarray:
    """Squared error above the noise by kind of runs, of a quick fit of a set; see `Study.excess`."""
    return study.excess(study.quick_fit((*study.present, *effects)))


def _value_count(effects: Effects) -> int:
    return sum(len(c.names) for c in effects)


def _pair_or(
    study: StateSpaceStudy, scorer: StateSpaceScorer, whole: Effects, gross: bool, say: Callable[[str], None]
) -> Effects:
    """A set, or one of one or two effects with a clearly smaller residual of whole runs.

    Where errors are gross, the residual alone decides: each value that one has more must explain its share of it.
    """

    def compared(sets: Sequence[Effects], left: Callable[[StateSpaceStudy, Effects], float]) -> list[Effects]:
        for k, one in enumerate(sets):
            say(f"{k} of {len(sets)} sets compared over whole runs, now {', '.join(c.name_in_sentence for c in one)}")
            left(study, one)  # which is kept
        return sorted(sets, key=lambda one: left(study, one))

    scorer.optimise(())
    promised = sorted(scorer.candidates, key=lambda c: -scorer.evaluate((c,)).score)[:EFFECTS_COMPARED_OVER_WHOLE_RUNS]
    alone = compared([(c,) for c in promised], _left_quickly)[:EFFECTS_COMPARED_IN_PAIRS]
    each = [c for (c,) in alone]
    foretold = {c: study.foretold_costs((*study.present, c), [o for o in each if o is not c]) for c in each}
    pairs = sorted(combinations(each, 2), key=lambda pair: min(foretold[a][b] for a, b in (pair, pair[::-1])))
    nothing = scorer.evaluate(()).score
    gains = {c: scorer.evaluate((c,)).score - nothing for c in each}
    near = study.settings.search.missing_evidence_share * max(gains.values(), default=0.0)

    def left(study: StateSpaceStudy, one: Effects) -> float:
        """Residual of a set; an effect alone whose evidence is far from the best is not searched from other starts."""
        return _left_quickly(study, one) if len(one) == 1 and gains[one[0]] < near else _left(study, one)

    sets = compared([*alone[:FORETOLD_SETS_FITTED], *pairs[:FORETOLD_SETS_FITTED]], left)
    best = min(sets, key=lambda one: left(study, one) / study.settings.search.needed_share(len(one)))
    if not gross:
        share = study.settings.search.pair_residual_ratio
        share *= study.settings.search.needed_share(max(len(best) - len(whole), 0))
        return best if _left(study, best) < share * _left(study, whole) else whole
    more = _value_count(best) - _value_count(whole)
    if more < 0:
        return whole if _explains(study, best, whole) else best
    share = study.settings.search.needed_share(max(more, 1))
    return best if np.all(_excess(study, best) < share * _excess(study, whole)) else whole


def _exchanged(study: StateSpaceStudy, scorer: StateSpaceScorer, whole: Effects) -> Effects:
    """A set with effects exchanged for others with no more values and a clearly smaller residual of every kind of runs.

    Both sides of a tie are tried: evidence that is equal, or better for the larger residual, does not decide.
    """
    refused = {frozenset(whole)}
    while True:
        now = scorer.optimise(whole)
        most = _excess(study, whole)
        options = list[Effects]()
        for gone in whole:
            rest = tuple(c for c in whole if c != gone)
            rivals = [c for c in scorer.candidates if c not in whole and len(c.names) <= len(gone.names)]
            sets = [scorer.evaluate((*rest, c)) for c in rivals]
            least = now.score - study.settings.search.missing_evidence_share * (now.score - scorer.evaluate(rest).score)
            near = sorted((one for one in sets if one.score > least), key=lambda one: -one.score)[
                :RIVALS_TRIED_PER_EFFECT
            ]
            options += [one.effects for one in near if frozenset(one.effects) not in refused]
        refused |= {frozenset(one) for one in options}
        left = {one: _excess(study, one) for one in options}
        better = [one for one in options if np.all(left[one] < study.settings.search.needed_share(1) * most)]
        if not better:
            return whole
        whole = min(better, key=lambda one: float(left[one].sum()))


def _added(study: StateSpaceStudy, scorer: StateSpaceScorer, whole: Effects) -> Effects:
    """A set, extended by one effect at a time while errors are gross and the residual of whole runs falls enough."""
    while _fitted(study, whole).chi2_per_sample > study.settings.noise.gross_chi2:
        now = scorer.optimise(whole)
        left = [c for c in scorer.candidates if c not in whole]
        promised = sorted(left, key=lambda c: -scorer.evaluate((*now.effects, c)).score)[:EFFECTS_COMPARED_IN_PAIRS]
        foretold = study.foretold_costs((*study.present, *whole), promised)
        promised = sorted(promised, key=lambda c: foretold[c])[:FORETOLD_SETS_FITTED]
        sets = [one for one in ((*whole, c) for c in promised) if _explains(study, whole, one)]
        if not sets:
            return whole
        whole = min(sets, key=lambda one: _left(study, one) / study.settings.search.needed_share(len(one[-1].names)))
    return whole


def _without_nothing(study: StateSpaceStudy, effects: Effects) -> Effects:
    """A set without effects whose values are zero or at their physical bounds, or that harm held-out runs.

    The error may be clearly larger without such an effect: a gravity 0.1 % off looks like a gripper's scale.
    """
    while True:
        found = _fitted(study, effects)
        useless = tuple(c for c in effects if np.all(_distance(found, c) == 0.0))  # replaced by a later effect
        unsure = [c for c in effects if c.effect not in study.asked]
        effects = tuple(c for c in effects if c not in useless)
        if useless:
            continue
        ends = set(found.at_bound)  # the runs want more of it than there can be: what they show is something else
        gone = [c for c in unsure if not ends.isdisjoint(c.names) or _is_nothing(study, found, effects, c)]
        gone = gone or list(islice((c for c in unsure if _harms(study, found, effects, c)), 1))
        if not gone:
            return effects
        # Of two effects that hide each other, both are uncertain until one is removed.
        rests = [tuple(c for c in effects if c is not one) for one in gone]
        effects = min(rests, key=lambda rest: _left(study, rest)) if len(rests) > 1 else rests[0]


def _harms(study: StateSpaceStudy, found: Fit, effects: Effects, one: Candidate) -> bool:
    """Whether held-out runs are predicted better without an effect."""
    if not study.held_out:
        return False
    before, after = study.excess(found), _excess(study, tuple(c for c in effects if c is not one))
    return bool(before[1] + 1.0 > (1.0 + study.settings.search.held_out_error_increase) ** 2 * (after[1] + 1.0))


def _distance(found: Fit, one: Candidate) -> np.ndarray:
    """(k,) distance of an effect's fitted values from those at which it is absent."""
    own = found.problem.mask_of_unknowns(one.names) & found.free
    return found.values[own] - found.problem.null[own]


def _is_nothing(study: StateSpaceStudy, found: Fit, effects: Effects, one: Candidate) -> bool:
    """Whether an effect's values are within two standard deviations of those at which it is absent (Wald 1943).

    The others, which move along with it, must really allow it: of a circuit of which only voltages are measured all
    values are uncertain together, but a leak is none the less there.

    The test does not hold for an effect with a place, on which nothing depends where the effect is absent (Davies,
    Biometrika 64, 1977): such an effect is absent only if the residual of whole runs is as small without it, too.
    """
    own = found.problem.mask_of_unknowns(one.names) & found.free
    certain, away = uncertainty(study, found), _distance(found, one)
    whole = certain.covariance
    covariance = whole[np.ix_(own, own)]
    known = np.diag(covariance) > 0.0
    if not known.any():
        return False  # a bound holds it
    square = wald_distance(away, covariance) ** 2
    limit = chdtri(int(known.sum()), study.settings.search.zero_probability)
    if square >= limit:
        return False
    there = np.where(own, found.problem.null, found.values - whole[:, own] @ solve_positive(covariance, away))
    if _rise(found, own, there) > certain.std_inflation**2 * limit:
        return False
    placed = not study.motion.threshold_values.keys().isdisjoint(one.names)
    return not (placed and _explains(study, tuple(c for c in effects if c is not one), effects))


def _rise(found: Fit, own: np.ndarray, values: np.ndarray) -> float:
    """Rise of the cost of a fit without its unknowns (P,) `own`, where others are fitted anew from (P,) `values`."""
    problem = found.problem
    values = np.clip(values, problem.lower, problem.upper)
    return fit(problem, found.free & ~own, values, most_steps=STEPS_WITHOUT_EFFECT).cost - found.cost


def _explains(study: StateSpaceStudy, fewer: Effects, more: Effects) -> bool:
    """Whether each value of the larger set explains the needed share of the smaller's residual."""
    share = study.settings.search.needed_share(_value_count(more) - _value_count(fewer))
    return _left(study, more) < share * _left(study, fewer)
