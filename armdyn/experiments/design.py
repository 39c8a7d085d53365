r"""The motion of the gripper that tells rivals apart best.

Maximised is the smallest separation, over every ordered pair of hypotheses, of what one predicts from what the other
can be refitted to, within the limits of gripper and swing. At the minimum over the rival's unknowns its derivatives
with respect to them vanish, so that (envelope theorem; Milgrom & Segal, Econometrica 70, 2002)

    d lambda / dc = 2 r' (dy_H/dc - dy_R/dc),      r = y_H - y_R at the refit,

is exact with one reverse pass through each model, for any number of coefficients c. From the best of many random
motions it climbs by L-BFGS (Nocedal & Wright, Numerical Optimization, §7.2).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from armdyn.experiments.hypothesis import Experiment, Held, Hypothesis
from armdyn.experiments.motion import Harmonics, Limits, Motion
from armdyn.experiments.separation import Rival, linear_separation

TRIED = 24
"""Random motions, of which the best are carried on."""
CARRIED_ON = 2
FIRST, THEN = 16, 60
"""Evaluations of the cost from each start with two hypotheses, and then from the better end; more hypotheses share
these numbers."""
SHARPNESS = 4.0
"""Of the smooth minimum over pairs of the logarithm of the separation."""
PENALTY = 1000.0
"""Per mean squared share beyond a limit."""
COARSE = 0.02
"""s between the nodes while it climbs; the outcome is computed with `STEP`."""
REFIT_STEPS = 2
"""Of a rival at every motion: it starts where it was at the one before."""
HARDEST = 4
"""Pairs that a motion is designed for, of those that the start separates least."""
BLIND = 0.05
"""Rise of chi2 that the best of the random motions reaches of a pair that no motion separates: design gains a factor of
10 to 1000, the pairs that can be separated start at 0.3."""
LEAST = 1e-6
"""Added to a rise of chi2: pairs that no motion separates have a logarithm."""
NEGLIGIBLE = 5e-4
"""Share in the smooth minimum below which a pair's slope is left out: it takes a reverse pass."""
LOST = 1e6
"""Cost of a motion along which a model cannot be integrated: beyond any that can be."""
SHRINK = 0.98
"""Factor by which a motion that swings the load too far is made smaller, again and again."""

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Designed:
    """A designed motion.

    Attributes:
        motion: within the limits.
        coefficients: (n,) of it.
        rise: smallest rise of chi2 over all ordered pairs.
        start: the same for the median of the random motions that were tried, by linearisation.
        evaluations: of the cost.
    """

    motion: Motion
    coefficients: np.ndarray
    rise: float
    start: float
    evaluations: int


