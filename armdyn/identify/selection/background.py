"""The background of an arm: small values of effects of which no run is sure, with one common prior width.

Effects of which the runs are sure have a name and are fitted freely. Every other effect of the catalogue on every joint
may have parameters x, in typical sizes, with a prior x ~ N(0, s^2). The common width s is chosen by predicting motions
to which the model was not fitted (ridge regression with the penalty chosen by cross-validation; Hoerl & Kennard,
Technometrics 12, 1970); where no width predicts them better, there is no background.
"""

from collections.abc import Sequence

from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.linear_scorer import LinearScorer


def background_widths(scorer: LinearScorer, effects: Sequence[Candidate]) -> list[float]:
    """Prior widths of small values with which other motions are predicted clearly better, the best first.

    Args:
        scorer: scorer of sets, linearised at the fit with the named effects.
        effects: the named effects.
    """
    search = scorer.settings.search
    alone = scorer.prediction_log_likelihood(scorer.prior_widths(effects, 0.0))
    gains = {
        width: scorer.prediction_log_likelihood(scorer.prior_widths(effects, width)) - alone
        for width in search.background_widths
    }
    return sorted((width for width, gain in gains.items() if gain > search.background_nats), key=lambda w: -gains[w])


def sure_unnamed_effects(scorer: LinearScorer, effects: Sequence[Candidate], width: float) -> list[Candidate]:
    """Effects without a name without which a model with a background would predict other motions worse.

    Worse means by `SearchSettings.acceptance_nats`: the runs are sure of such an effect, so that it needs a name.

    Args:
        scorer: scorer of sets, linearised at the fit with the named effects.
        effects: the named effects.
        width: prior width of the background.
    """
    whole = scorer.prior_widths(effects, width)
    best = scorer.prediction_log_likelihood(whole)

    def loss(one: Candidate) -> float:
        without = whole.copy()
        without[scorer.positions[one]] = 0.0
        return best - scorer.prediction_log_likelihood(without)

    return [
        one
        for one in scorer.searched_effects
        if one not in effects and loss(one) > scorer.settings.search.acceptance_nats
    ]
