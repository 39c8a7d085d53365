"""Order a chosen set of effects by importance, and rank the effects that may be missing."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from armdyn.identify.selection.candidate import Candidate, group_by_effect
from armdyn.identify.selection.select_effects import eliminate, group_joints_by_effect
from armdyn.identify.selection.set_score import EffectSetScore, EffectSetScorer
from armdyn.parameter import Parameter


def order_by_gain(
    scorer: EffectSetScorer, effects: Sequence[Candidate], fixed_effects: Sequence[Candidate]
) -> list[tuple[Candidate, EffectSetScore]]:
    """Order effects by how much of the error they explain, the most important first.

    Args:
        scorer: scorer of sets.
        effects: effects to order, each on one joint. The joints of one effect are added together; for an arm those
            that explain much come before the others.
        fixed_effects: effects that are present from the start.

    Returns:
        Each effect, with all its joints, and the set with it and those before it.
    """
    now, found = scorer.evaluate(fixed_effects), list[tuple[Candidate, EffectSetScore]]()
    wanted = [c for c in effects if c not in fixed_effects]
    leading = scorer.leading_effects(now, wanted)
    left = group_joints_by_effect([c for c in wanted if c not in leading])
    for first in group_joints_by_effect(leading):
        now = scorer.evaluate((*now.effects, *first))
        found.append((group_by_effect(first)[0], now))
    while left:
        now = scorer.set_with_next_reported_effect(now, left)
        first = next(own for own in left if set(own) <= set(now.effects))
        found.append((group_by_effect(first)[0], now))
        left.remove(first)
    return found


def tied_effects(scorer: EffectSetScorer, whole: EffectSetScore, part: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Find effects that fit and predict as well in place of a part of a set, so that these runs cannot tell them apart.

    An effect that needs more parameters than the part is penalised for those that have influence.

    Args:
        scorer: scorer of sets.
        whole: the set.
        part: effects of the set, each on one joint, that are replaced. On an arm, replacements act on the same joints.
    """
    rest = [c for c in whole.effects if c not in part]
    joints = {j for c in part for j in c.joints}
    found = []
    without = scorer.evaluate(rest)
    here = [c for c in scorer.searched_effects if c.effect != part[0].effect and set(c.joints) <= joints]
    for others in (*group_joints_by_effect(here), *scorer.effects_on_other_states(whole, rest, part)):
        if any(c in rest for c in others) or len(others) < len(part):
            continue
        other = scorer.evaluate((*rest, *others))
        if not (
            np.isfinite(other.score) and scorer.schwarz_criterion_nats(other) > scorer.schwarz_criterion_nats(without)
        ):
            continue  # it explains nothing, or little of what it would replace
        if scorer.ties(whole, other, without):
            found.append(group_by_effect(others)[0])
    return tuple(found)


def name_tied_effect(rival: Candidate, added: Sequence[Candidate]) -> str:
    """Name of an effect that is tied with those added; with its state where it acts on another one."""
    return rival.effect if set(rival.joints) <= {j for c in added for j in c.joints} else rival.label


@dataclass(frozen=True)
class RankedEffect:
    """One effect that may be missing, with its evidence.

    Attributes:
        effect: name of the effect.
        joints: joints on which it acts, for an arm.
        delta_bic: evidence for the effect, on the scale of a difference of BIC; 10 is strong.
        p_value: probability that a superfluous effect lowers chi2 as much by chance, times the number of effects tried.
        rmse: root mean square error by channel with the effect, on the training runs.
        held_out_rmse: root mean square error by channel on runs predicted from others; empty where there are none.
        parameters: fitted parameters of the effect.
        tied_with: effects that these runs cannot distinguish from it.
    """

    effect: str
    joints: tuple[str, ...]
    delta_bic: float
    p_value: float
    rmse: dict[str, float]
    held_out_rmse: dict[str, float]
    parameters: dict[str, Parameter]
    tied_with: tuple[str, ...]


def rank_effects(
    scorer: EffectSetScorer, first: Sequence[Candidate], tied: Sequence[Candidate]
) -> tuple[RankedEffect, ...]:
    """Rank every effect, on the joints that need it, when added alone to the model as given.

    Args:
        scorer: scorer at the fit of the model as given.
        first: the effect that a search found first, as candidates on one joint each; it is ranked first. Empty where
            the search found none.
        tied: effects that these runs cannot distinguish from `first`.
    """
    nothing = scorer.evaluate(scorer.given)
    found = [scorer.evaluate((*scorer.given, *first))] if first else []
    plausible_effects = scorer.addable(nothing)
    for name in dict.fromkeys(c.effect for c in plausible_effects):
        if not first or name != first[0].effect:
            found.append(_alone(scorer, [c for c in plausible_effects if c.effect == name], nothing))
    leading = found[:1] if first else []
    worth = [one for one in found[len(leading) :] if one.score > nothing.score]
    rest = sorted(worth, key=lambda one: -one.score)
    names = [name_tied_effect(c, first) for c in tied]
    described = []
    for one in (*leading, *rest)[: scorer.max_ranked_effects]:
        mine = group_by_effect(scorer.removable(one))[0]
        others = tuple(names) if one in leading else tuple(c.effect for c in first) if mine.effect in names else ()
        described.append(_described(scorer, one, mine, nothing, tuple(dict.fromkeys(others))))
    return tuple(described)


def _alone(scorer: EffectSetScorer, joints: Sequence[Candidate], nothing: EffectSetScore) -> EffectSetScore:
    """An effect on all joints that need it, or on the best one."""
    given = scorer.given
    several = eliminate(scorer, scorer.evaluate((*given, *joints)))
    single = max((scorer.evaluate((*given, c)) for c in joints), key=lambda one: one.score)
    return max((several, single, nothing), key=lambda one: one.score)


def _described(
    scorer: EffectSetScorer, one: EffectSetScore, named: Candidate, nothing: EffectSetScore, tied: tuple[str, ...]
) -> RankedEffect:
    p = scorer.problem
    own = np.flatnonzero(p.mask_of_unknowns(named.names))
    rmse, held_out_rmse = scorer.rmse_by_channel(one)
    values, deviations = scorer.fitted_values(one)
    drop = 2.0 * (one.likelihood - nothing.likelihood)
    return RankedEffect(
        effect=named.effect,
        joints=named.joints,
        delta_bic=2.0 * (one.score - nothing.score),
        p_value=min(1.0, len(scorer.candidates) * float(chdtrc(max(len(own), 1), max(drop, 0.0)))),
        rmse=rmse,
        held_out_rmse=held_out_rmse,
        parameters={
            c.name: replace(c.parameter, value=float(values[i]), std=float(deviations[i]), fitted=True)
            for i, c in ((i, p.columns[i]) for i in own)
        },
        tied_with=tied,
    )
