"""Where thresholds are: values of an effect on which nothing depends while it is absent.

A tank that never overflows does not show its edge: at its null value the effect has no derivative by its place, and no
descent finds one. How much the effect is, at a place that is given, is linear all the same. So the place is looked for
over all that the recordings reach, at each of which the evidence of the size alone is asked; then it is a value like
any other, and counts as one.
"""

from dataclasses import replace

import numpy as np

from armdyn.identify.state_space.grey_box import GreyBox, NoiseAndMotion
from armdyn.identify.state_space.noise_evidence import at_every_kick

FARTHEST, TRIED = 10.0, 21
"""Typical sizes to either side of the declared place, and places tried there, evenly."""
HALVINGS = 3
"""Of the distance between two places that are tried, around the best one: from there a descent goes on."""
ALIKE = 1e-6
"""Nats by which places differ that matter at all."""


def places(box: GreyBox, point: NoiseAndMotion, base: np.ndarray, seen: np.ndarray) -> dict[int, float]:
    """By unknown, the likeliest place of what matters only where its effect is there.

    Args:
        box: all runs around their motion.
        point: where the base is settled.
        base: (P,) bool, what is fitted of it.
        seen: (P,) bool, unknowns that change something where no effect is there.
    """
    problem, found, values = box.problem, dict[int, float](), point.values.copy()
    hidden = problem.is_effect & box.removable & ~problem.per_run & ~seen
    for place in np.flatnonzero(hidden).tolist():
        effect = problem.columns[place].parameter
        own = np.array(
            [(c.parameter.effect, c.parameter.joint) == (effect.effect, effect.joint) for c in problem.columns]
        )
        own[place] = False
        here = replace(point, values=values)
        if own.any() and not box.seen(here)[place]:
            at = _likeliest(box, here, base | own, place)
            if at is not None:
                values[place] = found[place] = at
    return found


def _likeliest(box: GreyBox, point: NoiseAndMotion, free: np.ndarray, place: int) -> float | None:
    """The place at which what is (P,) `free` is likeliest, alike ones next to the declared one; None where all are."""
    problem = box.problem
    centre, step = point.values[place], 2.0 * FARTHEST / (TRIED - 1) * problem.typical[place]
    tried = dict[float, float]()

    def worth(at: float) -> float:
        at = float(np.clip(at, problem.lower[place], problem.upper[place]))
        if at not in tried:
            values = point.values.copy()
            values[place] = at
            there = replace(point, values=values)
            arounds = box.around(there, free)
            finite = all(around.finite for around in arounds)
            value = box.tables(arounds, there, at_every_kick).evidence(free).value if finite else -np.inf
            tried[at] = value if np.isfinite(value) else -np.inf
        return tried[at]

    for k in np.arange(TRIED) - TRIED // 2:
        worth(centre + k * step)
    if np.ptp(list(tried.values())) < ALIKE:
        return None
    for _ in range(HALVINGS):
        step *= 0.5
        best = max(tried, key=lambda one: (tried[one], -abs(one - centre)))
        worth(best - step)
        worth(best + step)
    return max(tried, key=lambda one: (tried[one], -abs(one - centre)))
