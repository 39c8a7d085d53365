"""Where thresholds are: values of an effect on which nothing depends while it is absent.

A tank that never overflows does not show its edge: at its null value the effect has no derivative by its place, and no
descent finds one. How much the effect is, at a place that is given, is linear all the same. So the place is looked for
over all that the recordings reach, at each of which the evidence of the size alone is asked; then it is a value like
any other, and counts as one.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from armdyn.identify.grey_box import GreyBox, Point
from armdyn.identify.noise_evidence import at_every_kick

FARTHEST, TRIED = 10.0, 21
"""Typical sizes to either side of the declared place, and places tried there, evenly."""
HALVINGS = 3
"""Of the distance between two places that are tried, around the best one: from there a descent goes on."""
ON = (1.0, 0.1)
"""Typical sizes at which it is asked whether a place matters."""


def places(box: GreyBox, point: Point, base: np.ndarray, seen: np.ndarray) -> dict[int, float]:
    """By unknown, the likeliest place of what matters only where its effect is there.

    Args:
        box: all runs around their motion.
        point: where the base is settled.
        base: (P,) bool, what is fitted of it.
        seen: (P,) bool, unknowns that change something where no effect is there.
    """
    found = dict[int, float]()
    for sized, hidden in _thresholds(box, point, seen):
        values = point.values.copy()
        for place in hidden:
            values[place] = found[place] = _likeliest(box, replace(point, values=values), base | sized, place)
    return found


def _thresholds(box: GreyBox, point: Point, seen: np.ndarray) -> Iterator[tuple[np.ndarray, list[int]]]:
    """(P,) bool, the sizes of every effect that has a place, and which unknowns are its places."""
    problem = box.problem
    for key in dict.fromkeys((c.parameter.effect, c.parameter.joint) for c in problem.columns if c.parameter.effect):
        own = np.array([(c.parameter.effect, c.parameter.joint) == key for c in problem.columns])
        own &= box.removable & ~problem.per_run
        sized, rest = own & seen, own & ~seen
        if not sized.any() or not rest.any():
            continue
        shown = np.zeros(len(own), dtype=bool)
        for size in ON:
            for sign in (1.0, -1.0):
                on = np.clip(problem.null + sign * size * problem.typical, problem.lower, problem.upper)
                there = replace(point, values=np.where(sized, on, point.values))
                with np.errstate(all="ignore"):  # one that diverges shows nothing
                    shown |= box.seen(there)
        if (rest & shown).any():
            yield sized, np.flatnonzero(rest & shown).tolist()


def _likeliest(box: GreyBox, point: Point, free: np.ndarray, place: int) -> float:
    """The place at which what is (P,) `free` is likeliest; of several alike that next to the declared one."""
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
    for _ in range(HALVINGS):
        step *= 0.5
        best = max(tried, key=lambda one: (tried[one], -abs(one - centre)))
        worth(best - step)
        worth(best + step)
    return max(tried, key=lambda one: (tried[one], -abs(one - centre)))
