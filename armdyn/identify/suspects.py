"""A chosen set of effects as a reader takes it in, the biggest first; and effects that may be missing, best first."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from armdyn.identify.appraisal import Appraisal, Appraiser
from armdyn.identify.candidate import Candidate, merged
from armdyn.identify.select_effects import by_effect, eliminate
from armdyn.parameter import Parameter


@dataclass(frozen=True)
class OrderedStep:
    """One step from a smaller set to a larger one.

    Attributes:
        added: the effect, with all joints that it comes on.
        appraisal: of the set with it.
    """

    added: Candidate
    appraisal: Appraisal


def ordered_steps(appraiser: Appraiser, effects: Sequence[Candidate], firm: Sequence[Candidate]) -> list[OrderedStep]:
    """The way from the effects `firm` to all of `effects`, each on all its joints at once, what explains most first."""
    now, left = appraiser.of(firm), by_effect([c for c in effects if c not in firm])
    found = list[OrderedStep]()
    while left:
        now = appraiser.told_next(now, left)
        first = next(own for own in left if set(own) <= set(now.effects))
        found.append(OrderedStep(merged(first)[0], now))
        left.remove(first)
    return found


def tied(appraiser: Appraiser, whole: Appraisal, part: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Effects on the same joints that fit and predict as well in the place of `part`, each as free as it really is.

    A richer effect that does the same with its further unknowns is no rival; on a slide, where a link has but one
    unknown that matters, it is.
    """
    rest = [c for c in whole.effects if c not in part]
    joints = {j for c in part for j in c.joints}
    found = []
    without = appraiser.of(rest)
    plausible_effects = appraiser.candidates
    for name in dict.fromkeys(c.effect for c in plausible_effects if c.effect != part[0].effect):
        others = [c for c in plausible_effects if c.effect == name and set(c.joints) <= joints]
        if any(c in rest for c in others) or len(others) < len(part):
            continue
        other = appraiser.of((*rest, *others))
        if not (np.isfinite(other.worth) and appraiser.standing(other) > appraiser.standing(without)):
            continue  # it explains nothing, nor does much of what it would stand for
        if appraiser.ties(whole, other, without):
            found.append(merged(others)[0])
    return tuple(found)


@dataclass(frozen=True)
class Suspect:
    """One effect that may be missing.

    Attributes:
        effect: its name.
        joints: where, for an arm.
        delta_bic: evidence without it less evidence with it, on the scale of BIC; larger is better.
        p_value: of it being superfluous, times the number of effects tried.
        rmse: by channel, with the effect.
        held_out_rmse: likewise on runs predicted from others; empty where there are none.
        parameters: of the effect.
        tied_with: effects that these runs cannot tell from it.
    """

    effect: str
    joints: tuple[str, ...]
    delta_bic: float
    p_value: float
    rmse: dict[str, float]
    held_out_rmse: dict[str, float]
    parameters: dict[str, Parameter]
    tied_with: tuple[str, ...]


def suspects(appraiser: Appraiser, first: Sequence[Candidate], tied: Sequence[Candidate]) -> tuple[Suspect, ...]:
    """Every effect, on the joints that need it, beside the model as given.

    Args:
        appraiser: around the fit of the model as given.
        first: the effect that a search found first, on one joint each; it leads. Empty where it found none.
        tied: effects that these runs cannot tell from it.
    """
    nothing = appraiser.of(appraiser.given)
    found = [appraiser.of((*appraiser.given, *first))] if first else []
    plausible_effects = [c for c in appraiser.candidates if c not in appraiser.given]
    for name in dict.fromkeys(c.effect for c in plausible_effects):
        if not first or name != first[0].effect:
            found.append(_alone(appraiser, [c for c in plausible_effects if c.effect == name], nothing))
    leading = found[:1] if first else []
    worth = [one for one in found[len(leading) :] if one.worth > nothing.worth]
    rest = sorted(worth, key=lambda one: -one.worth)
    names = [c.effect for c in tied]
    described = []
    for one in (*leading, *rest)[: appraiser.most_named]:
        mine = merged([c for c in one.effects if c not in appraiser.given])[0]
        others = tuple(names) if one in leading else tuple(c.effect for c in first) if mine.effect in names else ()
        described.append(_described(appraiser, one, mine, nothing, tuple(dict.fromkeys(others))))
    return tuple(described)


def _alone(appraiser: Appraiser, joints: Sequence[Candidate], nothing: Appraisal) -> Appraisal:
    """An effect on all joints that need it, or on the best one."""
    given = appraiser.given
    several = eliminate(appraiser, lambda one: -one.worth, appraiser.of((*given, *joints)))
    single = max((appraiser.of((*given, c)) for c in joints), key=lambda one: one.worth)
    return max((several, single, nothing), key=lambda one: one.worth)


def _described(
    appraiser: Appraiser, one: Appraisal, named: Candidate, nothing: Appraisal, tied: tuple[str, ...]
) -> Suspect:
    p = appraiser.problem
    own = np.flatnonzero(p.of(named.names))
    rmse, held_out_rmse = appraiser.errors_by_channel(one)
    values, deviations = appraiser.fitted(one)
    drop = 2.0 * (one.likelihood - nothing.likelihood)
    return Suspect(
        effect=named.effect,
        joints=named.joints,
        delta_bic=2.0 * (one.worth - nothing.worth),
        p_value=min(1.0, len(appraiser.candidates) * float(chdtrc(max(len(own), 1), max(drop, 0.0)))),
        rmse=rmse,
        held_out_rmse=held_out_rmse,
        parameters={
            c.name: replace(c.parameter, value=float(values[i]), std=float(deviations[i]), fitted=True)
            for i, c in ((i, p.columns[i]) for i in own)
        },
        tied_with=tied,
    )
