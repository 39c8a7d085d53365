"""Effects that may be missing, best first, each with what it would explain alone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from armdyn.identify.appraisal import Appraisal, Appraiser
from armdyn.identify.candidate import Candidate
from armdyn.identify.choose import backward_elimination
from armdyn.identify.compare import FittedParameter
from armdyn.identify.repair_path import merged

MOST_NAMED = 8


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
    parameters: dict[str, FittedParameter]
    tied_with: tuple[str, ...]


def suspects(appraiser: Appraiser, first: Sequence[Candidate], tied: Sequence[Candidate]) -> tuple[Suspect, ...]:
    """Every effect, on the joints that need it, beside the model as given.

    Args:
        appraiser: around the fit of the model as given.
        first: the effect that a search found first, on one joint each; it leads. Empty where it found none.
        tied: effects that these runs cannot tell from it.
    """
    nothing = appraiser.of(())
    found = [appraiser.of(first)] if first else []
    contenders = appraiser.contenders(nothing)
    for name in dict.fromkeys(c.effect for c in contenders):
        if not first or name != first[0].effect:
            found.append(_alone(appraiser, [c for c in contenders if c.effect == name], nothing))
    leading = found[:1] if first else []
    worth = [one for one in found[len(leading) :] if one.effects and one.worth > nothing.worth]
    rest = sorted(worth, key=lambda one: -one.worth)
    names = [c.effect for c in tied]
    described = []
    for one in (*leading, *rest)[:MOST_NAMED]:
        mine = merged(one.effects)[0]
        others = tuple(names) if one in leading else tuple(c.effect for c in first) if mine.effect in names else ()
        described.append(_described(appraiser, one, mine, nothing, tuple(dict.fromkeys(others))))
    return tuple(described)


def _alone(appraiser: Appraiser, joints: Sequence[Candidate], nothing: Appraisal) -> Appraisal:
    """An effect on all joints that need it, or on the best one."""
    several = backward_elimination(appraiser, appraiser.of(joints))
    single = max((appraiser.of([c]) for c in joints), key=lambda one: one.worth)
    return max((several, single), key=lambda one: one.worth if one.effects else nothing.worth)


def _described(
    appraiser: Appraiser, one: Appraisal, named: Candidate, nothing: Appraisal, tied: tuple[str, ...]
) -> Suspect:
    s, p = appraiser.sums, appraiser.sums.problem
    values, deviations = appraiser.values(one), appraiser.deviations(one)
    own = np.flatnonzero(p.of(named.names))
    drop = 2.0 * (one.likelihood - nothing.likelihood)
    predicted = np.concatenate(
        [np.zeros(0, dtype=int), *(np.flatnonzero(s.run == r) for r in appraiser.predicted_runs)]
    )
    return Suspect(
        effect=named.effect,
        joints=named.joints,
        delta_bic=2.0 * (one.worth - nothing.worth),
        p_value=min(1.0, len(appraiser.candidates) * float(chi2_distribution.sf(max(drop, 0.0), max(len(own), 1)))),
        rmse=_by_channel(appraiser, np.flatnonzero(s.training), one.errors),
        held_out_rmse=_by_channel(appraiser, predicted, one.predicted) if len(one.predicted) else {},
        parameters={
            c.name: FittedParameter(float(values[i]), float(deviations[i]), c.parameter.unit, True)
            for i in own
            for c in [p.columns[i]]
        },
        tied_with=tied,
    )


def _by_channel(appraiser: Appraiser, units: np.ndarray, errors: np.ndarray) -> dict[str, float]:
    """Rms error of every channel over units with (u,) mean squared errors."""
    s = appraiser.sums
    result = {}
    for channel, name in enumerate(s.channels):
        mine = s.channel[units] == channel
        if mine.any():
            result[name] = float(np.sqrt(np.average(errors[mine], weights=s.count[units][mine])))
    return result
