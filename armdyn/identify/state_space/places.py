"""Thresholds of absent effects: values on which nothing depends while their effect is at null.

A tank that never overflows contains no sign of its edge: while the effect is at its null value, the derivative with
respect to its threshold is zero, and no descent finds it. For a given threshold, however, the predictions are linear in
the size of the effect. So thresholds over the whole range of the recordings are tried, and the evidence of the size
alone is compared; afterwards the threshold is an unknown like any other, and counts as one.
"""

from dataclasses import replace

import numpy as np

from armdyn.identify.state_space.grey_box import GreyBox, NoiseAndMotion
from armdyn.identify.state_space.noise_evidence import at_every_kick

PLACE_RANGE_SIZES, PLACES_TRIED = 10.0, 21
"""Distance to either side of the declared threshold, in typical sizes, and number of thresholds tried there, evenly."""
PLACE_HALVINGS = 3
"""Number of times that the distance between tried thresholds is halved around the best one; a descent continues from
there."""
EQUAL_PLACE_NATS = 1e-6
"""Smallest difference of log evidence, nats, between thresholds that have any influence."""


def places(box: GreyBox, point: NoiseAndMotion, base: np.ndarray, seen: np.ndarray) -> dict[int, float]:
    """Find the likeliest threshold, by unknown, of every effect that has one.

    Args:
        box: all runs, linearised around their motion.
        point: point at which the base is optimised.
        base: (P,) bool, unknowns of the base that are fitted.
        seen: (P,) bool, unknowns that change something while all effects are absent.
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
    """The likeliest threshold `place` with (P,) `free` unknowns; of equal ones the next to the declared one."""
    problem = box.problem
    centre, step = point.values[place], 2.0 * PLACE_RANGE_SIZES / (PLACES_TRIED - 1) * problem.typical[place]
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

    for k in np.arange(PLACES_TRIED) - PLACES_TRIED // 2:
        worth(centre + k * step)
    if np.ptp(list(tried.values())) < EQUAL_PLACE_NATS:
        return None
    for _ in range(PLACE_HALVINGS):
        step *= 0.5
        best = max(tried, key=lambda one: (tried[one], -abs(one - centre)))
        worth(best - step)
        worth(best + step)
    return max(tried, key=lambda one: (tried[one], -abs(one - centre)))