class _Cost:
    """What is minimised: less the smooth minimum of the logarithm of the separations, and what is beyond the limits."""

    def __init__(self, helds: Sequence[Held], pairs: Sequence[tuple[int, int]], harmonics: Harmonics) -> None:
        self._helds, self._pairs, self._harmonics = helds, pairs, harmonics
        self._values = {pair: helds[pair[1]].start for pair in pairs}
        self.evaluations = 0

    def __call__(self, coefficients: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost and its gradient (n,)."""
        self.evaluations += 1
        h, motion = self._harmonics, self._harmonics.motion(coefficients)
        helds = [held.along(motion) for held in self._helds]
        truths = [held.predict(held.start)[0] for held in helds]
        rises, rests = np.empty(len(self._pairs)), []
        for k, (i, j) in enumerate(self._pairs):
            rises[k], values = Rival(helds[j], truths[i]).refitted(self._values[i, j], REFIT_STEPS)
            self._values[i, j] = values
            rests.append(truths[i] - helds[j].predict(values)[0])
        logs = np.log(rises + LEAST)
        shares = np.exp(-SHARPNESS * (logs - logs.min()))
        smallest = float(logs.min() - np.log(shares.sum()) / SHARPNESS)
        shares /= shares.sum()
        weights = shares * 2.0 / (rises + LEAST)
        beyond, slope = h.excess(coefficients)
        cost, gradient = PENALTY * beyond - smallest, PENALTY * slope
        for i, held in enumerate(helds):
            rest = np.zeros(len(truths[i]))
            for weight, left, (truth, _) in zip(weights, rests, self._pairs, strict=True):
                if truth == i:
                    rest -= weight * left
            swing = held.swing(held.start) / h.limits.swing
            over = np.maximum(np.abs(swing) - 1.0, 0.0)
            cost += PENALTY * float(np.mean(over**2))
            push = PENALTY * 2.0 * over * np.sign(swing) / h.limits.swing / len(swing)
            if rest.any() or push.any():
                gradient = gradient + held.by_coefficients(held.start, h, rest, push)
        for share, weight, left, (i, j) in zip(shares, weights, rests, self._pairs, strict=True):
            if share > NEGLIGIBLE:
                gradient = gradient + helds[j].by_coefficients(self._values[i, j], h, weight * left)
        if not (np.isfinite(cost) and np.all(np.isfinite(gradient))):
            return LOST, np.zeros(len(coefficients))
        return cost, gradient


def designed(
    hypotheses: Sequence[Hypothesis],
    experiment: Experiment,
    seconds: float,
    limits: Limits | None = None,
    seed: int = 0,
    say: Say | None = None,
) -> Designed:
    """The motion that makes the smallest separation of any two hypotheses largest.

    Args:
        hypotheses: two or more.
        experiment: what is measured; its motion is replaced.
        seconds: duration of the motion.
        limits: of gripper and swing.
        seed: of the random motions.
        say: told how far it is.
    """
    tell = say or (lambda _: None)
    harmonics = Harmonics(seconds, limits or Limits(), COARSE)
    fine = Harmonics(seconds, harmonics.limits)
    rng = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(len(hypotheses)) for j in range(len(hypotheses)) if i != j]
    first = harmonics.motion(np.zeros(harmonics.size))
    helds = [Held(h, experiment.along(first)) for h in hypotheses]
    tried = []
    for number in range(TRIED):
        tell(f"{number} of {TRIED} motions tried")
        c = within_swing(helds, harmonics, harmonics.random(rng))
        here = [held.along(harmonics.motion(c)) for held in helds]
        tried.append((np.array([linear_separation(here[i], here[j]) for i, j in pairs]), c))
    # A pair that none of them separates is left to other experiments, unless there is no other pair.
    widest = np.max([rises for rises, _ in tried], axis=0)
    apart = {frozenset(pair): 0.0 for pair in pairs}
    for pair, rise in zip(pairs, widest, strict=True):
        apart[frozenset(pair)] = max(apart[frozenset(pair)], float(rise))
    wanted = [k for k, pair in enumerate(pairs) if apart[frozenset(pair)] > BLIND]
    if wanted:
        pairs, tried = [pairs[k] for k in wanted], [(rises[wanted], c) for rises, c in tried]
    tried.sort(key=lambda one: -float(one[0].min()))
    share = 2.0 / min(len(pairs), HARDEST)
    spent, ends = 0, []
    for number, (rises, c) in enumerate(tried[:CARRIED_ON]):
        tell(f"motion {number + 1} of {CARRIED_ON} climbs")
        hardest = [pairs[k] for k in np.argsort(rises)[:HARDEST]]
        cost = _Cost(helds, hardest, harmonics)
        ends.append((_climbed(cost, c, round(FIRST * share)), cost))
        spent += cost.evaluations
    tell("the best motion climbs")
    (_, c), cost = min(ends, key=lambda end: end[0][0])
    before = cost.evaluations
    _, c = _climbed(cost, c, round(THEN * share))
    c = within_swing(helds, fine, fine.within(c))
    motion = fine.motion(c)
    here = [held.along(motion) for held in helds]
    rise = min(Rival(here[j], here[i].predict(here[i].start)[0]).refitted()[0] for i, j in pairs)
    middle = float(np.median([rises.min() for rises, _ in tried]))
    return Designed(motion, c, rise, middle, spent + cost.evaluations - before)


def _climbed(cost: _Cost, start: np.ndarray, evaluations: int) -> tuple[float, np.ndarray]:
    """Cost and coefficients (n,) after some evaluations."""
    found = minimize(cost, start, jac=True, method="L-BFGS-B", options={"maxfun": max(evaluations, 8), "maxcor": 20})
    return float(found.fun), np.asarray(found.x)


def within_swing(helds: Sequence[Held], harmonics: Harmonics, coefficients: np.ndarray) -> np.ndarray:
    """(n,) the coefficients, made smaller until no hypothesis swings its load too far or lets its string go slack."""
    limit = harmonics.limits.swing
    while True:
        motion = harmonics.motion(coefficients)
        here = [h.along(motion) for h in helds]
        widest = max(float(np.abs(h.swing(h.start)).max()) for h in here)
        if widest <= limit and min(float(h.tension(h.start).min()) for h in here) > 0.0:
            return coefficients
        coefficients = coefficients * min(SHRINK, max(0.5, limit / widest)) if np.isfinite(widest) else coefficients / 2
